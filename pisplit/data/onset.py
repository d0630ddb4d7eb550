"""When the motion begins to follow the commands, where noise hides it from one sample to the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pisplit.data.rounding import rounding, smoothest

Array = NDArray[np.float64]

#: Samples of old history, and a step between them in parts of the longest delay; components that are looked at.
HISTORY, SPACING, COMPONENTS = 4, 1.0 / 6.0, 6
#: The state so long before, in longest delays, stands for all commands before that.
MEMORY = 2.5
#: What commands tell grows as a power of the time that they are known for: at once, through one integration, two.
POWERS = (1, 2, 4)
#: The growth is fitted up to each of these parts of what the latest commands tell, over so many delays at most, and
#: looked at where that is so much [nats].
PARTS, WINDOW, TOLD = (0.05, 0.1), 30, 0.3
#: Times at which the growth may begin, in steps; by how much its misfit may grow within what is told, and by how much
#: that of a force may exceed that of a velocity.
FINE, MISFIT, LIKELY = 0.1, 2.0, 3.0
#: Commands that are rounded to more than this part of their usual change are guessed from those that follow; up to the
#: second, as smooth as they may have been they show the beginning all the same.
ROUNDED, SMOOTHED = 0.006, 0.03
#: Commands are steady if so much of the time a new one comes at each of its turns.
STEADY = 0.7
#: Fewest delays that a growth is fitted to.
FEWEST = 8
#: No beginning is known better [steps].
SHARPEST = 1.5
#: The most delays that are tried either way, and rows: longer recordings are averaged over steps, or thinned.
DELAYS, ROWS = 40, 10_000


@dataclass(frozen=True)
class Onset:
    """When the motion begins: ``delay`` after the time of its command, known to ``error``, both in steps."""

    delay: float
    error: float


def find_onset(zs: Sequence[Array], us: Sequence[Array], reach: int) -> Onset | None:
    """The least delay at which commands tell anything of the motion, None where none stands out.

    States are regressed on states ``MEMORY * reach`` samples before and on all commands since then but the latest, left
    out one by one: what is lost is nothing as long as these come after the motion, and then grows as an even power of
    the time for which they were left out, the second for a velocity that is commanded, the fourth for a force, which is
    taken where the data allow it. Noise is averaged over all samples, unlike in predictions of the next one. Commands
    that are rounded coarsely are guessed from later ones, and do not show it.

    zs     (T_i + 1, r) components of the states, by size, those that are heard
    us     (T_i, m) inputs
    reach  largest delay that is tried, either way, in samples

    Source: delay estimation from estimated impulse responses, Bjorklund, A Survey and Comparison of Time-Delay
    Estimation Methods in Linear Systems, Linkoping 2003, ch. 3.
    """
    many = -(-reach // DELAYS)
    if many > 1:
        us = [u[: len(u) // many * many].reshape(-1, many, u.shape[1]).mean(axis=1) for u in us]
        zs = [z[::many][: len(u) + 1] for z, u in zip(zs, us, strict=True)]
    gains = _told(zs, us, reach // many)
    if gains is None:
        return None
    delays, lost = gains
    quiet = float(np.median(lost[: max(3, len(lost) // 4)]))
    top = float(lost[-1]) - quiet
    if top < TOLD:
        return None
    begins: list[tuple[float, float]] = []
    for part in PARTS:
        last = int(np.argmax(lost - quiet > part * top)) + 1
        if last < FEWEST:
            return None
        begins.append(_begin(delays[max(0, last - WINDOW) : last], lost[max(0, last - WINDOW) : last]))
    (first, near), (second, far) = begins
    error = max(SHARPEST, min(near, far), 0.5 * abs(first - second))
    return Onset(many * 0.5 * (first + second), many * error)


def rounded(us: Sequence[Array]) -> bool:
    """Whether any of the inputs ``us`` (T_i, m) is written so coarsely that later ones tell what was rounded away."""
    return any(_rounding(column) > ROUNDED for column in np.concatenate(list(us)).T)


def unrounded_commands(us: Sequence[Array]) -> list[Array] | None:
    """Inputs ``us`` (T_i, m) as smooth as they may have been before they were rounded; None where nobody can tell.

    They are when they come at a steady rate, one sample or several for each, and rounding is small beside their usual
    change.
    """
    every = np.concatenate(list(us))
    if any(_rounding(column) > SMOOTHED for column in every.T):
        return None
    new = [np.flatnonzero((np.diff(u, axis=0) != 0.0).any(axis=1)) + 1 for u in us]
    waits = np.concatenate([np.diff(at) for at in new])
    if not len(waits):
        return None
    rate = int(waits.min())
    sizes = [rounding(column) for column in every.T]
    found = []
    for u, at in zip(us, new, strict=True):
        first = int(at[0] % rate) if len(at) else 0
        if ((at - first) % rate).any() or len(at) * rate < STEADY * len(u):
            return None
        sent = np.vstack([u[:1], u[first::rate]]) if first else u[::rate]
        smooth = np.column_stack([smoothest(v, size) for v, size in zip(sent.T, sizes, strict=True)])
        held = np.repeat(smooth[1:] if first else smooth, rate, axis=0)
        found.append(np.vstack([np.repeat(smooth[:1], first, axis=0), held])[: len(u)])
    return found


def _rounding(u: Array) -> float:
    """Standard deviation of what rounding takes from commands (N,), over that of their changes."""
    steps, levels = np.diff(u), np.diff(np.unique(u))
    size = np.ptp(u)
    moved, levels = steps[np.abs(steps) > 1e-9 * size], levels[levels > 1e-9 * size]
    return float(levels.min() / np.sqrt(12.0 * (moved**2).mean())) if len(moved) and len(levels) else 0.0


def _begin(delays: Array, lost: Array) -> tuple[float, float]:
    """Where the growth of ``lost`` (G,) over ``delays`` (G,) begins, and within what, by least squares."""
    starts = np.arange(delays[0], delays[-1] - 1.0, FINE)
    misfits = np.array([[_misfit(delays, lost, start, power) for start in starts] for power in POWERS])
    least = misfits.min(axis=1)
    kind = len(POWERS) - 1 if least[-1] <= LIKELY * least.min() else int(least.argmin())
    alike = starts[misfits[kind] <= MISFIT * least[kind]]
    return float(starts[misfits[kind].argmin()]), 0.5 * float(np.ptp(alike))


def _misfit(delays: Array, lost: Array, start: float, power: int) -> float:
    growth = np.clip(delays - start, 0.0, None) ** power
    a = np.column_stack([np.ones(len(delays)), growth / max(growth.max(), 1e-300)])
    found = np.linalg.lstsq(a, lost, rcond=None)[0]
    return float(((lost - a @ found) ** 2).sum()) if found[1] > 0.0 else np.inf


def _told(zs: Sequence[Array], us: Sequence[Array], reach: int) -> tuple[Array, Array] | None:
    """Delays (G,) in samples, and log residual variances (G,) without commands of less than each; None if too short."""
    memory, step = round(MEMORY * reach), max(1, round(SPACING * reach))
    back = memory + (HISTORY - 1) * step
    thin = max(1, sum(map(len, us)) // ROWS)
    after: list[Array] = []
    before: list[Array] = []
    around: list[Array] = []
    for z, u in zip(zs, us, strict=True):
        k = np.arange(back, len(u) - reach, thin)
        if len(k):
            after.append(z[k, :COMPONENTS])
            before.append(np.hstack([z[k - memory - i * step] for i in range(HISTORY)]))
            around.append(u[k[:, None] - np.arange(-reach, memory)])
    if not after:
        return None
    y, commands = np.concatenate(after), np.concatenate(around)
    blocks = range(2 * reach + 1, commands.shape[1], step)
    old = [commands[:, at : at + step].mean(axis=1) for at in blocks]
    basis = _orthonormal(np.hstack([np.ones((len(y), 1)), np.concatenate(before), *old]))
    if len(y) < 4 * (basis.shape[1] + commands.shape[2] * (2 * reach + 1)):
        return None
    rest, lost = y - basis @ (basis.T @ y), []
    for at in range(2 * reach, -1, -1):
        new = commands[:, at]
        size = np.linalg.norm(new, axis=0).max()
        for _ in range(2):
            new = new - basis @ (basis.T @ new)
        added = _orthonormal(new, 1e-4 * size)
        basis, rest = np.hstack([basis, added]), rest - added @ (added.T @ rest)
        lost.append(np.log((rest**2).sum(axis=0) / (len(y) - basis.shape[1])).sum())
    return np.arange(-reach, reach + 1.0), np.array(lost[::-1])


def _orthonormal(a: Array, least: float | None = None) -> Array:
    """Orthonormal columns that span those of ``a``: of unit columns without a ``least`` singular value."""
    if least is None:
        size = np.linalg.norm(a, axis=0)
        a, least = a / np.where(size > 0.0, size, 1.0), 1e-9
    u, sizes, _ = np.linalg.svd(a, full_matrices=False)
    return np.asarray(u[:, sizes > least])
