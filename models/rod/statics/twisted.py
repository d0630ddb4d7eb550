"""Stability of a twisted rod on too few nodes: it is that of the grid, which stands or buckles where the rod does not.

Strains are smooth in axes that turn with the rod: a bend that is smooth in space is not, where the rod is twisted by
some radians from node to node.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from pisplit.checks import Array

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene

#: Twist from node to node in rad from which on stability is that of the grid, and the one that named nodes have.
FAR, NEAR = 2.0, 1.8
#: Twist of a whole rod in rad up to which it hardly buckles by it: clamped at both ends it bears 2.86 pi EI / GJ.
MILD = np.pi


def doubt(scene: Scene, state: Array, way: float = 1.0) -> str:
    """Why the stability of a ``state`` (n_states,) is not to be trusted, and which nodes would do; empty if it is.

    ``scene`` is that of the state, ``way`` the part of its twist that it has there.
    """
    torsion = 2
    free = scene.rod.strain_set.free
    if torsion not in free:
        return ""
    strains = scene.layout.split(state).strains[: scene.nodes * len(free)].reshape(scene.nodes, -1)
    rates = np.abs(strains[:, free.index(torsion)])
    gaps = zip(np.diff(scene.rule.nodes), pairwise(rates), strict=True)
    part = max(way, 0.05)
    twist = max((gap * max(pair) for gap, pair in gaps), default=0.0) / part
    if not twist > FAR or rates @ scene.rule.weights < MILD * part:
        return ""
    nodes = [int(np.ceil(k * twist / NEAR)) for k in scene.element_nodes]
    few = nodes[0] if len(set(nodes)) == 1 else nodes
    return (
        f"twisted by {twist:.1f} rad from node to node stability is that of the grid, not of the rod: try nodes={few}"
    )
