"""When a term acts on nothing: loads across the plane of a planar rod, tendons and chambers on its axis."""

from __future__ import annotations

from collections.abc import Sequence

from pisplit.models.rod.section.body import Rod
from pisplit.models.rod.terms.base import Base
from pisplit.models.rod.terms.loads import Input, Term, Vector
from pisplit.models.rod.terms.routing import Route

ACROSS = "is across the plane of a planar rod and has no effect"


def idle_force(force: Vector, rod: Rod, terms: Sequence[Term]) -> str | None:
    """Why a force or an acceleration of the world acts on nothing, if so: it is across the plane of a planar rod.

    ``rod`` and ``terms`` are those of the scene.
    """
    return idle_wrench(force, (0.0, 0.0, 0.0), rod, terms)


def idle_wrench(force: Vector, moment: Vector, rod: Rod, terms: Sequence[Term]) -> str | None:
    """Why a wrench in world axes, or in those of a section, acts on nothing, if so.

    A planar rod moves in the x-z plane; forces along y and moments about x and z are carried by what holds it there.
    On a base that is turned the plane is another one, and nothing is said.

    Args:
        force, moment: numbers or inputs (3,).
        rod: the rod.
        terms: of the scene.
    """
    turned = any(isinstance(t, Base) and (isinstance(t.rotation, Input) or any(t.rotation)) for t in terms)
    if not rod.strain_set.planar or turned or isinstance(force, Input) or isinstance(moment, Input):
        return None
    acting = (force[0], force[2], moment[1])
    return ACROSS if any((*force, *moment)) and not any(acting) else None


def idle_on_the_axis(routes: Sequence[Route], rod: Rod) -> str | None:
    """Why tendons or chambers with ``routes`` act on nothing, if so: on the axis of a rod that cannot stretch."""
    if 5 in rod.strain_set.free or all(callable(route) or any(route) for route in routes):
        return None
    return "on the axis of a rod that does not stretch has no effect"
