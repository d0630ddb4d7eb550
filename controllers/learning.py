"""A plant and a reference as an environment of Gymnasium, for controllers that learn: pip install pisplit[gym]."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, count
from pisplit.controllers.loop.plant import Plant
from pisplit.controllers.mpc.limits import input_limits
from pisplit.controllers.references import Reference


def environment(
    plant: Plant,
    reference: Reference,
    u_min: ArrayLike,
    u_max: ArrayLike,
    du_max: ArrayLike,
    tracked: Sequence[int],
    steps: int,
    ahead: int = 1,
    u0: ArrayLike | None = None,
) -> Any:
    """A ``gymnasium.Env`` in which actions move a plant's inputs and rewards are minus the distance from a reference.

    An action (m,) between -1 and 1 is the change of the inputs in parts of ``du_max``; what is applied never leaves
    the limits. An observation holds the measured states (n,), the input (m,) and the next ``ahead`` samples of the
    reference (ahead p,), zero where it is free. An episode is truncated after ``steps`` steps, and terminated where the
    plant fails; ``info`` tells the applied input "u", the "distance" and the plant's "message".

    Args:
        plant: what moves; states that are NaN end an episode.
        reference: of the ``tracked`` states.
        u_min: lower limits of the inputs, a number or (m,).
        u_max: upper limits.
        du_max: largest change a step.
        tracked: positions (p,) of the states that the reference is for.
        steps: of an episode.
        ahead: samples of the reference that are seen.
        u0: input (m,) at the start, the middle of the limits if not given.

    Raises ValueError where gymnasium is not installed, and for limits and references that do not fit.
    """
    try:
        gym: Any = importlib.import_module("gymnasium")
    except ImportError:
        raise ValueError("this needs the package gymnasium; pip install pisplit[gym]") from None
    limits, rows = input_limits(u_min, u_max, du_max, plant.n_inputs), list(tracked)
    if reference.width != len(rows):
        raise ValueError(f"the reference has {reference.width} coordinates, tracked {len(rows)} states; give one each")
    T, H, m = count(steps, "steps"), count(ahead, "ahead"), plant.n_inputs
    start = 0.5 * (limits.u_min + limits.u_max) if u0 is None else np.array(u0, dtype=np.float64)
    size = plant.n_states + m + H * len(rows)

    class PlantEnvironment(gym.Env):
        metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012
        action_space = gym.spaces.Box(-1.0, 1.0, (m,), np.float64)
        observation_space = gym.spaces.Box(-np.inf, np.inf, (size,), np.float64)

        def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, Any]:
            super().reset(seed=seed)
            self._u, self._k = limits.project(start, start), 0
            self._x = np.array(plant.reset(self._u.copy()), dtype=np.float64)
            self._wanted = reference.starting_at(self._x[rows])(plant.dt * np.arange(T + H + 1))
            return self._seen(), {}

        def step(self, action: ArrayLike) -> tuple[Array, float, bool, bool, dict[str, Any]]:
            change = np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0) * limits.du_max
            self._u = limits.project(self._u + change, self._u)
            after = plant.step(self._u.copy())
            self._k += 1
            state = np.array(after.state, dtype=np.float64)
            failed = not after.ok or not np.isfinite(state).all()
            if not failed:
                self._x = state
            distance = float(np.sqrt(np.nansum((self._x[rows] - self._wanted[self._k]) ** 2)))
            info = {"u": self._u.copy(), "distance": distance, "message": after.message}
            return self._seen(), -distance, failed, self._k >= T, info

        def _seen(self) -> Array:
            coming = np.nan_to_num(self._wanted[self._k + 1 : self._k + 1 + H]).ravel()
            return np.concatenate([self._x, self._u, coming])

    return PlantEnvironment()
