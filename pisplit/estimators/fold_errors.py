"""Errors of held-out roll-outs, fold by fold: what they say together, and whether a part of them decides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pisplit.estimators.folds import Fold
from pisplit.evaluation.matching import States, state_indices
from pisplit.evaluation.rollouts import rollout_errors
from pisplit.lifted.model import LiftedModel

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Errors below this part of the largest of a fold are equal: rounding is no reason to prefer one.
FLOOR = 1e-20
#: A part of the evidence decides if the rest of it would choose something with errors so many times smaller there.
DECIDES = 2.0
#: Beginnings of roll-outs that are looked at alone, and what decides where they would choose something else.
PARTS = {2 / 3: "the last third", 0.1: "all but the first tenth"}
#: Advice for roll-outs that went to the end of recordings, and for those that did not.
ADVICE = ("; or set cv_horizon to the steps you need, as for unstable plants", "")


@dataclass(frozen=True)
class RolloutVerdict:
    """Held-out roll-outs of one model on one fold, squared errors in scaled states.

    error     median over all steps; of roll-outs of limited length the square of their mean error at the last step:
              what grows from step to step is not judged by its beginning, and few roll-outs through states that the
              pairs do not reach do not decide alone. Where many roll-outs from all over the recordings are judged at
              once, the mean square
    early     the same for the first part of every roll-out, one for each of ``PARTS``; infinite if it diverged there
    diverged  whether one of them diverged
    """

    error: float
    early: tuple[float, ...]
    diverged: bool


def judged(model: LiftedModel, fold: Fold, states: States, weights: Array) -> RolloutVerdict:
    """Roll the ``model`` out over what a ``fold`` holds out; errors of ``states``, multiplied by ``weights`` (n,)."""
    found = rollout_errors(model, fold.episodes, states, weights)
    begins = [[e[: max(1, int(part * len(e)))] for e in found.squared] for part in PARTS]
    early = tuple(_typical(b, fold) if np.isfinite(np.concatenate(b)).all() else np.inf for b in begins)
    return RolloutVerdict(_typical(found.squared, fold), early, bool(found.diverged.any()))


def _typical(squared: Sequence[Array], fold: Fold) -> float:
    if fold.untouched:
        return float(np.mean([e[-1] for e in squared]))
    if fold.horizon is not None:
        return float(np.mean([np.sqrt(e[-1]) for e in squared]) ** 2)
    values = np.concatenate(squared)
    return float(np.partition(values, (len(values) - 1) // 2)[(len(values) - 1) // 2])


LOST = RolloutVerdict(np.inf, (np.inf,) * len(PARTS), True)


def constant_error(model: LiftedModel, fold: Fold, states: States, weights: Array) -> float:
    """The error of predicting the mean of the training pairs of the ``fold``, in the units of :func:`judged`.

    ``model`` says which states ``states`` are and how many steps of history there are; ``weights`` (n,).
    """
    chosen = state_indices(model, states)
    mean, first = fold.training.x.mean(axis=0)[chosen], model.n_delays + 1
    return _typical([(((x[first:, chosen] - mean) * weights[chosen]) ** 2).sum(axis=1) for x in fold.episodes.xs], fold)


@dataclass(frozen=True)
class FoldErrors:
    """Median squared errors of G candidates on F folds.

    folds     (F,) folds
    errors    (G, F), with ``early`` (G, F, P) over the beginnings ``PARTS`` of roll-outs and ``diverged`` (G, F)
    constant  (F,) the error of predicting a constant
    """

    folds: tuple[Fold, ...]
    errors: Array
    early: Array
    diverged: Mask
    constant: Array

    @classmethod
    def of(
        cls, folds: Sequence[Fold], verdicts: Sequence[Sequence[RolloutVerdict]], constant: Sequence[float]
    ) -> FoldErrors:
        """From the ``verdicts`` on G candidates, one for each of ``folds``, and the errors ``constant`` (F,)."""

        def table(name: str) -> NDArray[np.generic]:
            return np.array([[getattr(v, name) for v in row] for row in verdicts])

        errors, early = (table(name).astype(np.float64) for name in ("error", "early"))
        return cls(tuple(folds), errors, early, table("diverged").astype(np.bool_), np.array(constant))

    def take(self, which: Sequence[int]) -> FoldErrors:
        """Those of the candidates at positions ``which``, in that order."""
        rows = np.array(which, dtype=np.int64)
        return replace(self, errors=self.errors[rows], early=self.early[rows], diverged=self.diverged[rows])

    @classmethod
    def together(cls, tables: Sequence[FoldErrors]) -> FoldErrors:
        """The candidates of several ``tables`` on the same folds."""
        return replace(
            tables[0],
            errors=np.concatenate([t.errors for t in tables]),
            early=np.concatenate([t.early for t in tables]),
            diverged=np.concatenate([t.diverged for t in tables]),
        )

    @property
    def telling(self) -> Mask:
        """(F,) folds that tell candidates apart.

        Not all diverge there; and its training pairs know the directions in which the inputs move, if there are other
        such folds.
        """
        return self._known(np.asarray(~self.diverged.all(axis=0)))

    def joint(self, among: Mask | None = None) -> Array:
        """Geometric mean (G,) over the telling folds, or those ``among`` (F,) them; infinite for what diverges on one.

        Folds differ in size and difficulty by orders of magnitude; their geometric mean weighs ratios, so that no fold
        outweighs the others by being hard.
        """
        used = self.telling if among is None else self.telling & among
        return _joint(np.where(self.diverged, np.inf, self.errors)[:, used])

    def joint_early(self, part: int) -> Array:
        """The joint error (G,) of the beginnings of roll-outs, those of number ``part``."""
        values = self.early[:, :, part]
        used = self._known(np.asarray(np.isfinite(values).any(axis=0)))
        return _joint(values[:, used])

    def _known(self, survived: Mask) -> Mask:
        known = survived & np.array([not fold.unseen for fold in self.folds])
        return known if np.count_nonzero(known) > 1 else survived

    def fallback(self) -> Array:
        """Where every candidate diverges somewhere: the joint error (G,) of those that do so on the fewest folds."""
        count = self.diverged.sum(axis=1)
        kept = ~self.diverged & np.isfinite(self.errors)
        few = kept.any(axis=1) & (count == count.min())
        return np.array([_geometric(self.errors[i, kept[i]]) if few[i] else np.inf for i in range(len(few))])


def _joint(values: Array) -> Array:
    """Geometric means (G,) of errors (G, F); infinite where one is, or where there are none."""
    if values.shape[1] == 0:
        return np.full(len(values), np.inf)
    floor = FLOOR * np.where(np.isfinite(values), values, 0.0).max(axis=0)
    return np.array([_geometric(row, floor) if np.isfinite(row).all() else np.inf for row in values])


def _geometric(values: Array, floor: float | Array = 0.0) -> float:
    """Geometric mean of ``values`` (F,), none of them below the ``floor``."""
    return float(np.exp(np.log(np.maximum(values, floor + np.finfo(float).tiny)).mean()))


def reasons(found: FoldErrors, labels: Sequence[str], chosen: int, allowed: Mask, tolerance: float) -> tuple[str, ...]:
    """Why the choice of candidate number ``chosen`` may be wrong, by the errors ``found``, a line each.

    ``labels`` (G,) of the candidates, those ``allowed`` (G,) that could have been chosen, ``tolerance`` in parts of the
    error that was granted.
    """
    said = []
    horizon = found.folds[0].horizon is not None
    if not np.isfinite(found.joint()).any():
        on = f"{found.diverged[chosen].sum()} of {len(found.folds)} folds, the fewest"
        on = "all" if found.diverged[chosen].all() else on
        said.append(
            f"every alternative diverges on held-out roll-outs, {labels[chosen]} on {on}; record more" + ADVICE[horizon]
        )
    if (len(found.folds) == 1 and len(found.folds[0].numbers) == 1) or {f.numbers for f in found.folds} == {(0,)}:
        where = "parts of one recording" if found.folds[0].name.startswith("steps") else found.folds[0].name + " alone"
        said.append(f"{labels[chosen]} was chosen on {where}, others may differ; record more")
    for fold in found.folds:
        if fold.unseen:
            said.append(
                f"pairs beside {fold.name} do not move {fold.unseen}, nothing can be judged there; record more of it"
            )
    limit = DECIDES**2 * (1.0 + tolerance)
    if found.telling.sum() > 1:
        for i in np.flatnonzero(found.telling):
            rest = np.where(allowed, found.joint(np.arange(len(found.folds)) != i), np.inf)
            said += _decided(rest, labels, chosen, limit, found.folds[i].name, "the others ask for")
    for number, what in enumerate(PARTS.values() if not horizon else ()):
        early = np.where(allowed, found.joint_early(number), np.inf)
        what = f"{what} of the roll-outs"
        told = _decided(early, labels, chosen, limit, what, "the rest asks for", ADVICE[0].replace("; or", ";"))
        if told:
            said += told
            break
    blind = _geometric(found.constant[found.telling]) if found.telling.any() else np.inf
    if max(blind, FLOOR) < found.joint()[chosen] < np.inf:
        said.append(
            f"{labels[chosen]} predicts held-out recordings no better than a constant; record more" + ADVICE[horizon]
        )
    return tuple(said)


def _decided(
    errors: Array, labels: Sequence[str], chosen: int, limit: float, what: str, rest: str, advice: str = ""
) -> list[str]:
    best = int(np.argmin(errors))
    if not np.isfinite(errors[best]) or errors[chosen] <= limit * errors[best]:
        return []
    factor = np.sqrt(errors[chosen] / errors[best]) if np.isfinite(errors[chosen]) else np.inf
    return [
        f"{what} decided for {labels[chosen]}; {rest} {labels[best]}, with errors {factor:.2g} times smaller{advice}"
    ]
