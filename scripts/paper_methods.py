"""L-, B- and PI-EDMDc as the paper prints them: its dictionary, its LASSO in every regression, Strang, identity rows.

Everything that the paper leaves open is an entry of :class:`Choices`.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from paper_protocol import HISTORY, Draw, Lifted, Method, Predictor, pairs_at

from pisplit import Dictionary, Episodes, PhaseSamples
from pisplit import observables as ob
from pisplit.export import lifted_model
from pisplit.moments import BLOCK, Moments, triangular_factor
from pisplit.regression import lasso, least_squares
from pisplit.scaling import column_scales

Array = NDArray[np.float64]

#: Unknown part of the paper's split: h acts on the velocities alone (its eq. cosserat_rod_eq).
UNKNOWN = ("q", "omega")
#: A generator whose half step grows more is spurious: the flow map takes its place (paper, "Practical considerations").
SPURIOUS = 1.1


@dataclass(frozen=True)
class Choices:
    """What the paper prints or leaves open.

    alpha       weight of every LASSO, times the number of its samples (printed: 0.01)
    scaling     columns divided by their standard deviation ("column"), by one for each quantity ("quantity"), or in
                physical units ("none"); open
    past        past of a static sample: it has none and delays take no part in K_f ("absent"), or it equals the
                present ("equal"); open
    half_step   exponential of the generator ("generator"), EDMD on the flow of f ("flow"), or the generator unless its
                half step grows ("auto"); printed: the generator, the flow map where that is unstable
    rows        K_h acts on all 144 rows ("all"), or on those where h is not zero ("velocities"); the others are then
                those of the identity (printed as a possible adjustment)
    known       the regression of K_f is a LASSO too ("lasso", printed) or least squares ("least squares")
    """

    alpha: float = 0.01
    scaling: str = "column"
    past: str = "absent"
    half_step: str = "auto"
    rows: str = "all"
    known: str = "lasso"


def paper_methods(choices: Choices | None = None) -> tuple[Method, ...]:
    """The three methods of the paper."""
    chosen = choices or Choices()
    return (
        Method("L-EDMDc", Direct(chosen, bilinear=False)),
        Method("B-EDMDc", Direct(chosen, bilinear=True)),
        Method("PI-EDMDc", Split(chosen)),
    )


def dictionary(data: Episodes) -> Dictionary:
    """144 states, 4 delays and the inputs: M = 723."""
    theta = Dictionary(ob.Identity(), ob.Delays(states=HISTORY), n_states=data.n_states, n_inputs=data.n_inputs)
    return theta.named_after(data)


@dataclass(frozen=True)
class Direct:
    """K = argmin |K Theta - Theta'|^2 + alpha N |K|_1; ``bilinear`` adds u_i times all columns of Theta_x."""

    choices: Choices
    bilinear: bool
    moments: DrawMoments = field(default_factory=lambda: DrawMoments())

    def __call__(self, draw: Draw) -> Predictor:
        """Fit to the pairs of a draw."""
        theta = dictionary(draw.episodes)
        theta = theta.bilinear() if self.bilinear else theta
        data = self.moments.of(theta, draw)
        scale = _scale(theta, data, self.choices)
        a, y = _scaled_rows(theta, data, scale)
        k, gap = _sparse(a, y, self.choices.alpha * len(draw))
        return _predictor(theta, k, scale, draw, {"gap": gap})


@dataclass(frozen=True)
class Split:
    """PI-EDMDc (paper, Algorithm 1): K = K_f K_h K_f, K_f from D2 and K_h from the pairs by

    K_h = argmin |K_h K_f Theta - K_f^+ Theta'|^2 + alpha N |K_h|_1.
    """

    choices: Choices
    moments: DrawMoments = field(default_factory=lambda: DrawMoments())

    def __call__(self, draw: Draw) -> Predictor:
        """Fit to the pairs and the phase-space samples of a draw."""
        theta, choices = dictionary(draw.episodes), self.choices
        data = self.moments.of(theta, draw)
        scale = _scale(theta, data, choices)
        half, facts = known_half_step(theta, draw.d2, draw.episodes.dt, scale, choices)
        a, y = _scaled_rows(theta, data, scale)
        learned = theta.learned_columns
        others = np.setdiff1d(np.arange(theta.n_columns), learned)
        # [Theta' of the 144 rows | of the identity rows] = K_f [X | others]: their share is taken off before K_f^+.
        back = np.linalg.pinv(half[np.ix_(learned, learned)])
        target = (y - a[:, others] @ half[np.ix_(learned, others)].T) @ back.T
        k_h = np.eye(theta.n_columns)
        free = learned if choices.rows == "all" else _velocities(theta)
        k_h[free], gap = _sparse(a @ half.T, target[:, np.searchsorted(learned, free)], choices.alpha * len(draw))
        return _predictor(theta, (half @ k_h @ half)[learned], scale, draw, facts | {"gap": gap})


class DrawMoments:
    """Moments of [Theta(k) | learned columns of psi(k+1)] of nested draws: a larger draw goes on where the last ended.

    A fit of 64 pairs, then 128, ... of one seed reads every pair once.
    """

    def __init__(self) -> None:
        self._rows = np.empty((0, 2), dtype=np.int64)
        self._source: tuple[int, str] | None = None
        self._triangle = np.empty((0, 0))

    def of(self, theta: Dictionary, draw: Draw) -> Moments:
        """Moments of all pairs of the draw."""
        source = (id(draw.episodes), theta.fingerprint())
        done = len(self._rows)
        if source != self._source or done > len(draw) or not np.array_equal(self._rows, draw.rows[:done]):
            done, self._source = 0, source
            self._triangle = np.zeros((0, 1 + theta.n_columns + len(theta.learned_columns)))
        for first in range(done, len(draw), BLOCK):
            pairs = pairs_at(draw.episodes, draw.rows[first : first + BLOCK], theta.n_delays)
            block = np.hstack([np.ones((len(pairs), 1)), theta.evaluate(pairs), theta.next_learned(pairs)])
            self._triangle = triangular_factor(np.vstack([self._triangle, block]))
        self._rows = draw.rows
        first_row = self._triangle[0]  # the column of ones: its row of the triangle is the mean
        return Moments(len(draw), first_row[1:] / first_row[0], np.ascontiguousarray(self._triangle[1:, 1:]))


def known_half_step(
    theta: Dictionary, d2: PhaseSamples, dt: float, scale: Array, choices: Choices
) -> tuple[Array, dict[str, Any]]:
    """K_f(dt/2) (M, M) on scaled columns, identity in the rows of delays and inputs, and facts about it.

    Raises ValueError where the exponential of the generator was asked for and overflows.
    """
    facts: dict[str, Any] = {"half_step": "flow"}
    present = slice(0, theta.n_present)
    if choices.half_step != "flow":
        generator = _known_rows(theta, d2, scale, choices, "generator")
        fastest = float(np.linalg.eigvals(generator[present, present]).real.max())
        facts["max_real"] = fastest
        if choices.half_step == "generator" or np.exp(min(0.5 * dt * fastest, 50.0)) <= SPURIOUS:
            with np.errstate(over="ignore", invalid="ignore"):
                half = scipy.linalg.expm(0.5 * dt * generator)
            if not np.isfinite(half).all() or np.abs(half).max() > 1e100:
                raise ValueError(f"exp of the generator overflows: real parts up to {fastest:.2g} 1/s")
            return half, facts | {"half_step": "generator"}
    half = _known_rows(theta, d2, scale, choices, "flow")
    return half, facts | {"radius": float(np.abs(np.linalg.eigvals(half[present, present])).max())}


def _known_rows(theta: Dictionary, d2: PhaseSamples, scale: Array, choices: Choices, kind: str) -> Array:
    """Generator, or flow map over half a step, of f: LASSO of the 144 targets, other rows zero or the identity."""
    learned = theta.learned_columns
    if kind == "flow" and d2.x_half is None:
        raise ValueError("half_step='flow' needs phase-space samples with the flow of f")
    rows, n_samples = _known_moments(theta, d2, choices.past, kind)
    static = theta.n_columns if choices.past == "equal" else theta.n_present + theta.n_features
    columns = np.arange(theta.n_columns) if choices.past == "equal" else _present_columns(theta)
    a, y = rows[:, :static] / scale[columns], rows[:, static:] / scale[learned]
    k = _sparse(a, y, choices.alpha * n_samples)[0] if choices.known == "lasso" else least_squares(a, y).K
    matrix = np.zeros((theta.n_columns, theta.n_columns)) if kind == "generator" else np.eye(theta.n_columns)
    matrix[learned] = 0.0
    matrix[np.ix_(learned, columns)] = k
    return matrix


_KNOWN: dict[tuple[int, int, str, str], tuple[PhaseSamples, Array]] = {}


def _known_moments(theta: Dictionary, d2: PhaseSamples, past: str, kind: str) -> tuple[Array, int]:
    """Triangle of [Theta(x, u) | J Theta . f, or Theta after half a step] over d2, kept for the last few sets."""
    key = (id(d2), theta.n_columns, past, kind)
    if key not in _KNOWN:
        if len(_KNOWN) > 32:
            _KNOWN.clear()
        triangle = None
        for part in d2.blocks(BLOCK):
            block = np.hstack([_static(theta, part, past), _known_target(theta, part, kind)])
            triangle = triangular_factor(block if triangle is None else np.vstack([triangle, block]))
        assert triangle is not None
        _KNOWN[key] = (d2, triangle)
    return _KNOWN[key][1], len(d2)


def _static(theta: Dictionary, part: PhaseSamples, past: str) -> Array:
    whole = theta.evaluate_static(part.x, part.u)
    return whole if past == "equal" else whole[:, _present_columns(theta)]


def _known_target(theta: Dictionary, part: PhaseSamples, kind: str) -> Array:
    if kind == "generator":
        return theta.present_derivative(part.x, part.xdot)[:, theta.learned_columns]
    assert part.x_half is not None
    return theta.present(part.x_half)[:, theta.learned_columns]


def _present_columns(theta: Dictionary) -> NDArray[np.int64]:
    return np.concatenate([np.arange(theta.n_present), np.arange(theta.n_lifted, theta.n_columns)])


def _velocities(theta: Dictionary) -> NDArray[np.int64]:
    learned = theta.learned_columns
    return np.array([i for i in learned if theta.column_quantities[i] in UNKNOWN])


def _scale(theta: Dictionary, data: Moments, choices: Choices) -> Array:
    mode = None if choices.scaling == "none" else choices.scaling
    return column_scales(data.std[: theta.n_columns], theta.column_quantities, mode)


def _scaled_rows(theta: Dictionary, data: Moments, scale: Array) -> tuple[Array, Array]:
    """Rows that stand for Theta(k) and for the learned columns of psi(k+1), about zero: the paper has no constant."""
    rows = data.scaled(np.concatenate([scale, scale[theta.learned_columns]])).rows(centred=False)
    return rows[:, : theta.n_columns], rows[:, theta.n_columns :]


def _sparse(a: Array, y: Array, alpha: float) -> tuple[Array, float]:
    """argmin |A K^T - Y|^2 + alpha |K|_1 and its largest relative duality gap."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the gap is a result of every fit
        found = lasso(a, y, alpha, solver="active-set")
    return found.K, float(found.gap or 0.0)


def _predictor(theta: Dictionary, k: Array, scale: Array, draw: Draw, facts: dict[str, Any]) -> Lifted:
    """The predictor of the learned rows k (144, M) on scaled columns."""
    if not np.isfinite(k).all():
        raise ValueError("the operator is not finite")
    facts = facts | {"non_zero": float((k != 0.0).mean())}
    physical = k * scale[theta.learned_columns][:, None] / scale
    return Lifted(lifted_model(theta, physical, draw.episodes, draw.pairs(theta.n_delays), facts))
