"""Grids that resolve a shape: elements that end where something jumps, more nodes, and shorter elements."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from pisplit.checks import Array
from pisplit.models.rod.answers import Unresolved
from pisplit.models.rod.section.jumps import cut, rod_borders, rod_jumps, shares
from pisplit.models.rod.terms.loads import Term

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene
    from pisplit.models.rod.section.body import Rod
    from pisplit.models.rod.statics.resolution import Resolution

#: Most nodes that are tried, on one element and on all.
MOST, ALL = 24, 48
#: Nodes of an element from which on it is cut where more of them help little: errors that fall to no less than this.
CUT, SLOW = 8, 0.4
#: Part of the largest share in the error from which on that of an element counts.
COUNTS = 0.05


def places_of_jumps(rod: Rod, terms: Sequence[Term]) -> list[float]:
    """Arclengths in m at which ``rod`` or what its ``terms`` do to it jumps, at the ends of elements too."""
    found = [s for term in terms if hasattr(term, "jumps") for s in term.jumps(rod)]
    return [s for s in (*rod_jumps(rod), *found) if s < rod.length * (1.0 - 1e-9)]


def cut_at(scene: Scene, places: Sequence[float], nodes: Sequence[int]) -> Scene:
    """``scene`` with elements that end at ``places`` in m too, pieces on the ``nodes`` of what they were cut from."""
    rod, owner = cut(scene.rod, places)
    return scene.with_rod(rod, [nodes[k] for k in owner])


def grids(here: Resolution, state: Array) -> Iterator[tuple[Resolution, float]]:
    """Finer and finer grids, and the estimated error there of the equilibrium near ``state`` on the grid ``here``.

    More nodes first; elements on which these help little are cut, by stiffness where it varies much, else in halves.
    """
    u, last = here.scene.layout.split(state).inputs, np.inf
    error, shares_in_error = here.judged(state)
    while True:
        scene = here.finer
        # Of strains that are exact no element has a share: the shape is what few nodes do not resolve.
        counts = ~(shares_in_error <= COUNTS * shares_in_error.max(initial=0.0)) | (shares_in_error.max() == 0.0)
        if len(counts) == len(here.scene.element_nodes):  # nothing is cut at jumps in this round
            slow = error > SLOW * last and max(here.scene.element_nodes) >= CUT
            scene = _cut_further(here.scene, counts) if slow else _on_more(here, counts)
            last = np.inf if slow else error
        if max(scene.element_nodes) > MOST or scene.nodes > max(ALL, MOST):
            return
        found = here.on(scene).root(state)
        if found is None:
            return
        here, state = here.of(scene), scene.at_rest(found, u)
        error, shares_in_error = here.judged(state)
        yield here, error


def _on_more(here: Resolution, counts: Array) -> Scene:
    """The scene with the nodes of the finer grid on those elements whose error ``counts``."""
    if counts.all():
        return here.finer
    pairs = zip(here.scene.element_nodes, here.finer.element_nodes, counts, strict=True)
    return here.scene.with_nodes([more if c else few for few, more, c in pairs])


def _cut_further(scene: Scene, counts: Array) -> Scene:
    """``scene`` with those elements cut whose error ``counts``."""
    ends = list(pairwise(rod_borders(scene.rod)))
    places = [s for (a, b), c in zip(ends, counts, strict=True) if c for s in shares(scene.rod, a, b)]
    nodes = [k // 2 + 2 if c else k for k, c in zip(scene.element_nodes, counts, strict=True)]
    return cut_at(scene, places, nodes)


def resolved(scene: Scene, inputs: Array, tolerance: float) -> Scene:
    """``scene`` on a grid that resolves its equilibria under ``inputs`` (N, n_inputs) to ``tolerance`` of the length.

    Where few nodes find no equilibrium (they may buckle where the rod does not), more are tried.

    Raises ValueError where an equilibrium is not found, or takes more than ``MOST`` nodes an element or ``ALL``.
    """
    for _ in range(MOST):
        for u in inputs:
            statics = scene.statics()
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", Unresolved)
                found = statics.solve(u)
            finer: Scene | None
            if found.balanced:
                if statics.resolution.error(found.state) <= tolerance:
                    continue
                finer = statics.resolution.would_do(found.state, tolerance)
            else:
                finer = statics.resolution.finer
                if max(finer.element_nodes) > MOST:
                    raise ValueError(f"no equilibrium under {u} to choose nodes by: {found.message}; give other inputs")
            if finer is None:
                raise ValueError(
                    f"more than {MOST} nodes an element or {ALL} in all are needed for {tolerance:g} of the length; "
                    "cut the rod into elements"
                )
            scene = finer
            break
        else:
            return scene
    raise ValueError(f"no number of nodes up to {MOST} keeps {tolerance:g} of the length; cut the rod into elements")
