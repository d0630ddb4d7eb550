"""Parts of a recording in which columns stand in each other's place, turned or in another unit, told by the motion.

Where columns do not jump (commands that are held, another file, a state that passes through the other's value), one
thing tells that they are not what they were: a linear map from the last samples and commands to the next one, fitted
to a part of the recordings, predicts another part well only after two columns have changed places, one has turned its
sign, or has been multiplied by what lies between two units.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pisplit.data.suspicions import noise_level
from pisplit.data.unit_changes import FACTORS
from pisplit.data.warning import warn

Array = NDArray[np.float64]

#: Columns and rows that are looked at, at most; more rows are left out evenly.
COLUMNS, ROWS = 40, 4_000
#: Samples of states and of commands before the next one, rows for each regressor in the part that is learned from.
STATES, COMMANDS, ROWS_EACH = 2, 3, 4
#: States are averaged over so many samples, at most, until their steps are so many times their noise.
BINS, HEARD = (1, 2, 4, 8, 16), 10.0
#: Rows of a part that is told, at least, and the part of all.
FEWEST, LEAST = 40, 0.08
#: A change explains a part if residuals fall by this factor there, in the columns that it touches or all of them,
FALLS = 3.0
#: where a unit changes, by the ratio of the two units, or by this where that is larger,
UNIT_FALLS = 6.0
#: if they are then no more than so many times those of what was learned from,
EXPLAINED = 3.0
#: and if a map fitted to the part as it is mended predicts what was learned from better by that factor, too.
#: Columns move in both parts alike if their spreads differ by less than this factor; changes that are tried in turn.
ALIKE, TURNS = 4.0, 4
#: A state that stays so many times its motion away from zero does not change its sign there.
FAR_OFF = 2.0


@dataclass(frozen=True)
class Change:
    """Columns ``order`` (n + m,) and factors ``size`` (n + m,) by which a part would be mended; ``text`` says so."""

    order: NDArray[np.int64]
    size: Array
    text: str

    @property
    def touched(self) -> int:
        """Number of columns that change."""
        return int(((self.order != np.arange(len(self.order))) | (self.size != 1.0)).sum())

    def __call__(self, z: Array) -> Array:
        return z[..., self.order] * self.size


def say(
    xs: Sequence[Array], us: Sequence[Array], times: Sequence[Array], runs: Sequence[str], names: Sequence[str]
) -> None:
    """Warn of a part of episodes in which columns are not what they are in the others.

    xs, us  states (T_i + 1, n) and inputs (T_i, m), one array an episode
    times   (T_i + 1,) [s], one array an episode
    runs    (E,) names of the runs that the episodes are from
    names   (n + m,) of states and inputs
    """
    n, m = xs[0].shape[1], us[0].shape[1]
    if not 2 <= n + m <= COLUMNS:
        return
    data = _Rows.of(xs, us)
    if data is None:
        return
    found = max(
        (f for part in data.parts() if (f := _searched(data, part, n, names))), key=lambda f: f.gain, default=None
    )
    if found is None:
        return
    first, last = (data.where[k] for k in (found.start, found.stop - 1))
    label = f"{runs[first[0]]}, " if runs[first[0]] else ""
    end = f"{runs[last[0]]}, {times[last[0]][last[1]]:.6g} s" if runs[last[0]] else f"{times[last[0]][last[1]]:.6g} s"
    warn(
        f"{found.text}: so it looks from {label}{times[first[0]][first[1]]:.6g} s to {end}, where what other samples "
        f"teach predicts the next one {found.gain:.2g} times better then; were columns, signs or units changed there?"
    )


@dataclass(frozen=True)
class _Found:
    """The part of rows from ``start`` to ``stop`` - 1, what mends it, and by which factor residuals fall by that."""

    start: int
    stop: int
    text: str
    gain: float


@dataclass(frozen=True, eq=False)
class _Rows:
    """Histories of columns (N, W, n + m), the last sample of them the next one; ``where`` [(episode, step)] they end.

    noise  (n,) of the states, in their own units
    """

    z: Array
    n: int
    where: list[tuple[int, int]]
    floor: Array

    @classmethod
    def of(cls, xs: Sequence[Array], us: Sequence[Array]) -> _Rows | None:
        """None where there are too few rows, or noise hides the motion."""
        n = xs[0].shape[1]
        x = np.concatenate(list(xs))
        runs = np.split(np.arange(len(x)), np.cumsum([len(part) for part in xs])[:-1])
        noise = np.array([noise_level(column, runs) or 0.0 for column in x.T])
        moving = x.std(axis=0) > 1e-9 * np.abs(x).max(axis=0, initial=0.0)
        if not moving.any():
            return None
        for size in (*BINS, 1):
            binned = [_binned(a, b, size) for a, b in zip(xs, us, strict=True)]
            steps = np.concatenate([np.diff(z[:, :n], axis=0) for z in binned if len(z) > 1] or [np.zeros((0, n))])
            if len(steps) < 4 * FEWEST:
                continue
            heard = steps.std(axis=0) > HEARD * noise / np.sqrt(size)
            if heard[moving].mean() > 0.5:
                break
        window = max(STATES, COMMANDS) + 1
        ends = [(e, k) for e, z in enumerate(binned) for k in range(window - 1, len(z))]
        if len(ends) < 4 * FEWEST:
            return None
        kept = [ends[i] for i in np.unique(np.linspace(0, len(ends) - 1, min(len(ends), ROWS)).astype(int))]
        rows = np.array([binned[e][k - window + 1 : k + 1] for e, k in kept])
        where = [(e, k * size) for e, k in kept]
        floor = np.maximum(1e-6 * x.std(axis=0), 0.5 * _digit(xs))
        return cls(rows, n, where, np.where(floor > 0.0, floor, 1.0))

    def parts(self) -> Iterator[slice]:
        """Parts to learn from: the first quarter, the last, the two halves, the middle; those with rows enough."""
        size, columns = len(self.z), 1 + STATES * self.n + COMMANDS * (self.z.shape[2] - self.n)
        for a, b in ((0.0, 0.25), (0.75, 1.0), (0.0, 0.5), (0.5, 1.0)):
            part = slice(int(a * size), int(b * size))
            if part.stop - part.start >= ROWS_EACH * columns:
                yield part

    def regression(self, z: Array) -> tuple[Array, Array]:
        """Regressors (N, p) and next states (N, n) of rows ``z`` (N, W, n + m)."""
        n = self.n
        past = [z[:, -2 - k, :n] for k in range(STATES)] + [z[:, -1 - k, n:] for k in range(COMMANDS)]
        return np.hstack([np.ones((len(z), 1)), *past]), z[:, -1, :n]


def _digit(xs: Sequence[Array]) -> Array:
    """The smallest steps (n,) of states, which are those of rounding where it is coarse."""
    steps = np.abs(np.concatenate([np.diff(x, axis=0) for x in xs]))
    found: Array = np.where(steps > 0.0, steps, np.inf).min(axis=0)
    return np.where(np.isfinite(found), found, 0.0)


def _binned(x: Array, u: Array, size: int) -> Array:
    """States and the commands that led to them (K, n + m), means of ``size`` samples."""
    z = np.hstack([x[1:], u])
    count = len(z) // size
    return z[: count * size].reshape(count, size, z.shape[1]).mean(axis=1)


def _fitted(a: Array, y: Array) -> Array:
    """Least squares (p, n) with columns of one size, and a ridge that rounding needs."""
    scale = np.sqrt((a**2).mean(axis=0))
    scale = np.where(scale > 0.0, scale, 1.0)
    b = a / scale
    gram = b.T @ b
    gram[np.diag_indices(len(gram))] += 1e-9 * len(b)
    return np.asarray(np.linalg.solve(gram, b.T @ y)) / scale[:, None]


def _searched(data: _Rows, part: slice, n: int, names: Sequence[str]) -> _Found | None:
    """What mends a part of the rows beside that which is learned from, if anything does."""
    learned = data.z[part]
    a, y = data.regression(learned)
    k = _fitted(a, y)
    free = max(len(a) - a.shape[1], 1)
    usual = np.maximum(np.sqrt(((y - a @ k) ** 2).sum(axis=0) / free), data.floor)

    def cost(z: Array) -> Array:
        """(N, n) how far the next states are off, in steps of logarithms."""
        b, after = data.regression(z)
        return np.asarray(np.log1p(((after - b @ k) / usual) ** 2))

    now = cost(data.z).sum(axis=1)
    outside = np.ones(len(data.z), dtype=bool)
    outside[part] = False
    if np.median(now[outside]) < n * np.log1p(EXPLAINED**2) / 4.0 and np.quantile(now[outside], 0.97) < n:
        return None
    z, interval = data.z, (0, len(data.z))
    texts: list[str] = []
    turned, scale = np.zeros(len(names), dtype=bool), 1.0
    for _ in range(TURNS):
        tried = []
        for change in _changes(n, names, texts):
            gain = now - cost(change(z)).sum(axis=1)
            gain[part] = np.minimum(gain[part], 0.0)
            start, stop, total = _best(gain - 0.05 * n)
            tried.append((total, start, stop, change))
        most = max(t[0] for t in tried)
        total, start, stop, change = min((t for t in tried if t[0] >= 0.98 * most), key=lambda t: t[3].touched)
        if stop - start < max(FEWEST, LEAST * len(data.z)) or total <= 0.5 * (stop - start):
            break
        z = z.copy()
        z[start:stop] = change(z[start:stop])
        now = cost(z).sum(axis=1)
        texts.append(change.text)
        turned |= change.size < 0.0
        scale = max(scale, float(np.abs(change.size).max()), float(1.0 / np.abs(change.size).min()))
        interval = (start, stop) if len(texts) == 1 else (max(interval[0], start), min(interval[1], stop))
    if not texts or interval[1] - interval[0] < FEWEST:
        return None
    falls = max(FALLS, min(scale, UNIT_FALLS))
    return _confirmed(data, z, slice(*interval), k, usual, ", ".join(texts), part, turned, falls)


def _confirmed(
    data: _Rows,
    mended: Array,
    where: slice,
    k: Array,
    usual: Array,
    text: str,
    part: slice,
    turned: NDArray[np.bool_],
    least: float,
) -> _Found | None:
    """The part ``where`` as it is told, if what was learned explains it, and it explains what was learned.

    ``turned`` (n + m,) are columns whose sign is; residuals fall by the factor ``least`` at least.
    """
    n_states = data.n
    size = [np.subtract(*np.quantile(z[:, -1], [0.95, 0.05], axis=0)) for z in (mended[part], mended[where])]
    touched = (mended[where] != data.z[where]).any(axis=(0, 1))
    moved = touched & (size[0] > 0.0)
    if (size[1][moved] > ALIKE * size[0][moved]).any() or (ALIKE * size[1][moved] < size[0][moved]).any():
        return None

    low, middle, high = np.quantile(mended[part][:, -1, :n_states], [0.05, 0.5, 0.95], axis=0)
    one_sided = (low * high >= 0.0) & (np.abs(middle) < FAR_OFF * (high - low))
    if (turned[:n_states] & one_sided).any():  # a plant may be symmetric, and was on one side of it
        return None

    def residuals(z: Array, k: Array) -> Array:
        b, after = data.regression(z[where])
        return np.asarray(np.median(np.abs(after - b @ k) / usual, axis=0))

    before, after = residuals(data.z, k), residuals(mended, k)
    falls = before / np.maximum(after, 1e-12)
    worst = int(np.argmax(falls))
    if falls[worst] < least or after.max() > EXPLAINED * 3.0:
        return None
    inner = slice(where.start + mended.shape[1], where.stop - mended.shape[1])  # histories that do not cross its edges
    b, truth = data.regression(mended[part])
    back = []
    for z in (data.z, mended):
        backwards = _fitted(*data.regression(z[inner]))
        back.append(np.median(np.abs(truth - b @ backwards) / usual, axis=0))
    if (back[0] / np.maximum(back[1], 1e-12)).max() < least:
        return None
    return _Found(where.start, where.stop, text, float(falls[worst]))


def _best(gain: Array) -> tuple[int, int, float]:
    """Start, end and sum of the stretch of ``gain`` (N,) with the largest sum."""
    sums = np.concatenate([[0.0], np.cumsum(gain)])
    low = np.minimum.accumulate(sums)
    stop = int(np.argmax(sums - low))
    start = int(np.argmin(sums[: stop + 1]))
    return start, stop, float(sums[stop] - sums[start])


def _changes(n: int, names: Sequence[str], done: Sequence[str]) -> Iterator[Change]:
    """Changes of n states and the inputs behind them, those of whole markers and of all inputs among them."""
    size = len(names)
    same, ones = np.arange(size), np.ones(size)

    def exchanged(a: Sequence[int], b: Sequence[int]) -> Change:
        order = same.copy()
        order[list(a)], order[list(b)] = list(b), list(a)
        pairs = ", ".join(f"{names[i]} and {names[j]}" for i, j in zip(a, b, strict=True))
        return Change(order, ones, f"{pairs} have changed places")

    def scaled(which: Sequence[int], factor: float, text: str) -> Change:
        factors = ones.copy()
        factors[list(which)] = factor
        return Change(same, factors, text)

    kinds = range(n), range(n, size)
    for kind in kinds:
        for j in kind:
            for i in range(kind.start, j):
                yield exchanged([i], [j])
    if n % 3 == 0 and n > 3:
        for b in range(0, n, 3):
            for a in range(0, b, 3):
                yield exchanged(range(a, a + 3), range(b, b + 3))
    groups = [([i], names[i]) for i in range(size)]
    groups += [
        (list(kind), what) for kind, what in zip(kinds, ("all states", "all inputs"), strict=True) if len(kind) > 1
    ]
    for which, what in groups:
        yield scaled(which, -1.0, f"{what} {'has' if len(which) == 1 else 'have'} turned the sign")
        for factor in (*FACTORS, *(1.0 / f for f in FACTORS)):
            yield scaled(
                which, factor, f"{what} {'is' if len(which) == 1 else 'are'} {1.0 / factor:.3g} times as large"
            )
