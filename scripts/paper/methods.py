"""L-, B- and PI-EDMDc as the paper prints them: its dictionary, its LASSO in every regression, Strang, identity rows.

Everything that the paper leaves open is an entry of :class:`Choices`.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from common.protocol import HISTORY, Draw, Lifted, Method, Prediction, Predictor, pairs_at
from pisplit import Dictionary, Episodes, LiftedModel, PhaseSamples
from pisplit import observables as ob
from pisplit.lifted.operators import lifted_model
from pisplit.regression import lasso, least_squares
from pisplit.regression.moments import BLOCK, triangular_factor
from pisplit.regression.scaling import column_scales

Array = NDArray[np.float64]

#: Unknown part of the paper's split: h acts on the velocities alone (its eq. cosserat_rod_eq).
UNKNOWN = ("q", "omega")
#: A generator whose half step grows more is spurious: the flow map takes its place (paper, "Practical considerations").
SPURIOUS = 1.1
#: A quantity's entries that deviate less than this part of its size are constants, not blown up to unit deviation: the
#: clamped base, and the strains v of a backbone that neither stretches nor shears.
CONSTANT = 1e-4


@dataclass(frozen=True)
class Choices:
    """What the paper prints or leaves open.

    alpha       weight of every LASSO, times the number of its samples (printed: 0.01)
    scaling     states and inputs about their mean, divided by their deviation ("column"), by one for each physical
                quantity ("quantity"), or neither ("none", physical units); open
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
    cache: Cache = field(default_factory=lambda: Cache(), repr=False)

    def __call__(self, draw: Draw) -> Predictor:
        """Fit to the pairs of a draw."""
        units = self.cache.units(draw, self.choices.scaling)
        theta = dictionary(draw.episodes)
        theta = theta.bilinear() if self.bilinear else theta
        a, y = self.cache.pairs(theta, draw, units)
        k, gap = _sparse(a, y, self.choices.alpha * len(draw))
        return _predictor(theta, k, units, self.cache.data(draw, units), draw, {"gap": gap})


@dataclass(frozen=True)
class Split:
    """PI-EDMDc (paper, Algorithm 1): K = K_f K_h K_f, K_f from D2 and K_h from the pairs by

    K_h = argmin |K_h K_f Theta - K_f^+ Theta'|^2 + alpha N |K_h|_1.
    """

    choices: Choices
    cache: Cache = field(default_factory=lambda: Cache(), repr=False)

    def __call__(self, draw: Draw) -> Predictor:
        """Fit to the pairs and the phase-space samples of a draw."""
        choices, theta = self.choices, dictionary(draw.episodes)
        units = self.cache.units(draw, choices.scaling)
        half, facts = self.cache.half_step(theta, draw, units, choices)
        a, y = self.cache.pairs(theta, draw, units)
        learned = theta.learned_columns
        others = np.setdiff1d(np.arange(theta.n_columns), learned)
        # K_f = [[F, G], [0, I]] on [X; others]: the share G others is taken off before F^+.
        back = np.linalg.pinv(half[np.ix_(learned, learned)])
        target = (y - a[:, others] @ half[np.ix_(learned, others)].T) @ back.T
        k_h = np.eye(theta.n_columns)
        free = learned if choices.rows == "all" else _velocities(theta)
        k_h[free], gap = _sparse(a @ half.T, target[:, np.searchsorted(learned, free)], choices.alpha * len(draw))
        k = (half @ k_h @ half)[learned]
        return _predictor(theta, k, units, self.cache.data(draw, units), draw, facts | {"gap": gap})


@dataclass(frozen=True)
class Units:
    """Origin and unit of each state (n,) and input (m,): the method sees (x - x0) / x1 and (u - u0) / u1."""

    x0: Array
    x1: Array
    u0: Array
    u1: Array

    @classmethod
    def of(cls, episodes: Episodes, scaling: str) -> Units:
        """Units by ``Choices.scaling``, from the training episodes."""
        x, u = episodes.stacked_states(), episodes.stacked_inputs()
        if scaling == "none":
            return cls(np.zeros(x.shape[1]), np.ones(x.shape[1]), np.zeros(u.shape[1]), np.ones(u.shape[1]))
        x0, x1, u0, u1 = x.mean(axis=0), x.std(axis=0), u.mean(axis=0), u.std(axis=0)
        quantities = list(episodes.quantities or ())
        size = np.sqrt(column_scales(x0, quantities) ** 2 + column_scales(x1, quantities) ** 2)
        x1[x1 <= CONSTANT * size] = 0.0
        return cls(x0, column_scales(x1, quantities, scaling), u0, column_scales(u1, ["u"] * len(u1), scaling))

    def episodes(self, given: Episodes) -> Episodes:
        """Episodes in these units."""
        return replace(
            given, xs=[(x - self.x0) / self.x1 for x in given.xs], us=[(u - self.u0) / self.u1 for u in given.us]
        )

    def samples(self, given: PhaseSamples) -> PhaseSamples:
        """Phase-space samples in these units."""
        half = None if given.x_half is None else (given.x_half - self.x0) / self.x1
        return replace(
            given,
            x=(given.x - self.x0) / self.x1,
            u=(given.u - self.u0) / self.u1,
            xdot=given.xdot / self.x1,
            x_half=half,
        )


@dataclass(frozen=True)
class InUnits:
    """Predictor of a model that was fitted in other units."""

    model: LiftedModel
    units: Units

    def __call__(self, episodes: Episodes, start: int) -> Prediction:
        """Roll out in the model's units, answer in those of the episodes."""
        found = Lifted(self.model)(self.units.episodes(episodes), start)
        points, velocity = (list(self.model.outputs[name]) for name in ("shape", "tip_velocity"))
        x0, x1 = self.units.x0, self.units.x1
        with np.errstate(over="ignore"):
            return Prediction(
                found.points * x1[points] + x0[points], found.velocity * x1[velocity] + x0[velocity], found.diverged_at
            )


class Cache:
    """What fits of one method share: data in its units, moments of nested draws, half steps by phase samples.

    A larger draw of the same seed goes on where the smaller ended: 64 pairs, then 128, ... read every pair once.
    """

    def __init__(self) -> None:
        self._units: tuple[Any, Units] | None = None
        self._data: tuple[Any, Episodes] | None = None
        self._rows = np.empty((0, 2), dtype=np.int64)
        self._triangle = np.empty((0, 0))
        self._source: Any = None
        self._halves: dict[int, tuple[PhaseSamples, Array, dict[str, Any]]] = {}

    def units(self, draw: Draw, scaling: str) -> Units:
        """Units of the draw's episodes."""
        if self._units is None or self._units[0] is not draw.episodes:
            self._units = (draw.episodes, Units.of(draw.episodes, scaling))
        return self._units[1]

    def data(self, draw: Draw, units: Units) -> Episodes:
        """The draw's episodes in these units."""
        if self._data is None or self._data[0] is not draw.episodes:
            self._data = (draw.episodes, units.episodes(draw.episodes))
        return self._data[1]

    def pairs(self, theta: Dictionary, draw: Draw, units: Units) -> tuple[Array, Array]:
        """Rows that stand for Theta(k) (r, M) and for the learned columns of psi(k+1) (r, S) in a regression."""
        data = self.data(draw, units)
        done = len(self._rows)
        if self._source is not data or done > len(draw) or not np.array_equal(self._rows, draw.rows[:done]):
            done, self._source = 0, data
            self._triangle = np.zeros((0, theta.n_columns + len(theta.learned_columns)))
        for first in range(done, len(draw), BLOCK):
            pairs = pairs_at(data, draw.rows[first : first + BLOCK], theta.n_delays)
            block = np.hstack([theta.evaluate(pairs), theta.next_learned(pairs)])
            self._triangle = triangular_factor(np.vstack([self._triangle, block]))
        self._rows = draw.rows
        return self._triangle[:, : theta.n_columns], self._triangle[:, theta.n_columns :]

    def half_step(self, theta: Dictionary, draw: Draw, units: Units, choices: Choices) -> tuple[Array, dict[str, Any]]:
        """K_f of the draw's phase samples."""
        key = id(draw.d2)
        if key not in self._halves:
            half, facts = known_half_step(theta, units.samples(draw.d2), draw.episodes.dt, choices)
            self._halves[key] = (draw.d2, half, facts)
        return self._halves[key][1:]


def known_half_step(theta: Dictionary, d2: PhaseSamples, dt: float, choices: Choices) -> tuple[Array, dict[str, Any]]:
    """K_f(dt/2) (M, M), identity in the rows of delays and inputs, and facts about it.

    Raises ValueError where the exponential of the generator was asked for and overflows.
    """
    facts: dict[str, Any] = {"half_step": "flow"}
    present = slice(0, theta.n_present)
    if choices.half_step != "flow":
        generator = _known_rows(theta, d2, choices, "generator")
        fastest = float(np.linalg.eigvals(generator[present, present]).real.max())
        facts["max_real"] = fastest
        if choices.half_step == "generator" or np.exp(min(0.5 * dt * fastest, 50.0)) <= SPURIOUS:
            with np.errstate(over="ignore", invalid="ignore"):
                half = scipy.linalg.expm(0.5 * dt * generator)
            if not np.isfinite(half).all() or np.abs(half).max() > 1e100:
                raise ValueError(f"exp of the generator overflows: real parts up to {fastest:.2g} 1/s")
            return half, facts | {"half_step": "generator"}
    half = _known_rows(theta, d2, choices, "flow")
    return half, facts | {"radius": float(np.abs(np.linalg.eigvals(half[present, present])).max())}


def _known_rows(theta: Dictionary, d2: PhaseSamples, choices: Choices, kind: str) -> Array:
    """Generator, or flow map over half a step, of f: the 144 targets regressed, other rows zero or the identity."""
    if kind == "flow" and d2.x_half is None:
        raise ValueError("half_step='flow' needs phase-space samples with the flow of f")
    learned = theta.learned_columns
    columns = np.arange(theta.n_columns)
    if choices.past == "absent":
        columns = np.concatenate([np.arange(theta.n_present), np.arange(theta.n_lifted, theta.n_columns)])
    triangle = np.zeros((0, len(columns) + len(learned)))
    for part in d2.blocks(BLOCK):
        target = theta.present_derivative(part.x, part.xdot) if kind == "generator" else theta.present(_flown(part))
        block = np.hstack([theta.evaluate_static(part.x, part.u)[:, columns], target[:, learned]])
        triangle = triangular_factor(np.vstack([triangle, block]))
    a, y = triangle[:, : len(columns)], triangle[:, len(columns) :]
    k = _sparse(a, y, choices.alpha * len(d2))[0] if choices.known == "lasso" else least_squares(a, y).K
    matrix = np.zeros((theta.n_columns, theta.n_columns)) if kind == "generator" else np.eye(theta.n_columns)
    matrix[learned] = 0.0
    matrix[np.ix_(learned, columns)] = k
    return matrix


def _flown(part: PhaseSamples) -> Array:
    assert part.x_half is not None
    return part.x_half


def _velocities(theta: Dictionary) -> NDArray[np.int64]:
    learned = theta.learned_columns
    return np.array([i for i in learned if theta.column_quantities[i] in UNKNOWN])


def _sparse(a: Array, y: Array, alpha: float) -> tuple[Array, float]:
    """argmin |A K^T - Y|^2 + alpha |K|_1 and its largest relative duality gap."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the gap is a result of every fit
        found = lasso(a, y, alpha, solver="active-set")
    return found.K, float(found.gap or 0.0)


def _predictor(theta: Dictionary, k: Array, units: Units, data: Episodes, draw: Draw, facts: dict[str, Any]) -> InUnits:
    """The predictor of the learned rows k (144, M) in the method's units."""
    if not np.isfinite(k).all():
        raise ValueError("the operator is not finite")
    pairs = pairs_at(data, draw.rows, theta.n_delays)
    facts = facts | {"non_zero": float((k != 0.0).mean())}
    return InUnits(lifted_model(theta, k, data, pairs, facts), units)
