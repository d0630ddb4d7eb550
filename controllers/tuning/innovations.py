"""The gain of the disturbance estimate that leaves the smallest, whitest innovations on recordings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pisplit.checks import Array
from pisplit.data.episodes import Episodes
from pisplit.lifted.model import LiftedModel

#: Gains that are compared, and the part of the smallest innovation that a smaller gain may cost.
GAINS, SLACK = np.geomspace(0.01, 1.0, 25), 1e-3


@dataclass(frozen=True)
class Innovations:
    """``gain`` of the estimate; ``size`` (p,): root mean square of the innovations of the outputs under it;
    ``correlation``: of one with the next, zero where they are white; ``without``: the same at gain zero."""

    gain: float
    size: Array
    correlation: float
    without: float


@dataclass(frozen=True, eq=False)
class Misses:
    """What a model missed in a step, along recordings: ``lifted`` (K, M) one after the other; of the tracked outputs in
    parts of their scale, ``outputs`` (T, p) an episode; ``rows`` (p,): their states, ``scale`` (p,); ``speed``: root
    mean square of their change in a step."""

    lifted: Array
    outputs: tuple[Array, ...]
    rows: tuple[int, ...]
    scale: Array
    speed: float

    def speed_of(self, change: Array) -> float:
        """Size of a ``change`` of the states (n,), as ``speed`` counts it."""
        return float(np.linalg.norm(change[list(self.rows)] / self.scale))

    @property
    def lasting(self) -> Array:
        """The recorded miss (M,) of the size that is usual, as a push that lasts."""
        sizes = (np.concatenate(self.outputs) ** 2).sum(axis=1)
        return np.asarray(self.lifted[int(np.argmin(np.abs(sizes - sizes.mean())))])

    @classmethod
    def of(cls, model: LiftedModel, episodes: Episodes, rows: tuple[int, ...], scale: Array) -> Misses:
        """Those of the ``model`` along ``episodes``, in the states ``rows`` (p,), which have the size ``scale`` (p,).

        Raises ValueError where no episode is longer than the delays of the model.
        """
        lifted, outputs, changes, D = [], [], [], model.n_delays
        for x, u in zip(episodes.xs, episodes.us, strict=True):
            if len(u) <= D + 2:
                continue
            at = np.arange(D, len(u))
            z = model.lift(x[at[:, None] + np.arange(-D, 1)], u[at[:, None] + np.arange(-D, 0)])
            after = model.lift(x[at[:, None] + np.arange(1 - D, 2)], u[at[:, None] + np.arange(1 - D, 1)])
            predicted = model.rollout(z, u[at][:, None]).z[:, 1]
            lifted.append(after - predicted)
            outputs.append((x[at + 1] - model.read(predicted))[:, list(rows)] / scale)
            changes.append(np.diff(x[:, list(rows)], axis=0) / scale)
        if not lifted:
            raise ValueError(f"no episode is longer than the {D} delays of the model: nothing can be tuned")
        speed = float(np.sqrt(np.mean((np.concatenate(changes) ** 2).sum(axis=1))))
        return cls(np.concatenate(lifted), tuple(outputs), rows, scale, max(speed, 1e-300))


def innovations(misses: Misses) -> Innovations:
    """The gain g of w+ = w + g (miss - w) whose innovations miss - w, in the tracked outputs, are smallest and white.

    ``misses``: of a model along recordings.
    """
    parts = list(misses.outputs)
    sizes = np.array([_power(_innovations(parts, g)) for g in GAINS])
    best = int(np.argmax(sizes <= (1.0 + SLACK) * sizes.min()))
    left = _innovations(parts, float(GAINS[best]))
    rms = np.sqrt(np.mean(np.concatenate(left) ** 2, axis=0)) * misses.scale
    return Innovations(float(GAINS[best]), rms, _correlation(left), _correlation(parts))


def _innovations(misses: list[Array], gain: float) -> list[Array]:
    found = []
    for miss in misses:
        w, left = np.zeros(miss.shape[1]), np.empty_like(miss)
        for k, m in enumerate(miss):
            left[k] = m - w
            w = w + gain * left[k]
        found.append(left)
    return found


def _power(parts: list[Array]) -> float:
    return float(np.mean(np.concatenate(parts) ** 2))


def _correlation(parts: list[Array]) -> float:
    product = sum(float((p[1:] * p[:-1]).sum()) for p in parts)
    return product / max(sum(float((p**2).sum()) for p in parts), 1e-300)
