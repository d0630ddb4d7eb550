"""What holds the tip and the base of a rod."""

from __future__ import annotations

from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, finite_array
from pisplit.models.rod.answers import finite_answer
from pisplit.models.rod.sharing import lock_of

if TYPE_CHECKING:
    from pisplit.models.rod.equations.balance import Balance
    from pisplit.models.rod.scene import Scene


def reactions(scene: Scene, x: ArrayLike) -> Array:
    """World force in N and moment in N m (..., 6) that the holder puts on the tip, of states ``x`` (..., n_states).

    Those of the motion that the state starts (its accelerations follow from the balance); at rest, those of the
    equilibrium. Of the stabilised conditions: see ``equations.held``.

    Raises ValueError for a ``scene`` whose tip is free, and for states so large that they overflow.
    """
    return _read(scene, x, "_reactions", "reactions")


def base_reactions(scene: Scene, x: ArrayLike) -> Array:
    """World force in N and moment in N m (..., 6) that the support puts on the base, of states ``x`` (..., n_states).

    They balance all loads and the inertia of the motion that the state starts. Tendons and chambers are held by the
    base plate itself: what they pull there is not in it. Zero where a joint is free.

    Raises ValueError for states of another ``scene`` or so large that they overflow.
    """
    return _read(scene, x, "_base_reactions", "base reactions")


def _wrench(scene: Scene, balance: Balance, name: str) -> ca.SX:
    if name == "_base_reactions":
        return -ca.vertcat(*balance.base_wrench)
    if balance.reaction is None:
        raise ValueError("the tip of this scene is free; add a HeldTip, or TipWrench for a given load")
    return balance.reaction


def _read(scene: Scene, x: ArrayLike, name: str, what: str) -> Array:
    states = np.asarray(x, dtype=np.float64)
    flat = finite_array(states.reshape(-1, states.shape[-1]) if states.ndim else states, "x", (None, scene.n_states))
    with lock_of(scene):
        if name not in scene.__dict__:
            xi, xi_t, xi_tt, u, balance = scene.dynamic_balance
            wrench = _wrench(scene, balance, name)
            scene.__dict__[name] = ca.Function("reactions", [xi, xi_t, xi_tt, u], [wrench])
        parts = tuple(part.T for part in scene.layout.arguments(flat))
        bends = scene.acceleration.map(len(flat))(*parts) if len(flat) else np.empty((scene.n_strains, 0))
        made = scene.__dict__[name]
        found = np.asarray(made.map(len(flat))(*parts[:2], bends, parts[2])).T if len(flat) else np.empty((0, 6))
    return finite_answer(found, what).reshape(*states.shape[:-1], 6)
