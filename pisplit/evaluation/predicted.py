"""How wrong a model will be where nobody recorded: its own residuals, fed back along roll-outs."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.brief import brief
from pisplit.checks import count, finite_array
from pisplit.data.episodes import Episodes, Pairs
from pisplit.evaluation.matching import Fitted, States, matched, model_of, state_indices
from pisplit.evaluation.rollouts import squared_unit
from pisplit.lifted.model import LiftedModel
from pisplit.threads import one_blas_thread

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

#: The largest number of pairs that residuals are taken from, spread over all of them.
MOST = 2000
#: Roll-outs where no commands are given, and of recordings on which the estimate is held against what came true.
ROLLOUTS = 16
#: The most that an estimate is corrected by, up and down.
CORRECTED = 10.0


@brief
@dataclass(frozen=True, eq=False)
class PredictedError:
    """Squared distances of disturbed roll-outs from those of the model, summed over the chosen states.

    squared  (E, T) by roll-out and step; infinite from the step of divergence on
    dt       step in s
    unit     of ``squared``: "m^2"; "" where it is not known, or not one
    scale    what the distances were multiplied with: true over predicted errors under the recorded commands
    """

    squared: Array
    dt: float
    unit: str = ""
    scale: float = 1.0

    @property
    def median(self) -> float:
        """Median over all steps of all roll-outs, to be held against ``RolloutErrors.median``."""
        return float(np.quantile(self.squared, 0.5, method="lower"))

    @property
    def by_horizon(self) -> Array:
        """Median (T,) over the roll-outs, 1 to T steps ahead."""
        return np.asarray(np.quantile(self.squared, 0.5, axis=0, method="lower"))

    def __str__(self) -> str:
        steps = sorted({1, max(1, self.squared.shape[1] // 10), self.squared.shape[1]})
        unit = f" {self.unit}" if self.unit else ""
        ahead = ", ".join(f"{self.by_horizon[h - 1]:.3g}{unit} after {h * self.dt:.3g} s" for h in steps)
        return f"predicted squared error {self.median:.3g}{unit} ({ahead})"

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Median and quartiles over the time ahead; written to ``path`` where one is given."""
        from pisplit.evaluation.pictures import plot_predicted

        return plot_predicted(self, path)


@one_blas_thread()
def predicted_error(
    model: LiftedModel | Fitted,
    episodes: Episodes,
    excitation: ArrayLike | None = None,
    states: States = None,
    pairs: Pairs | None = None,
) -> PredictedError:
    """Errors of roll-outs of a ``model`` under commands that nobody recorded, estimated from recorded pairs alone.

    Two roll-outs are made under each command sequence: the model's own, and one to which at every step what the model
    missed in the nearest recorded pair is added. Their distance estimates the error: residuals that point the same way
    along the motion add up as they would on the robot, others cancel. The same is done under the recorded commands,
    with the residuals of other recordings: what came true there over what is predicted there, medians of both, corrects
    the estimate (by ten at most; not with a single recording).

    episodes    recordings, columns matched by name: best those that the model did not learn from. On its own training
                pairs a model misses less than elsewhere, and the estimate is too small by as much
    excitation  (E, T, m) commands; the recorded ones, backwards in time, if not given: amplitudes and rates of the
                data, and another motion
    states      output group, names or indices whose distances count (default: all)
    pairs       of the ``episodes`` from which residuals are taken; all of them (at most 2000, spread) if not given

    Nearness is that of states and of the last and the coming input, both scaled to equal spread. Raises ValueError for
    episodes of other names, units, sizes or time step, or shorter than the model's delays, for pairs of other data, and
    for excitations of another shape.

    Source: the parametric bootstrap (Efron and Tibshirani, An Introduction to the Bootstrap, 1993; chapter 18 for its
    correction), with residuals that depend on the state, as in the nearest-neighbour bootstrap of time series (Lall and
    Sharma, Water Resources Research 32, 1996).
    """
    model = model_of(model)
    found = matched(model, episodes, states)
    chosen, delays = state_indices(model, states), model.n_delays
    known = found.pairs(delays) if pairs is None else found.checked_pairs(pairs, delays)
    if len(known) > MOST:
        known = known.take(np.linspace(0, len(known) - 1, MOST).astype(np.int64))
    z0, commands, before = _starts(model, found, known, excitation)
    nearest = NearestResiduals(model, known)
    squared = _distances(model, nearest, z0, commands, before, chosen)
    scale = _correction(model, found, nearest, chosen)
    return PredictedError(scale * squared, model.dt, squared_unit([model.units[i] for i in chosen]), scale)


def _distances(
    model: LiftedModel,
    nearest: NearestResiduals,
    z0: Array,
    commands: Array,
    before: Array,
    chosen: NDArray[np.int64],
    own: NDArray[np.int64] | None = None,
) -> Array:
    """Squared distances (E, T) of disturbed roll-outs from the model's, infinite from where either diverges.

    ``own`` (E,): recordings whose residuals each of them may not have.
    """
    nominal = model.rollout(z0, commands)
    z, last, squared = z0, before, np.full(commands.shape[:2], np.inf)
    ok = np.ones(len(z0), dtype=bool)
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(commands.shape[1]):
            u = commands[:, k]
            following = model.rollout(z[ok], u[ok, None])
            miss = nearest.residual(model.read(z[ok]), last[ok], u[ok], None if own is None else own[ok])
            z = z.copy()
            z[ok] = following.z[:, 1] + miss
            going = np.asarray(following.diverged_at) < 0
            at = np.asarray(nominal.diverged_at)[ok]
            ok[ok] = going & ((at < 0) | (at > k + 1))
            distance = (model.read(z[ok]) - nominal.x[ok, k + 1])[:, chosen]
            squared[ok, k] = (distance**2).sum(axis=1)
            last = u
            if not ok.any():
                break
    return squared


def _correction(model: LiftedModel, episodes: Episodes, nearest: NearestResiduals, chosen: NDArray[np.int64]) -> float:
    """True over predicted error, medians of both, of roll-outs of recordings with the residuals of the others."""
    delays = model.n_delays
    steps = int(np.median([len(u) for u in episodes.us])) - delays
    usable = [i for i, u in enumerate(episodes.us) if len(u) - delays >= steps][:ROLLOUTS]
    if len(np.unique(nearest.episode)) < 2 or steps < 1:
        return 1.0
    z0 = model.lift(
        np.stack([episodes.xs[i][: delays + 1] for i in usable]), np.stack([episodes.us[i][:delays] for i in usable])
    )
    commands = np.stack([episodes.us[i][delays : delays + steps] for i in usable])
    before = np.stack([episodes.us[i][delays - 1] if delays else episodes.us[i][0] for i in usable])
    predicted = _distances(model, nearest, z0, commands, before, chosen, np.array(usable))
    went = model.rollout(z0, commands)
    truth = np.stack([episodes.xs[i][delays + 1 : delays + steps + 1] for i in usable])
    at = np.asarray(went.diverged_at)
    true = ((went.x[:, 1:] - truth)[..., chosen] ** 2).sum(axis=2)
    true[(at >= 0)[:, None] & (np.arange(1, steps + 1) >= at[:, None])] = np.inf
    medians = [float(np.quantile(v, 0.5, method="lower")) for v in (true, predicted)]
    if not np.isfinite(medians).all() or min(medians) <= 0.0:
        return 1.0
    return float(np.clip(medians[0] / medians[1], 1.0 / CORRECTED, CORRECTED))


def _starts(
    model: LiftedModel, episodes: Episodes, pairs: Pairs, excitation: ArrayLike | None
) -> tuple[Array, Array, Array]:
    """Lifted states (E, M), commands (E, T, m) and the commands before them (E, m)."""
    if excitation is not None:
        commands = finite_array(excitation, "excitation", (None, None, model.n_inputs))
        if 0 in commands.shape[:2]:
            raise ValueError(f"excitation has the shape {commands.shape}; expected input sequences (E, T, m)")
        u = pairs.u
        at = pairs.take([int(np.argmin(((u - first) ** 2).sum(axis=1))) for first in commands[:, 0]])
        return model.lift(at.x_history, at.u_history), commands, at.u_history[:, -1] if model.n_delays else at.u
    delays = count(model.n_delays, "n_delays", 0)
    steps = int(np.median([len(u) for u in episodes.us]))
    usable = [i for i, u in enumerate(episodes.us) if len(u) >= steps][:ROLLOUTS]
    x = np.stack([episodes.xs[i][len(episodes.xs[i]) - delays - 1 :] for i in usable])
    past = np.stack([episodes.us[i][len(episodes.us[i]) - delays :] for i in usable])
    commands = np.stack([episodes.us[i][::-1][:steps] for i in usable])
    return model.lift(x, past), commands, commands[:, 0]


class NearestResiduals:
    """Residuals of recorded ``pairs`` in the lifted state of a ``model``, found by state and inputs."""

    def __init__(self, model: LiftedModel, pairs: Pairs) -> None:
        delays, x, u = pairs.n_delays, pairs.x, pairs.u
        z = model.lift(pairs.x_history, pairs.u_history)
        after_x = pairs.states[pairs.row[:, None] + np.arange(1 - delays, 2)]
        after_u = pairs.inputs[pairs.input_row[:, None] + np.arange(1 - delays, 1)]
        self.residuals = model.lift(after_x, after_u) - model.rollout(z, u[:, None]).z[:, 1]
        before = pairs.u_history[:, -1] if delays else u
        self.delays, self.scale = delays, np.maximum(model.state_range, 1e-300)
        self.state_weight = _spread(x / self.scale)
        self.input_weight = _spread(np.hstack([before, u]))
        self.keys = self._key(x, before, u)
        self.squares = (self.keys**2).sum(axis=1)
        self.episode = np.asarray(pairs.episode)

    def residual(self, x: Array, before: Array, u: Array, own: NDArray[np.int64] | None = None) -> Array:
        """Residuals (E, M) of the pairs nearest to states ``x`` (E, n), inputs ``before`` (E, m) and coming ones ``u``.

        None are of the recordings ``own`` (E,).
        """
        key = self._key(x, before, u)
        distances = self.squares - 2.0 * key @ self.keys.T
        if own is not None:
            distances[own[:, None] == self.episode] = np.inf
        return np.asarray(self.residuals[np.argmin(distances, axis=1)])

    def mean(self, x: Array, before: Array, u: Array, many: int) -> Array:
        """Means (E, M) of the residuals of the ``many`` nearest pairs, with shares that fall with their distance.

        Nearest to states ``x`` (E, n), inputs ``before`` (E, m) and the coming inputs ``u`` (E, m).
        """
        key = self._key(x, before, u)
        squares = np.maximum((key**2).sum(axis=1)[:, None] + self.squares - 2.0 * key @ self.keys.T, 0.0)
        near = np.argpartition(squares, min(many, squares.shape[1]) - 1, axis=1)[:, :many]
        squares = np.take_along_axis(squares, near, axis=1)
        shares = 1.0 - squares / np.maximum(squares.max(axis=1, keepdims=True), 1e-300) + 1e-9
        return np.einsum("ek,ekm->em", shares / shares.sum(axis=1, keepdims=True), self.residuals[near])

    def _key(self, x: Array, before: Array, u: Array) -> Array:
        if not self.delays:
            before = u
        return np.hstack([x / self.scale / self.state_weight, np.hstack([before, u]) / self.input_weight])


def _spread(values: Array) -> float:
    """Root of the total variance of the columns; 1 if nothing varies."""
    return float(np.sqrt(values.var(axis=0).sum())) or 1.0
