"""What holds the tip of a rod, and how far a state is from what is prescribed there."""

from __future__ import annotations

from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, finite_array
from pisplit.models.rod.answers import finite_answer
from pisplit.models.rod.sharing import lock_of

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene


def reactions(scene: Scene, x: ArrayLike) -> Array:
    """World force in N and moment in N m (..., 6) that the holder puts on the tip, of states ``x`` (..., n_states).

    Those of the motion that the state starts (its accelerations follow from the balance); at rest, those of the
    equilibrium. Of the stabilised conditions: see ``equations.held``.

    Raises ValueError for a ``scene`` whose tip is free, and for states so large that they overflow.
    """
    states = np.asarray(x, dtype=np.float64)
    flat = finite_array(states.reshape(-1, states.shape[-1]) if states.ndim else states, "x", (None, scene.n_states))
    with lock_of(scene):
        if "_reactions" not in scene.__dict__:
            xi, xi_t, xi_tt, u, balance = scene.dynamic_balance
            if balance.reaction is None:
                raise ValueError("the tip of this scene is free; add a HeldTip, or TipWrench for a given load")
            scene.__dict__["_reactions"] = ca.Function(
                "reactions", [xi, xi_t, xi_tt, u], [balance.reaction], {"cse": True}
            )
        parts = tuple(part.T for part in scene.layout.arguments(flat))
        bends = scene.acceleration.map(len(flat))(*parts) if len(flat) else np.empty((scene.n_strains, 0))
        made = scene.__dict__["_reactions"]
        found = np.asarray(made.map(len(flat))(*parts[:2], bends, parts[2])).T if len(flat) else np.empty((0, 6))
    return finite_answer(found, "reactions").reshape(*states.shape[:-1], 6)
