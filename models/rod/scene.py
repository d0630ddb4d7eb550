"""A scene: a rod and the terms that act on it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, count, finite_array
from pisplit.models.rod.equations.balance import Balance, collect_inputs
from pisplit.models.rod.kinematics.gauss import Rule
from pisplit.models.rod.section.body import Rod
from pisplit.models.rod.terms.base import Base
from pisplit.models.rod.terms.chambers import Chambers
from pisplit.models.rod.terms.damping import KelvinVoigt, Retardation
from pisplit.models.rod.terms.loads import Input, Term
from pisplit.models.rod.terms.tendons import Displacement, Tendons

if TYPE_CHECKING:
    from pathlib import Path

    from pisplit.models.rod.analysis.coordinates import StrainCoordinates
    from pisplit.models.rod.analysis.cost import Cost
    from pisplit.models.rod.analysis.energy import Energies
    from pisplit.models.rod.analysis.fields import Fields
    from pisplit.models.rod.analysis.modes import NaturalModes
    from pisplit.models.rod.dynamics.integrator import Simulator
    from pisplit.models.rod.dynamics.stepper import Stepper
    from pisplit.models.rod.equations.linear import Linearisation
    from pisplit.models.rod.output.codegen import Exported
    from pisplit.models.rod.output.compiled import CompiledScene
    from pisplit.models.rod.statics.inverse import InverseSolution
    from pisplit.models.rod.statics.statics import Statics


class Scene:
    """A rod with the terms that act on it; immutable. Only what it contains is in its equations.

    The state is ``[xi, xi_t, u]``: free strains at the Gauss nodes (node by node), their rates, and the inputs as they
    act at that moment (servo positions of displaced tendons included). ``scene + term``, ``scene - term``,
    ``scene.replace(term)`` and ``scene.without(TermType)`` give new scenes.

    Args:
        rod: the rod.
        terms: what acts on it; inputs add up in the order of the terms.
        nodes: number of Gauss nodes, of a rod with several elements on every element, or a number for each. Four give
            1e-5 to 1e-4 L for a smooth arm, six 1e-6 to 1e-5. ``scene.nodes`` is the number K of all of them.
    """

    def __init__(self, rod: Rod, *terms: Term, nodes: int | Sequence[int] = 4) -> None:
        if not isinstance(rod, Rod):
            raise ValueError(f"Scene starts with a Rod; got {type(rod).__name__}")
        for term in terms:
            if not isinstance(term, Term):
                raise ValueError(f"Scene term {term!r} has no inputs/apply/describe; give terms such as Gravity(...)")
        self.rod = rod
        self.terms = tuple(terms)
        self.balance_type: type[Balance] = Balance
        self.element_nodes = _nodes_of_elements(rod, nodes)
        self.nodes = sum(self.element_nodes)
        self._check_terms()
        self.inputs: tuple[Input, ...] = collect_inputs(self.terms)

    def _check_terms(self) -> None:
        named = [t for t in self.terms if isinstance(t, Tendons | Chambers)]
        names = [t.name for t in named]
        twice = {n for n in names if names.count(n) > 1}
        if twice:
            kinds = " and ".join(sorted({type(t).__name__ for t in named if t.name in twice}))
            raise ValueError(f"two {kinds} terms share the input {twice.pop()!r}; give one of them another name=")
        if sum(isinstance(t, Base) for t in self.terms) > 1:
            raise ValueError("a scene has one Base; use scene.replace(Base(...))")
        for term in self.terms:
            check = getattr(term, "check", None)
            if check is not None:
                check(self.rod, self.rule)

    def __add__(self, term: Term) -> Scene:
        return self._with(*self.terms, term)

    def __sub__(self, term: Term) -> Scene:
        if term not in self.terms:
            raise ValueError(f"the scene does not contain {term!r}")
        return self._with(*[t for t in self.terms if t != term])

    def replace(self, term: Term) -> Scene:
        """The scene with ``term`` in place of the one of the same type."""
        same = [t for t in self.terms if type(t) is type(term)]
        if len(same) != 1:
            raise ValueError(
                f"the scene has {len(same)} terms of type {type(term).__name__}; replace needs exactly one"
            )
        return self._with(*[term if t is same[0] else t for t in self.terms])

    def without(self, kind: type) -> Scene:
        """The scene without its terms of one type."""
        return self._with(*[t for t in self.terms if not isinstance(t, kind)])

    def with_nodes(self, nodes: int | Sequence[int]) -> Scene:
        """The scene on another number of nodes."""
        return _rebuild(self.rod, self.terms, nodes, self.balance_type)

    def _with(self, *terms: Term) -> Scene:
        """The scene with other terms."""
        return _rebuild(self.rod, terms, self.element_nodes, self.balance_type)

    def __reduce__(self) -> tuple[object, ...]:
        # Graphs are rebuilt, not pickled.
        return _rebuild, (self.rod, self.terms, self.element_nodes, self.balance_type)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Scene) and self.__reduce__() == other.__reduce__()

    def __hash__(self) -> int:
        return hash((self.rod, self.terms, self.element_nodes))

    def __str__(self) -> str:
        r = self.rod
        lines = [
            f"rod      {r.strain_set.name}, L = {r.length:g} m, mass {r.mass_per_length * r.length:g} kg, "
            f"EI = {r.stiffness[0]:g} N m^2, {' + '.join(map(str, self.element_nodes))} nodes"
        ]
        lines += [f"term     {t.describe(r)}" for t in self.terms]
        lines += [f"input    {i.name} ({i.size})" for i in self.inputs]
        lines.append(f"state    {self.n_states} = 2 x {self.n_strains} strains and rates + {self.n_inputs} inputs")
        return "\n".join(lines)

    # Sizes -----------------------------------------------------------------------------------------------------------

    @property
    def n_strains(self) -> int:
        """Number of generalised coordinates: free strains times nodes."""
        return self.rod.strain_set.n_fields * self.nodes

    @property
    def n_inputs(self) -> int:
        """Number of input entries."""
        return sum(i.size for i in self.inputs)

    @property
    def n_states(self) -> int:
        """Length of the state [xi, xi_t, u]."""
        return 2 * self.n_strains + self.n_inputs

    @property
    def input_names(self) -> tuple[str, ...]:
        """Name of every input entry."""
        return tuple(f"{i.name}[{k}]" for i in self.inputs for k in range(i.size))

    @cached_property
    def rule(self) -> Rule:
        """The collocation rule."""
        return self.rod.rule(self.element_nodes)

    # Scales ----------------------------------------------------------------------------------------------------------

    @cached_property
    def nominal_strains(self) -> Array:
        """Typical size of each coordinate: 1/L for bending and torsion, 1 % for shear and stretch."""
        sizes = [1.0 / self.rod.length if c < 3 else 0.01 for c in self.rod.strain_set.free]
        return _fixed(np.tile(sizes, self.nodes))

    @cached_property
    def rest_coordinates(self) -> Array:
        """Free strains of the unloaded rod (n_strains,)."""
        rest = self.rod.profile(self.rule.nodes).rest
        return _fixed(rest[list(self.rod.strain_set.free)].T.ravel())

    @cached_property
    def nominal_residual(self) -> Array:
        """Typical size of each residual row: EI/L for moments, EI/L^2 for forces."""
        moment = min(self.rod.stiffness[:2]) / self.rod.length
        sizes = [moment if c < 3 else moment / self.rod.length for c in self.rod.strain_set.free]
        return _fixed(np.tile(sizes, self.nodes))

    @property
    def damped(self) -> bool:
        """Whether the material damps every free strain."""
        terms = [t for t in self.terms if isinstance(t, KelvinVoigt | Retardation)]
        return all(any(t.coefficient(c) > 0.0 for t in terms) for c in self.rod.strain_set.free)

    # Equations -------------------------------------------------------------------------------------------------------

    def balance(
        self, strains: ca.SX, rates: ca.SX, accelerations: ca.SX | None, u: ca.SX, dead_force: ca.SX | None = None
    ) -> Balance:
        """Symbolic balance for given coordinates, rates, accelerations (None: without inertia) and stacked inputs."""
        parts: dict[str, ca.SX] = {}
        start = 0
        for item in self.inputs:
            parts[item.name] = u[start : start + item.size]
            start += item.size
        carried = any(isinstance(t, Base) and t.moves for t in self.terms)
        at_rest = accelerations is None and not rates.nnz() and dead_force is None
        moving = accelerations is not None or (at_rest and carried)  # at rest on a moving base: inertia of that motion
        second = ca.SX(self.n_strains, 1) if accelerations is None else accelerations
        motion = (strains, rates, second)
        return self.balance_type(self.rod, self.terms, self.rule, *motion, parts, inertia=moving, dead_force=dead_force)

    @cached_property
    def static_balance(self) -> tuple[ca.SX, ca.SX, Balance]:
        """Symbols (xi, u) and the balance at rest."""
        xi, u = ca.SX.sym("xi", self.n_strains), ca.SX.sym("u", self.n_inputs)
        return xi, u, self.balance(xi, ca.SX(self.n_strains, 1), None, u)

    @cached_property
    def dynamic_balance(self) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX, Balance]:
        """Symbols (xi, xi_t, xi_tt, u) and the balance in motion."""
        xi, xi_t, xi_tt = (ca.SX.sym(name, self.n_strains) for name in ("xi", "xi_t", "xi_tt"))
        u = ca.SX.sym("u", self.n_inputs)
        return xi, xi_t, xi_tt, u, self.balance(xi, xi_t, xi_tt, u)

    @cached_property
    def acceleration(self) -> ca.Function:
        """``(xi, xi_t, u) -> xi_tt``: the balance is linear in the accelerations; solved exactly."""
        xi, xi_t, xi_tt, u, balance = self.dynamic_balance
        scale = 1.0 / ca.DM(self.nominal_residual)
        mass = ca.jacobian(balance.residual, xi_tt)
        rest = ca.substitute(balance.residual, xi_tt, ca.SX.zeros(self.n_strains))
        parts = ca.Function("parts", [xi, xi_t, u], [ca.diag(scale) @ mass, scale * rest], {"cse": True})
        x, v, w = ca.MX.sym("xi", self.n_strains), ca.MX.sym("xi_t", self.n_strains), ca.MX.sym("u", self.n_inputs)
        m, r = parts(x, v, w)
        return ca.Function(
            "acceleration", [x, v, w], [-ca.solve(m, r, "qr", {"eps": 1e-30})], ["xi", "xi_t", "u"], ["xi_tt"]
        )

    @cached_property
    def motion_residual(self) -> ca.Function:
        """``(xi, xi_t, xi_tt, u) -> residual`` with its iteration matrix: see ``residuals.motion_residual``."""
        from pisplit.models.rod.equations.residuals import motion_residual

        return motion_residual(self)

    def native(self, function: ca.Function) -> ca.Function:
        """``function`` as this scene evaluates it: by the virtual machine of CasADi; compiled scenes differ."""
        return function

    def state(self, strains: ArrayLike, rates: ArrayLike, u: ArrayLike) -> Array:
        """Stack a state [xi, xi_t, u] from its parts."""
        n = self.n_strains
        return np.concatenate(
            [
                finite_array(strains, "strains", (n,)),
                finite_array(rates, "rates", (n,)),
                self.checked_inputs(u, "u", (self.n_inputs,)),
            ]
        )

    def checked_inputs(self, u: ArrayLike, name: str, shape: tuple[int | None, ...]) -> Array:
        """Inputs as an array; a displacement that would shorten a tendon to nothing raises."""
        array = finite_array(u, name, shape)
        start = 0
        for item in self.inputs:
            lengths = self._pulled_lengths.get(item.name)
            if lengths is not None:
                pulls = array[..., start : start + item.size].reshape(-1, item.size)
                for most, length in zip(np.max(pulls, axis=0, initial=0.0), lengths, strict=True):
                    if most >= length:
                        raise ValueError(
                            f"{name} pulls a tendon of {length:g} m by {most:g} m; give metres below its length"
                        )
            start += item.size
        return array

    @cached_property
    def _pulled_lengths(self) -> dict[str, Array]:
        """Unpulled lengths of the tendons that are driven by displacement, by input."""
        pulled = [t for t in self.terms if isinstance(t, Tendons) and isinstance(t.drive, Displacement)]
        return {t.name: t.unpulled_lengths(self.rod, self.rule) for t in pulled}

    # Front doors -----------------------------------------------------------------------------------------------------

    def statics(self) -> Statics:
        """Static equilibria: see ``Statics``; made once."""
        from pisplit.models.rod.statics.statics import Statics

        found: Statics = self.__dict__.setdefault("_statics", Statics(self))
        return found

    def simulator(self, dt: float, **options: object) -> Simulator:
        """Dynamics over steps of ``dt`` seconds: see ``Simulator``."""
        from pisplit.models.rod.dynamics.integrator import Simulator

        return Simulator(self, dt, **options)  # type: ignore[arg-type]

    def compile(self, stations: int | ArrayLike = 6) -> CompiledScene:
        """The same scene as machine code: residuals, Jacobians and the fields at ``stations``; see ``CompiledScene``.

        Takes seconds once (more for many nodes); the libraries are kept in a user cache folder. Without a C compiler
        one warning is logged and the scene is evaluated as before.
        """
        from pisplit.models.rod.dynamics.trajectory import equations_of_motion
        from pisplit.models.rod.output.compiled import CompiledScene

        made = CompiledScene.of(self)
        # Where the variational twin moves the scene, nothing moves by the usual equations.
        moving = made if equations_of_motion(made) is made else made.variational()
        for scene in dict.fromkeys((made, moving)):
            functions = [scene.statics().residual_function, scene.field_map(stations).function]
            scene.build([*functions, scene.motion_residual] if scene is moving else functions)
        return made

    def codegen(self, path: str | Path, dt: float, substeps: int = 8, stations: int = 6) -> Exported:
        """The scene as dependency-free C with a step of fixed cost, for a controller board: see ``codegen.codegen``."""
        from pisplit.models.rod.output.codegen import codegen

        return codegen(self, path, dt, substeps, stations)

    def cost(self) -> Cost:
        """Instruction counts of residuals and Jacobians by term: see ``Cost``."""
        from pisplit.models.rod.analysis.cost import cost

        return cost(self)

    def stepper(self, dt: float, **options: object) -> Stepper:
        """Dynamics over steps of ``dt`` seconds by a fixed-step scheme: see ``Stepper``."""
        from pisplit.models.rod.dynamics.stepper import Stepper

        return Stepper(self, dt, **options)  # type: ignore[arg-type]

    def variational(self) -> Scene:
        """The same scene with equations that keep its energy, for undamped spatial rods: see ``VariationalBalance``.

        Made once. Raises ValueError for a base that moves.
        """
        from pisplit.models.rod.equations.variational import VariationalBalance

        if any(isinstance(t, Base) and (t.inputs or t.moves) for t in self.terms):
            raise ValueError("variational equations need a resting base; give Base(...) a fixed pose or leave it out")
        if "_variational" not in self.__dict__:
            self.__dict__["_variational"] = _rebuild(self.rod, self.terms, self.element_nodes, VariationalBalance)
        found: Scene = self.__dict__["_variational"]
        return found

    def energies(self, x: ArrayLike) -> Energies:
        """Kinetic, elastic and gravity energy in J of states ``x`` (N, n_states): see ``Energies``."""
        from pisplit.models.rod.analysis.energy import energies

        return energies(self, x)

    def inverse(
        self, tip: ArrayLike, limits: ArrayLike | None = None, start: ArrayLike | None = None
    ) -> InverseSolution:
        """Inputs that bring the tip to ``tip`` (3,) in m, NaN where free, within limits: see ``Statics.inverse``."""
        return self.statics().inverse(tip, limits, start)

    def linearise(self, state: ArrayLike) -> Linearisation:
        """Linear dynamics about a state: see ``Linearisation``."""
        from pisplit.models.rod.equations.linear import linearise

        return linearise(self, state)

    def modes(self, state: ArrayLike, number: int | None = None) -> NaturalModes:
        """Frequencies, damping and shapes of the slowest modes about an equilibrium: see ``NaturalModes``."""
        from pisplit.models.rod.analysis.modes import natural_modes

        return natural_modes(self, state, number)

    def fields(self, x: ArrayLike, stations: int | ArrayLike = 6) -> Array:
        """The 24 fields (p, R, v, w, q, omega) of states ``x`` (..., n_states) at S stations, (..., S, 24)."""
        return self.field_map(stations).evaluate(x)

    def coordinates(self, stations: int | ArrayLike = 6) -> StrainCoordinates:
        """The map from fields at stations to strains and their rates: see ``StrainCoordinates``."""
        from pisplit.models.rod.analysis.coordinates import strain_coordinates

        return strain_coordinates(self, stations)

    def field_map(self, stations: int | ArrayLike = 6) -> Fields:
        """The map from states to fields at stations, kept for reuse."""
        from pisplit.models.rod.analysis.fields import Fields, station_points

        points = station_points(stations, self.rod.length)
        cache = self.__dict__.setdefault("_fields", {})
        if points not in cache:
            cache[points] = Fields(self, points)
        found: Fields = cache[points]
        return found


def _fixed(array: Array) -> Array:
    """The array itself, which nobody can write to: it is kept and handed out again."""
    array.flags.writeable = False
    return array


def _rebuild(
    body: Rod, terms: tuple[Term, ...], nodes: int | Sequence[int], balance_type: type[Balance] = Balance
) -> Scene:
    scene = Scene(body, *terms, nodes=nodes)
    scene.balance_type = balance_type
    return scene


def _nodes_of_elements(body: Rod, nodes: int | Sequence[int]) -> tuple[int, ...]:
    elements = max(1, len(body.elements))
    if isinstance(nodes, tuple | list):
        if len(nodes) != elements:
            raise ValueError(
                f"Scene has {len(nodes)} numbers of nodes for {elements} elements; give one for each, or one"
            )
        return tuple(count(k, "Scene nodes", 2) for k in nodes)
    return (count(nodes, "Scene nodes", 2),) * elements
