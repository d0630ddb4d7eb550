"""A scene: a rod and the terms that act on it, and what can be had of it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, one_of, positive, real_array
from pisplit.models.rod.equations.balance import Balance
from pisplit.models.rod.scene.equations import Equations
from pisplit.models.rod.scene.identity import fingerprint
from pisplit.models.rod.section.body import Rod
from pisplit.models.rod.terms.base import Base
from pisplit.models.rod.terms.loads import Term

if TYPE_CHECKING:
    from pathlib import Path

    from pisplit.models.rod.analysis.coordinates import StrainCoordinates
    from pisplit.models.rod.analysis.cost import Cost
    from pisplit.models.rod.analysis.energy import Energies
    from pisplit.models.rod.analysis.fields import Fields
    from pisplit.models.rod.analysis.modes import NaturalModes
    from pisplit.models.rod.dynamics.fast import FastStepper
    from pisplit.models.rod.dynamics.integrator import Simulator
    from pisplit.models.rod.dynamics.stepper import Stepper
    from pisplit.models.rod.equations.linear import Linearisation
    from pisplit.models.rod.output.codegen import Exported
    from pisplit.models.rod.output.compiled import CompiledScene
    from pisplit.models.rod.statics.inverse import InverseSolution
    from pisplit.models.rod.statics.statics import Statics


class Scene(Equations):
    """A rod with the terms that act on it; immutable. Only what it contains is in its equations.

    The state is ``[xi, xi_t, u]``: free strains at the Gauss nodes (node by node), their rates, and the inputs as they
    act at that moment (servo positions of displaced tendons included). With Maxwell branches it is
    ``[xi, xi_t, sigma, u]`` with their overstress; ``layout`` says where what stands, ``state`` stacks it.

    ``scene + term``, ``scene - term``, ``scene.replace(term)`` and ``scene.without(TermType)`` give new scenes. Two
    scenes are equal if their parts are, or if they have terms of the same kinds and the same equations
    (``fingerprint``).

    Args:
        rod: the rod.
        terms: what acts on it; inputs add up in the order of the terms.
        nodes: number of Gauss nodes, of a rod with several elements on every element, or a number for each, or
            ``"auto"``: nodes, and elements, for 1e-4 L without inputs (see ``resolved``). Four give 1e-5 to 1e-4 L for
            a smooth arm, six 1e-6 to 1e-5; equilibria warn (``Unresolved``) where they are off by more than 1e-3 L.
            ``scene.nodes`` is the number K of all of them.

    Raises ValueError where rod, terms and nodes do not fit together; warns (``NoEffect``) of what acts on nothing,
    which ``scene.notes`` lists too.
    """

    def __init__(self, rod: Rod, *terms: Term, nodes: int | Sequence[int] | str = 4) -> None:
        if isinstance(nodes, str):
            one_of(nodes, "Scene nodes", ("auto",))
            fine = _cut_at_jumps(rod, terms).resolved()
            rod, nodes = fine.rod, fine.element_nodes
        self._fill(rod, terms, nodes, Balance)
        self._say()

    def __add__(self, term: Term) -> Scene:
        return self._with(*self.terms, term)

    def __sub__(self, term: Term) -> Scene:
        """The scene without the last term that equals ``term``: ``scene + term - term`` is ``scene``."""
        for k in reversed(range(len(self.terms))):
            if _equal(self.terms[k], term):
                return self._with(*self.terms[:k], *self.terms[k + 1 :])
        raise ValueError(f"the scene does not contain {term!r}")

    def replace(self, term: Term) -> Scene:
        """The scene with ``term`` in place of the one of the same type; ValueError unless there is exactly one."""
        same = [t for t in self.terms if type(t) is type(term)]
        if len(same) != 1:
            raise ValueError(
                f"the scene has {len(same)} terms of type {type(term).__name__}; replace needs exactly one"
            )
        return self._with(*[term if t is same[0] else t for t in self.terms])

    def without(self, kind: type) -> Scene:
        """The scene without its terms of type ``kind``, however many there are."""
        if not isinstance(kind, type):
            raise ValueError(f"without({kind!r}) is no type of terms; give one such as rod.Gravity")
        return self._with(*[t for t in self.terms if not isinstance(t, kind)])

    def with_nodes(self, nodes: int | Sequence[int]) -> Scene:
        """The scene on another number of ``nodes`` of every element, or a number for each."""
        return _rebuild(self.rod, self.terms, nodes, self.balance_type)

    def with_rod(self, rod: Rod, nodes: int | Sequence[int]) -> Scene:
        """The same terms on another ``rod``, with ``nodes`` of every element, or a number for each."""
        return _rebuild(rod, self.terms, nodes, self.balance_type)

    def resolved(self, inputs: ArrayLike | None = None, tolerance: float = 1e-4) -> Scene:
        """The scene on as many nodes and elements as its equilibria need, and not fewer than it has.

        Elements are cut where a load, the section, the material or the rest curvature jumps, and where more nodes help
        little (strong tapers); nodes are added on those elements that need them.

        Args:
            inputs: (N, n_inputs) under which shapes are to be right, e.g. the corners of their range; none when not
                given.
            tolerance: largest error along the rod in parts of its length.

        Raises ValueError where an equilibrium is not found, or takes more than 24 nodes an element or 48 in all.
        """
        from pisplit.models.rod.statics.refinement import resolved

        rows = np.zeros((1, self.n_inputs)) if inputs is None else np.atleast_2d(real_array(inputs, "inputs"))
        rows = self.checked_inputs(rows, "inputs", (None, self.n_inputs))
        return resolved(self, rows, positive(tolerance, "tolerance"))

    def _with(self, *terms: Term) -> Scene:
        """The scene with other terms."""
        scene = _rebuild(self.rod, terms, self.element_nodes, self.balance_type)
        scene._say(known=self.notes, level=4)
        return scene

    def __reduce__(self) -> tuple[object, ...]:
        # Graphs are rebuilt, not pickled.
        return _rebuild, (self.rod, self.terms, self.element_nodes, self.balance_type)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Scene):
            return NotImplemented
        if self is other or _equal(self.__reduce__(), other.__reduce__()):
            return True
        # Functions and terms without __eq__ compare by identity: what they compute decides.
        return hash(self) == hash(other) and self._digest is not None and self._digest == other._digest

    def __hash__(self) -> int:
        kinds = (type(self), self.balance_type, *(type(t) for t in self.terms))
        return hash((kinds, self.rod.length, self.rod.strain_set.free, self.element_nodes))

    def fingerprint(self, stations: int | ArrayLike = 6) -> str:
        """Digest of the equations and of the fields at ``stations`` (S,) in m or their number: see ``fingerprint``."""
        return fingerprint(self, stations)

    @cached_property
    def _digest(self) -> str | None:
        """The fingerprint; None for scenes that cannot be told from others by their equations."""
        try:
            return fingerprint(self)
        except ValueError:
            return None

    @cached_property
    def motion_residual(self) -> ca.Function:
        """``(xi, xi_t, xi_tt, u) -> residual`` with its iteration matrix: see ``residuals.motion_residual``."""
        from pisplit.models.rod.equations.residuals import motion_residual

        return motion_residual(self)

    @cached_property
    def shared_motion_residual(self) -> ca.Function:
        """The same, faster to evaluate and slower to build: for long runs."""
        from pisplit.models.rod.equations.residuals import motion_residual

        return motion_residual(self, shared=True)

    def statics(self) -> Statics:
        """Static equilibria: see ``Statics``; made once."""
        from pisplit.models.rod.statics.statics import Statics

        found: Statics = self.__dict__.setdefault("_statics", Statics(self))
        return found

    def simulator(self, dt: float, **options: object) -> Simulator:
        """Dynamics over steps of ``dt`` seconds; ``options`` are those of ``Simulator``."""
        from pisplit.models.rod.dynamics.integrator import Simulator

        return Simulator(self, dt, **options)  # type: ignore[arg-type]

    def compile(self, stations: int | ArrayLike = 6) -> CompiledScene:
        """The same scene as machine code: residuals, Jacobians and the fields at ``stations``; see ``CompiledScene``.

        Takes seconds once (more for many nodes); the libraries are kept in a user cache folder. Without a C compiler
        one warning is logged and the scene is evaluated as before.
        """
        from pisplit.models.rod.output.compiled import CompiledScene

        made = CompiledScene.of(self)
        for scene, functions in made.to_compile(stations):
            scene.build(functions)
        return made

    def codegen(self, path: str | Path, dt: float, substeps: int = 8, stations: int = 6) -> Exported:
        """The scene as dependency-free C with a step of fixed cost, for a controller board: see ``codegen.codegen``.

        Files at ``path``, a ``dt`` in s of ``substeps`` steps, fields at ``stations``.
        """
        from pisplit.models.rod.output.codegen import codegen

        return codegen(self, path, dt, substeps, stations)

    def cost(self) -> Cost:
        """Instruction counts of residuals and Jacobians by term: see ``Cost``."""
        from pisplit.models.rod.analysis.cost import cost

        return cost(self)

    def stepper(self, dt: float, **options: object) -> Stepper:
        """Dynamics over steps of ``dt`` seconds by a fixed-step scheme; ``options`` are those of ``Stepper``."""
        from pisplit.models.rod.dynamics.stepper import Stepper

        return Stepper(self, dt, **options)  # type: ignore[arg-type]

    def fast_stepper(self, dt: float, **options: object) -> FastStepper:
        """Dynamics over steps of ``dt`` seconds by large checked steps; ``options`` are those of ``FastStepper``."""
        from pisplit.models.rod.dynamics.fast import FastStepper

        return FastStepper(self, dt, **options)  # type: ignore[arg-type]

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

    def reactions(self, x: ArrayLike) -> Array:
        """World force in N and moment in N m (..., 6) at a held tip of states ``x`` (..., n_states): see ``reactions``.

        Raises ValueError where the tip is free.
        """
        from pisplit.models.rod.analysis.reactions import reactions

        return reactions(self, x)

    def base_reactions(self, x: ArrayLike) -> Array:
        """World force in N and moment in N m (..., 6) at the base of states ``x`` (..., n_states).

        See ``base_reactions``.
        """
        from pisplit.models.rod.analysis.reactions import base_reactions

        return base_reactions(self, x)

    def inverse(
        self, tip: ArrayLike, limits: ArrayLike | None = None, start: ArrayLike | None = None
    ) -> InverseSolution:
        """Inputs that bring the tip to ``tip`` (3,) in m, NaN where free, within limits: see ``Statics.inverse``.

        ``start`` (n_inputs,) is the first guess; zeros when not given.
        """
        return self.statics().inverse(tip, limits, start)

    def linearise(self, state: ArrayLike) -> Linearisation:
        """Linear dynamics about a state: see ``Linearisation``."""
        from pisplit.models.rod.equations.linear import linearise

        return linearise(self, state)

    def modes(self, state: ArrayLike, number: int | None = None) -> NaturalModes:
        """Frequencies, damping and shapes of the slowest modes about an equilibrium: see ``NaturalModes``.

        ``state`` (n_states,) is at rest; ``number`` of modes, all when not given.
        """
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


def _rebuild(
    body: Rod, terms: tuple[Term, ...], nodes: int | Sequence[int], balance_type: type[Balance] = Balance
) -> Scene:
    scene = Scene.__new__(Scene)
    scene._fill(body, terms, nodes, balance_type)
    return scene


def _cut_at_jumps(body: Rod, terms: tuple[Term, ...]) -> Scene:
    """A first grid of four nodes an element, with elements that end where something jumps."""
    from pisplit.models.rod.section.jumps import cut
    from pisplit.models.rod.statics.refinement import places_of_jumps

    if isinstance(body, Rod):
        body, _ = cut(body, places_of_jumps(body, terms))
    return _rebuild(body, terms, 4)


def _equal(a: object, b: object) -> bool:
    """Whether two objects are equal; what cannot say so (arrays among their parts) is not."""
    try:
        return bool(a == b)
    except (TypeError, ValueError):
        return a is b
