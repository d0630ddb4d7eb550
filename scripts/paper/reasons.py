"""Why the paper's PI-EDMDc diverges on its arm: figures of its half step and of the step composed from it."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from common.data import PaperData
from common.protocol import Draw, Prediction, all_pairs, evaluate, pairs_at, random_pairs, summary
from paper.methods import Array, Choices, Printed, Units
from pisplit import Episodes, half_step
from pisplit.checks import count
from pisplit.generator import KnownOptions
from pisplit.splitting import pair_moments

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
    """Figures and their units: of predicting a constant; of K_f; of K on the training pairs, in units of deviations.

    ``pairs``: training pairs that are drawn, at most all.
    """
    rows = random_pairs(data.training, min(count(pairs, "pairs"), all_pairs(data.training)), 0)
    draw = Draw(data.law, data.training, rows, data.d2, 0)
    fitted, units = Printed("PI-EDMDc", Choices()).fitted(draw)
    theta, episodes = fitted.theta_, units.episodes(data.training)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what it would say is among the figures
        k_f = half_step(
            theta,
            units.samples(data.d2),
            episodes.dt,
            np.ones(theta.n_columns),
            fitted.half_step,
            fitted.generator_alpha,
            options=KnownOptions("lasso", fitted.solver, fitted.relative),
        )
    half = k_f.K
    data_rows = pair_moments(theta, pairs_at(episodes, rows, theta.n_delays)).rows(centred=False)
    a, y = data_rows[:, : theta.n_columns], data_rows[:, theta.n_columns :]
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
    found["fastest growth of the generator"] = (np.nan if k_f.max_real is None else k_f.max_real, "1/s")
    found["spectral radius of the half step"] = (float(np.abs(np.linalg.eigvals(half[present, present])).max()), "")
    found["largest gain of the half step"] = (float(singular[0]), "")
    found[f"singular values above {RANK:g}"] = (float((singular > RANK * singular[0]).sum()), "")
    found["states that vary"] = (float(_varying(units, data).sum()), "")
    found["motion of f alone in half a step"] = (_motion(units, data), "deviations")
    still = float(((a[:, learned] - y) ** 2).sum())
    found["one step: half step twice over nothing moves"] = (
        float(((a @ (half @ half)[learned].T - y) ** 2).sum()) / still,
        "times",
    )
    found["one step: PI-EDMDc over nothing moves"] = (float(((a @ fitted.K_.T - y) ** 2).sum()) / still, "times")
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
