"""One control interval in as many large steps as it needs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from pisplit.checks import Array

#: Defect at the start of a step up to which it is taken: see ``FastStepper``.
SMALL_DEFECT = 0.01
#: How often a control interval is halved before IDAS takes it.
MAX_HALVINGS = 9
#: Error and defect, in parts of the largest ones allowed, below which the next step is twice as long.
EASY, SLIGHT = 0.02, 0.1


@dataclass(frozen=True)
class Step:
    """[xi, xi_t] at the ``end`` of a step that converged, and its ``defect``."""

    end: Array
    defect: float


@dataclass
class Walk:
    """An interval as it was taken.

    Attributes:
        end: [xi, xi_t] behind it.
        error: estimated, in m.
        depth: binary logarithm of the number of the last pieces in an interval.
        cuts: where it was cut, in parts of it, from 0 to 1.
    """

    end: Array
    error: float = 0.0
    depth: int = 0
    cuts: list[float] = field(default_factory=lambda: [0.0])


@dataclass(frozen=True)
class Pieces:
    """Steps through an interval, halved until each passes.

    A piece with a small defect is taken as it is; the one with the largest is done again in halves, which tells what a
    defect is worth in metres. Others are compared with their own halves, which are taken.

    Attributes:
        step: ``(x, u0, u1, h) -> Step`` or None where it does not converge.
        distance: ``(x, y, u) -> `` distance of two shapes under the inputs u, in m.
        dt: control interval in s.
        largest: error in m that a piece may have.
        coarsest: binary logarithm of the least number of pieces.
    """

    step: Callable[[Array, Array, Array, float], Step | None]
    distance: Callable[[Array, Array, Array], float]
    dt: float
    largest: float
    coarsest: int = 0

    def through(self, x: Array, u: tuple[Array, Array], depth: int, whole: Step | None) -> Walk:
        """The interval from ``x``, inputs from the first to the second of ``u``, at first in 2^``depth`` pieces.

        ``whole``: the interval as one step, if that is known.

        Raises RuntimeError beyond the last halving.
        """
        walk, judged = self._walk(x, u, depth, whole, SMALL_DEFECT)
        if not judged:
            return walk
        start, end, defect, before, after, h = max(judged, key=lambda piece: piece[2])
        error = self.halves(start, end, before, after, h) * sum(p[2] for p in judged) / max(defect, 1e-300)
        if not error <= self.largest:
            return self._walk(x, u, walk.depth, None, -1.0)[0]
        walk.error += error
        return walk

    def halves(self, x: Array, end: Array, before: Array, after: Array, h: float) -> float:
        """How far ``end`` is from where two steps of half the length h from ``x`` lead, in m; infinite if nowhere.

        ``before`` and ``after`` are the inputs at start and end.
        """
        middle = 0.5 * (before + after)
        first = self.step(x, before, middle, 0.5 * h)
        second = None if first is None else self.step(first.end, middle, after, 0.5 * h)
        return np.inf if second is None else self.distance(second.end, end, after)

    def _walk(
        self, x: Array, u: tuple[Array, Array], depth: int, whole: Step | None, small: float
    ) -> tuple[Walk, list[tuple[Array, Array, float, Array, Array, float]]]:
        """As ``through``, and the pieces that were taken for a defect that is ``small``."""
        full = 1 << MAX_HALVINGS
        walk, judged = Walk(x, depth=max(depth, self.coarsest)), []
        done, whole = 0, whole if walk.depth == 0 else None
        while done < full:
            piece = full >> walk.depth
            h = self.dt * piece / full
            at = [u[0] + (u[1] - u[0]) * ((done + part * piece) / full) for part in (0.0, 0.5, 1.0)]
            whole = self.step(walk.end, at[0], at[2], h) if whole is None else whole
            first = second = None
            easy = False
            if whole is not None and whole.defect <= small:
                judged.append((walk.end, whole.end, whole.defect, at[0], at[2], h))
                second, easy = whole, whole.defect <= SLIGHT * small
                walk.cuts.append((done + piece) / full)
            else:
                first = self.step(walk.end, at[0], at[1], 0.5 * h)
                second = None if first is None else self.step(first.end, at[1], at[2], 0.5 * h)
                apart = np.inf
                if whole is not None and second is not None:
                    apart = self.distance(whole.end, second.end, at[2])
                if apart <= self.largest:
                    walk.cuts += [(done + 0.5 * piece) / full, (done + piece) / full]
                    walk.error, easy = walk.error + apart, apart < EASY * self.largest
                else:
                    second = None
            if second is not None:
                walk.end, done, whole = second.end, done + piece, None
                if easy and walk.depth > self.coarsest and done % (2 * piece) == 0:
                    walk.depth -= 1
            elif walk.depth == MAX_HALVINGS:
                raise RuntimeError(f"steps of {h:.1e} s are too large")
            else:
                walk.depth, whole = walk.depth + 1, first
        return walk, judged
