"""How long after a command's time the motion follows, found from what predicts the next sample best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pisplit.data.onset import Onset, find_onset, rounded, unrounded_commands
from pisplit.data.suspicions import noise_level

Array = NDArray[np.float64]

#: Delays are tried up to so many seconds, or so many steps where that is more; never more than this part of an episode.
REACH, REACH_STEPS, REACH_PART = 0.3, 10, 0.25
#: Samples of history, and principal components of the states, that the prediction starts from: so many, and fewer where
#: there are not so many pairs for each.
HISTORY, COMPONENTS, PAIRS_EACH = 4, 16, 40
#: Stretches of pairs that are learned from and judged on in turn; the most pairs that are looked at.
STRETCH, PAIRS = 10, 6_000
#: Noise of a state in parts of its spread, below which it is taken for so much.
QUIET = 1e-3
#: Components of the states are used from so many times the noise on; noise is averaged away to this part of the steps.
HEARD, AUDIBLE = 3.0, 0.05
#: Commands move along a direction if by more than this part of the largest.
DIRECTION = 0.03
#: Pairs that move by more than so many of the largest usual steps are spikes of a sensor, not motion.
SPIKE = 4.0
#: One tap of the commands is enough if its residual exceeds that of two by no more than this part.
ENOUGH = 0.05
#: A delay is told only where it predicts better than the usual one by this part.
VISIBLE = 0.1
#: Where the best delay does not predict the next sample by this part better than the usual one, motion is looked at
#: over all commands.
SAMPLES = 0.3
#: A delay that is not known to this part of what was tried is not told.
CLEAR = 0.5
#: Motion that its own past predicts to this residual, whatever the delay, does not show what commands do.
ALONE = 1e-3


@dataclass(frozen=True, eq=False)
class Latency:
    """When the motion follows the commands.

    delay     [s] from the time of a command to that of the motion that it makes; negative: the motion comes first, so
              that the clocks are not one; None where commands do not tell
    error     [s] within which it is: a step, where noise hides the first of a motion up to two, or where delays predict
              alike
    residual  root mean square of one-step residuals at ``delay``, over that of steps themselves
    usual     the median of it over all delays that were tried
    tried     (G, 2) delays in s and residuals
    begins    whether it is the time at which the motion begins, found over all samples where the next one does not tell
    """

    delay: float | None
    error: float
    residual: float
    usual: float
    tried: Array
    begins: bool = False

    def __str__(self) -> str:
        if self.delay is None:
            return "not visible: commands predict the motion about as well at many delays"
        which = "after" if self.delay >= 0.0 else "BEFORE"
        return f"{1e3 * abs(self.delay):.3g} ms (within {1e3 * self.error:.0f} ms) {which} the commands"


def find_latency(xs: Sequence[Array], us: Sequence[Array], dt: float) -> Latency:
    """Scan the delay between commands and motion: that at which a linear map predicts the next sample best.

    Where no delay predicts it much better than the others, because of noise or of motion that goes on by itself, the
    delay is that after which commands tell anything of the motion (:func:`pisplit.data.onset.find_onset`).

    The map takes four samples of up to 16 principal components of the states, each weighed by its noise, and the
    command, shifted by a delay that need not be whole steps; it is fitted to one half of the pairs and judged on the
    other. Where noise is large beside the steps, states and commands pass the same moving average.

    xs, us  states (T_i + 1, n) and inputs (T_i, m), one array an episode, row k held from sample k to k + 1
    dt      step [s]

    ``delay`` is None where the inputs rest, the episodes are too short, or no delay stands out. Commands that a
    controller made from these states do not mislead it: what they do to the next sample tells more than what they know.

    Source: time delay estimation by explicit delay models, Bjorklund, A Survey and Comparison of Time-Delay Estimation
    Methods in Linear Systems, Linkoping 2003, ch. 3.
    """
    longest = max(map(len, us))
    reach = int(min(max(REACH / dt, REACH_STEPS), REACH_PART * longest))
    data = _Pairs.of(xs, us, reach)
    if data is None or reach < 1:
        return Latency(None, np.inf, 1.0, 1.0, np.zeros((0, 2)))
    grid = np.arange(-2 * reach, 2 * reach + 1) / 2.0
    curves = {taps: np.array([data.residual(d, taps) for d in grid]) for taps in (1, 2)}
    taps = 1 if curves[1].min() <= (1.0 + ENOUGH) * curves[2].min() else 2
    curve = curves[taps]
    best, least = float(grid[curve.argmin()]), float(curve.min())
    usual = float(np.median(curve))
    step = 0.25
    while step > 0.02:
        for candidate in (best - step, best + step):
            value = data.residual(candidate, taps) if abs(candidate) <= reach else np.inf
            if value < least:
                best, least = candidate, value
        step *= 0.5
    tried = np.column_stack([dt * grid, curve])
    if usual >= ALONE and least > (1.0 - SAMPLES) * usual:
        onset = _onset(xs, us, data, reach)
        if onset is not None and onset.error <= CLEAR * reach:
            return Latency(dt * onset.delay, dt * onset.error, least, usual, tried, True)
    if usual < ALONE or not least < (1.0 - VISIBLE) * usual:
        return Latency(None, np.inf, least, usual, tried)
    alike = grid[curve**2 <= least**2 * (1.0 + 40.0 / data.judged)]
    error = max(1.0 + min(1.0, 3.0 * least), float(np.abs(alike - best).max(initial=0.0)))
    told = error <= max(2.0, CLEAR * reach) and abs(best) <= reach - 1.0  # beyond the end there may be a better one
    return Latency(dt * best if told else None, dt * error if told else np.inf, least, usual, tried)


def _onset(xs: Sequence[Array], us: Sequence[Array], data: _Pairs, reach: int) -> Onset | None:
    """When the motion begins; of rounded commands as they may have been before, None where they hide it."""
    if not rounded(us):
        return find_onset(*data.whole, reach)
    smooth = unrounded_commands(us)
    again = None if smooth is None else _Pairs.of(xs, smooth, reach)
    return None if again is None else find_onset(*again.whole, reach)


def _averaged(z: Array, u: Array, reach: int) -> tuple[Array, Array]:
    """Means of states (T+1, r), whose noise is one at most, and of inputs (T, m) over as many samples as it takes.

    Noise is then small beside the steps; both pass the same window, which moves neither against the other.
    """
    steps = float(np.sqrt((np.diff(z, axis=0) ** 2).sum(axis=1).mean() / 2.0))
    size = 1 + 2 * min(reach // 4, round(float(np.clip(0.5 / (AUDIBLE * max(steps, 1e-300)), 0.0, reach))))
    if size == 1:
        return z, u
    from scipy.ndimage import uniform_filter1d  # a third of a second, for recordings with noise alone

    smooth = [np.asarray(uniform_filter1d(part, size, axis=0, mode="nearest")) for part in (z, u)]
    return smooth[0], smooth[1]


def _components(
    xs: Sequence[Array], us: Sequence[Array], middle: Array, scale: Array, axes: Array
) -> tuple[list[Array], list[Array]]:
    """Components of the states along ``axes`` (r, n), and the commands along the directions in which they move."""
    u = np.concatenate(list(us))
    mean = u.mean(axis=0)
    _, sizes, directions = np.linalg.svd(u - mean, full_matrices=False)
    moved = directions[sizes > DIRECTION * sizes[0]].T
    return [((x - middle) / scale) @ axes.T for x in xs], [(v - mean) @ moved for v in us]


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Pairs far from the ends of their episodes: histories (N, h), steps (N, r), commands around each (N, w, m).

    ``whole``: components of the states (T_i + 1, r) and directions of the commands (T_i, q) in each episode.
    """

    history: Array
    step: Array
    commands: Array
    reach: int
    even: NDArray[np.bool_]
    whole: tuple[list[Array], list[Array]]

    @classmethod
    def of(cls, xs: Sequence[Array], us: Sequence[Array], reach: int) -> _Pairs | None:
        """None where there are too few, or nothing moves."""
        x, u = np.concatenate(list(xs)), np.concatenate(list(us))
        spread, mean = x.std(axis=0), u.mean(axis=0)
        moving, commanded = spread > 1e-9 * np.abs(x).max(axis=0, initial=0.0), np.ptp(u, axis=0) > 0.0
        if not moving.any() or not commanded.any():
            return None
        runs = np.split(np.arange(len(x)), np.cumsum([len(part) for part in xs])[:-1])
        noise = np.array([noise_level(column, runs) or 0.0 for column in x.T])
        scale = np.where(moving, np.maximum(noise, QUIET * spread), np.inf)
        _, sizes, axes = np.linalg.svd(((x - x.mean(axis=0)) / scale)[:: max(1, len(x) // PAIRS)], full_matrices=False)
        heard = int((sizes > HEARD * np.sqrt(len(x[:: max(1, len(x) // PAIRS)]))).sum())
        parts: list[tuple[Array, Array, Array]] = []
        thin = max(1, len(u) // PAIRS)
        for states, inputs in zip(xs, us, strict=True):
            z = ((states - x.mean(axis=0)) / scale) @ axes[: max(2, min(COMPONENTS, heard, len(u) // PAIRS_EACH))].T
            z, inputs = _averaged(z, inputs, reach)
            k = np.arange(max(HISTORY - 1, reach + 1), len(inputs) - reach - 1, thin)
            if len(k) == 0:
                continue
            history = np.hstack([z[k - lag] for lag in range(HISTORY)])
            around = (inputs[:, commanded] - mean[commanded])[k[:, None] + np.arange(-reach - 2, reach + 2)[None]]
            parts.append((history, z[k + 1] - z[k], around))
        if sum(len(step) for _, step, _ in parts) < 20 * HISTORY:
            return None
        history, step, around = (np.concatenate(part) for part in zip(*parts, strict=True))
        r = step.shape[1]
        moves = np.abs(np.hstack([step, history[:, :-r] - history[:, r:]])).max(axis=1)
        calm = moves <= SPIKE * float(np.quantile(moves, 0.95))
        history, step, around = history[calm], step[calm], around[calm]
        even = (np.arange(len(step)) // STRETCH) % 2 == 0
        return cls(
            history, step, around, reach, even, _components(xs, us, x.mean(axis=0), scale, axes[: max(1, heard)])
        )

    @property
    def judged(self) -> int:
        return int((~self.even).sum())

    def residual(self, delay: float, taps: int) -> float:
        """Root mean square residual of pairs that were not fitted, relative to the steps; ``delay`` in steps."""
        whole = int(np.floor(delay))
        part, now = delay - whole, self.reach + 2 - whole
        last = self.commands.shape[1] - 1
        columns = [
            (1.0 - part) * self.commands[:, min(max(now - tap, 0), last)]
            + part * self.commands[:, min(max(now - tap - 1, 0), last)]
            for tap in range(taps)
        ]
        a = np.hstack([np.ones((len(self.step), 1)), self.history, *columns])
        size = np.sqrt(np.mean(a**2, axis=0))
        a = a / np.where(size > 0.0, size, 1.0)
        gram = a[self.even].T @ a[self.even]
        gram[np.diag_indices_from(gram)] += 1e-9 * max(float(np.trace(gram)) / len(gram), 1e-300)
        found = np.linalg.solve(gram, a[self.even].T @ self.step[self.even])
        rest = self.step[~self.even] - a[~self.even] @ found
        return float(np.sqrt((rest**2).sum() / max(float((self.step[~self.even] ** 2).sum()), 1e-300)))
