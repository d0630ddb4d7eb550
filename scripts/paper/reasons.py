"""Why the paper's PI-EDMDc diverges on its arm: figures of its half step and of the step composed from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.data import PaperData
from common.protocol import Draw, Prediction, evaluate, random_pairs, summary
from paper.methods import Array, Choices, Split, Units, dictionary
from pisplit import Episodes
from pisplit.checks import count

PAIRS = 1024
#: Singular values below this part of the largest have no inverse.
RANK = 1e-10


@dataclass(frozen=True)
class Constant:
    """Predicts that the arm stays where it is; or, given a state, that it is always there."""

    state: Array | None = None

    def __call__(self, episodes: Episodes, start: int) -> Prediction:
        """The same state at all steps."""
        groups = episodes.outputs or {}
        first = np.stack([x[start] if self.state is None else self.state for x in episodes.xs])
        held = np.repeat(first[:, None], len(episodes.us[0]) - start, axis=1)
        never = np.full(len(episodes), -1)
        return Prediction(held[:, :, list(groups["shape"])], held[:, :, list(groups["tip_velocity"])], never)


def reasons(data: PaperData, pairs: int = PAIRS) -> dict[str, tuple[float, str]]:
    """Figures and their units: of predicting a constant; of K_f; of K on the training pairs, in units of deviations."""
    rows = random_pairs(data.training, count(pairs, "pairs"), 0)
    draw, fit = Draw(data.law, data.training, rows, data.d2, 0), Split(Choices())
    theta = dictionary(data.training)
    units = fit.cache.units(draw, fit.choices.scaling)
    half, facts = fit.cache.half_step(theta, draw, units, fit.choices)
    a, y = fit.cache.pairs(theta, draw, units)
    learned, present = theta.learned_columns, slice(0, theta.n_present)
    block = half[np.ix_(learned, learned)]
    singular = np.linalg.svd(block, compute_uv=False)
    found = {
        f"{name}, squared shape error": (summary([evaluate(one, data.test)]).median, "m^2")
        for name, one in (
            ("mean of the training data", Constant(data.training.stacked_states().mean(axis=0))),
            ("standing still", Constant()),
        )
    }
    found["fastest growth of the generator"] = (facts.get("max_real", np.nan), "1/s")
    found["spectral radius of the half step"] = (float(np.abs(np.linalg.eigvals(half[present, present])).max()), "")
    found["largest gain of the half step"] = (float(singular[0]), "")
    found[f"singular values above {RANK:g}"] = (float((singular > RANK * singular[0]).sum()), "")
    found["states that vary"] = (float(_varying(units, data).sum()), "")
    found["motion of f alone in half a step"] = (_motion(units, data), "deviations")
    operator = fit(draw).model  # type: ignore[attr-defined]
    still = float(((a[:, learned] - y) ** 2).sum())
    found["one step: half step twice over nothing moves"] = (
        float(((a @ (half @ half)[learned].T - y) ** 2).sum()) / still,
        "times",
    )
    step = np.hstack([operator.A, operator.B])[learned]
    found["one step: PI-EDMDc over nothing moves"] = (float(((a @ step.T - y) ** 2).sum()) / still, "times")
    return found


def _varying(units: Units, data: PaperData) -> Array:
    """Which states count as more than constants."""
    states = units.episodes(data.training).stacked_states()
    varying: Array = states.std(axis=0) > 0.5
    return varying


def _motion(units: Units, data: PaperData) -> float:
    """Root mean square over samples and varying states of what f moves in half a step."""
    found = units.samples(data.d2)
    assert found.x_half is not None
    moved = (found.x_half - found.x)[:, _varying(units, data)]
    return float(np.sqrt((moved**2).mean()))
