"""What a scene consists of: a rod, terms and nodes, and the sizes that follow from them."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Collection, Sequence
from functools import cached_property

from pisplit.checks import count
from pisplit.models.rod.equations.balance import Balance, collect_inputs
from pisplit.models.rod.kinematics.gauss import Rule
from pisplit.models.rod.scene.layout import Layout
from pisplit.models.rod.section.body import Rod
from pisplit.models.rod.terms.base import Base, joint_of
from pisplit.models.rod.terms.chambers import Chambers
from pisplit.models.rod.terms.held import HeldTip, held_tip
from pisplit.models.rod.terms.loads import Input, NoEffect, Term
from pisplit.models.rod.terms.maxwell import Maxwell
from pisplit.models.rod.terms.pull import TendonTerm
from pisplit.models.rod.terms.units import unit_of


class Contents:
    """A rod, the terms that act on it, and its nodes; checked against one another.

    Args:
        rod: the rod.
        terms: what acts on it.
        nodes: number of Gauss nodes of every element, or a number for each.
    """

    rod: Rod
    terms: tuple[Term, ...]
    balance_type: type[Balance]
    element_nodes: tuple[int, ...]
    inputs: tuple[Input, ...]

    def _fill(self, rod: Rod, terms: Sequence[Term], nodes: int | Sequence[int], balance_type: type[Balance]) -> None:
        if not isinstance(rod, Rod):
            raise ValueError(f"Scene starts with a Rod; got {type(rod).__name__}")
        for term in terms:
            if isinstance(term, type) or not isinstance(term, Term):
                raise ValueError(f"Scene term {term!r} has no inputs/apply/describe; give terms such as Gravity(...)")
        self.rod = rod
        self.terms = tuple(terms)
        self.balance_type = balance_type
        self.element_nodes = _nodes_of_elements(rod, nodes)
        self._check_terms()
        self.inputs = collect_inputs(self.terms)

    def _check_terms(self) -> None:
        named = [t for t in self.terms if isinstance(t, TendonTerm | Chambers)]
        names = Counter(t.name for t in named)
        twice = [name for name in names if names[name] > 1]
        if twice:
            kinds = " and ".join(sorted({type(t).__name__ for t in named if t.name in twice}))
            raise ValueError(f"two {kinds} terms share the input {twice[0]!r}; give one of them another name=")
        if sum(isinstance(t, Base) for t in self.terms) > 1:
            raise ValueError("a scene has one Base; use scene.replace(Base(...))")
        for time, number in Counter(t.time for t in self.branches).items():
            if number > 1:
                whole = sum(t.fraction for t in self.branches if t.time == time)
                raise ValueError(f"two Maxwell branches of {time:g} s relax as one; give Maxwell({whole:g}, {time:g})")
        self._check_held()
        for term in self.terms:
            check = getattr(term, "check", None)
            if check is not None:
                check(self.rod, self.rule)

    def _check_held(self) -> None:
        if sum(isinstance(t, HeldTip) for t in self.terms) > 1:
            raise ValueError("a scene has one HeldTip; use scene.replace(HeldTip(...))")
        base = [t for t in self.terms if isinstance(t, Base)]
        if not base or held_tip(self.terms) is None:
            return
        if base[0].inputs or base[0].moves:
            raise ValueError("a HeldTip needs a base at rest; give Base(...) a fixed pose and nothing that moves")
        if self.rod.strain_set.planar and any((*base[0].position[1:2], *base[0].rotation)):  # type: ignore[index,misc]
            raise ValueError("a HeldTip of a planar rod needs its base in the x-z plane, not turned")

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """What acts on nothing in this scene, a sentence each: such terms stay in it and change nothing."""
        found = []
        for term in self.terms:
            idle = getattr(term, "idle", None)
            reason = None if idle is None else idle(self.rod, self.terms)
            if reason:
                found.append(f"{type(term).__name__} {reason}")
        return tuple(found)

    def _say(self, known: Collection[str] = (), level: int = 3) -> None:
        """Warn of what acts on nothing, but for what is known already."""
        for note in self.notes:
            if note not in known:
                warnings.warn(note, NoEffect, stacklevel=level)

    def __repr__(self) -> str:
        r, terms = self.rod, ", ".join(type(term).__name__ for term in self.terms)
        nodes = " + ".join(map(str, self.element_nodes))
        return f"Scene({r.strain_set.name} rod of {r.length:g} m, {nodes} nodes; {terms}; {self.n_inputs} inputs)"

    def __str__(self) -> str:
        r = self.rod
        lines = [
            f"rod      {r.strain_set.name}, L = {r.length:g} m, mass {r.mass_per_length * r.length:g} kg, "
            f"EI = {r.stiffness[0]:g} N m^2, {' + '.join(map(str, self.element_nodes))} nodes"
        ]
        lines += [f"term     {t.describe(r)}" for t in self.terms]
        lines += [f"input    {i.name} ({i.size})" for i in self.inputs]
        joint = f" ({self.n_joint} of the joint)" if self.n_joint else ""
        hidden = f" + {self.layout.n_overstress} overstresses" if self.branches else ""
        lines.append(
            f"state    {self.n_states} = 2 x {self.n_strains} strains{joint} and rates{hidden} + {self.n_inputs} inputs"
        )
        lines += [f"note     {note}" for note in self.notes]
        return "\n".join(lines)

    @property
    def nodes(self) -> int:
        """Number K of the nodes of all elements."""
        return sum(self.element_nodes)

    @property
    def n_strains(self) -> int:
        """Number of generalised coordinates: free strains times nodes, and joint coordinates of the base."""
        return self.rod.strain_set.n_fields * self.nodes + self.n_joint

    @property
    def n_joint(self) -> int:
        """Number of joint coordinates of the base, which stand behind the strains."""
        base = joint_of(self.terms)
        return 0 if base is None else base.freedom

    @property
    def n_inputs(self) -> int:
        """Number of input entries."""
        return sum(i.size for i in self.inputs)

    @cached_property
    def layout(self) -> Layout:
        """Where what stands in a state."""
        return Layout(self.n_strains, self.n_inputs, len(self.branches), self.n_joint)

    @property
    def branches(self) -> tuple[Maxwell, ...]:
        """Maxwell branches of the material with a stiffness, in the order of their overstress in a state."""
        return tuple(t for t in self.terms if isinstance(t, Maxwell) and t.fraction > 0.0)

    @property
    def n_states(self) -> int:
        """Length of the state [xi, xi_t, u], of a scene with Maxwell branches [xi, xi_t, sigma, u]."""
        return self.layout.size

    @property
    def input_names(self) -> tuple[str, ...]:
        """Name of every input entry."""
        return tuple(f"{i.name}[{k}]" for i in self.inputs for k in range(i.size))

    @property
    def input_units(self) -> tuple[str, ...]:
        """Unit of every input entry, empty where its term does not tell."""
        units: dict[str, str] = {}
        for term in self.terms:
            for item in term.inputs:
                units[item.name] = units.get(item.name) or unit_of(term, item)
        return tuple(units[i.name] for i in self.inputs for _ in range(i.size))

    @cached_property
    def rule(self) -> Rule:
        """The collocation rule."""
        return self.rod.rule(self.element_nodes)


def _nodes_of_elements(body: Rod, nodes: int | Sequence[int]) -> tuple[int, ...]:
    elements = max(1, len(body.elements))
    if isinstance(nodes, tuple | list):
        if len(nodes) != elements:
            raise ValueError(
                f"Scene has {len(nodes)} numbers of nodes for {elements} elements; give one for each, or one"
            )
        return tuple(count(k, "Scene nodes", 2) for k in nodes)
    return (count(nodes, "Scene nodes", 2),) * elements
