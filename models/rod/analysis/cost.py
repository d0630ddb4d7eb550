"""What each part of a scene costs, in instructions of the CasADi virtual machine."""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pisplit.brief import brief
from pisplit.models.rod.terms.loads import NoEffect

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pisplit.models.rod.scene import Scene
    from pisplit.models.rod.terms.loads import Term


@dataclass(frozen=True)
class Instructions:
    """Instruction counts.

    Attributes:
        residual, jacobian: of the balance in motion and its Jacobian.
        static_residual, static_jacobian: of the balance at rest and its Jacobian.
    """

    residual: int
    jacobian: int
    static_residual: int
    static_jacobian: int

    def __sub__(self, other: Instructions) -> Instructions:
        return Instructions(
            self.residual - other.residual,
            self.jacobian - other.jacobian,
            self.static_residual - other.static_residual,
            self.static_jacobian - other.static_jacobian,
        )


@brief
@dataclass(frozen=True)
class Cost:
    """Instruction counts of a scene; ``print`` shows the table.

    Attributes:
        terms: each term in the order of the scene with its description and the difference its absence makes. What
            several terms share (velocities, frames at the tip) goes only when all of them do, so that the rows need
            not add up.
        rod: the rod without any term.
        total: the whole scene.
    """

    terms: tuple[tuple[str, Instructions], ...]
    rod: Instructions
    total: Instructions

    def __str__(self) -> str:
        rows = [("the rod alone", self.rod), *self.terms, ("the whole scene", self.total)]
        width = max(len(name) for name, _ in rows)
        lines = [
            f"{'instructions':<{width}}  {'in motion':>20}  {'at rest':>20}",
            f"{'':<{width}}  {'residual':>10}{'Jacobian':>10}  {'residual':>10}{'Jacobian':>10}",
        ]
        for name, i in rows:
            counts = f"{i.residual:>10}{i.jacobian:>10}  {i.static_residual:>10}{i.static_jacobian:>10}"
            lines.append(f"{name:<{width}}  {counts}")
        return "\n".join(lines)

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Instructions in motion by term; written to ``path`` where one is given."""
        from pisplit.models.rod.analysis.pictures import plot_cost

        return plot_cost(self, path)


def instructions(scene: Scene) -> Instructions:
    """Instruction counts of one scene."""
    motion, rest = scene.motion_residual, scene.statics().residual_function
    return Instructions(*(int(f.n_instructions()) for f in (motion, motion.jacobian(), rest, rest.jacobian())))


def cost(scene: Scene) -> Cost:
    """Count the scene, the scene without each of its terms, and the bare rod."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NoEffect)  # a scene without its gravity is no user's scene
        return _cost(scene)


def _cost(scene: Scene) -> Cost:
    total = instructions(scene)

    def of(term: Term) -> Instructions:
        return total - instructions(scene - term)

    bare = scene
    for term in scene.terms:
        bare = bare - term
    terms = tuple((term.describe(scene.rod), of(term)) for term in scene.terms)
    return Cost(terms=terms, rod=instructions(bare), total=total)
