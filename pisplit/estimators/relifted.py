"""EDMDc whose dictionary is evaluated anew at every step: data alone, and the stronger baseline where they are many.

With few noisy pairs it is the weaker one (docs/ablation.md).
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit import observables as ob
from pisplit.checks import count, non_negative
from pisplit.data.episodes import Episodes, Pairs
from pisplit.data.noise import noise_margins
from pisplit.data.sums import together
from pisplit.dictionary.dictionary import Dictionary
from pisplit.estimators.alpha_search import state_weights
from pisplit.estimators.base import Estimator
from pisplit.estimators.boundedness import Excitation
from pisplit.estimators.commands import excitation_inputs
from pisplit.estimators.fold_errors import LOST, FoldErrors, RolloutVerdict, constant_error, judged, reasons
from pisplit.estimators.folds import Fold, make_folds
from pisplit.estimators.relifted_coordinates import Coordinates, product_table
from pisplit.estimators.relifted_kinks import Kinked
from pisplit.lifted.model import LiftedModel
from pisplit.lifted.operators import excited_inputs, state_range
from pisplit.lifted.relifting import ReliftedTerm
from pisplit.threads import one_blas_thread

Array = NDArray[np.float64]

#: Ridges to choose from, relative to the mean diagonal of the Gram matrix.
RIDGES = tuple(np.logspace(-12, 0, 9).tolist())
#: Structures whose squared error is so many times that of the best on the folds so far are not fitted to the next.
BEHIND = 9.0


@dataclass(frozen=True)
class Structure:
    """Numbers of ``components``, of ``leading`` ones in products, ``degree`` of these, and ridge ``alpha``."""

    components: int
    leading: int
    degree: int
    alpha: float

    def __str__(self) -> str:
        products = f"products of {self.leading} up to degree {self.degree}"
        return f"{self.components} components, {products}, alpha = {self.alpha:.3g}"


@dataclass(frozen=True)
class StructureSearch:
    """What was tried on roll-outs of held-out recordings.

    tried      structures, the best first
    errors     (G,) their median squared errors in scaled states, geometric means over folds; infinite where a roll-out
               diverged, and for those that fell far behind on the first folds
    chosen     the first that stays bounded, or the first of all
    held_out   numbers of the episodes that were held out
    bounded    whether the choice stays bounded under the excitation; None if nobody asked
    table      errors fold by fold, in the order of ``tried``
    reasons    why the choice may be wrong, a line each; fit warns of them
    """

    tried: tuple[Structure, ...]
    errors: Array
    chosen: Structure
    held_out: tuple[int, ...]
    bounded: bool | None
    table: FoldErrors
    reasons: tuple[str, ...]

    @property
    def position(self) -> int:
        """Where the choice stands among what was tried."""
        return self.tried.index(self.chosen)

    @property
    def error(self) -> float:
        """Error of the choice."""
        return float(self.errors[self.position])


class ReliftedEDMDc(Estimator):
    """c+ = c + K Theta(c, (u + u_prev)/2, u - u_prev): states are predicted, and Theta is evaluated anew at each step.

    c are principal components of the states, x is read from them. Theta holds a constant, c, the mean input and its
    change (inputs are taken to be ramps from the last command to the coming one), products of the leading components
    and of these, and the other components times the inputs. A lift that is propagated by a matrix must be closed under
    the dynamics to stay what it is; a re-lifted one is only asked for the next state. The price is a step that is not
    linear: MPC linearises it along its plan, once a move.

    components  numbers of principal components to choose from
    leading     numbers of leading components whose products are columns, to choose from
    degrees     of these products, to choose from, 1 to 3
    alphas      ridges to choose from, relative to the mean diagonal of the Gram matrix, 1e-12 to 1 if not given; the
                increment c+ - c is shrunk
    cv_states   states (output group, names or indices) whose roll-out error chooses; default all
    cv_horizon, cv_folds  as in LinearEDMDc
    omit        quantities of states that do not shape the components, but are read from them
    tension     what tendons feel (:class:`pisplit.observables.Tension`): softplus functions and gates of their stretch
                under the coming command beside all other columns; for tendons that go slack
    slip        how fast tendons slide where they rub (:class:`pisplit.observables.Slip`): gates of it beside all other
                columns; for friction that turns round

    What is chosen is the best on roll-outs of held-out training recordings, of those that stay bounded under the
    excitation. After ``fit``: ``lifted`` (a LiftedModel with ``relifted``; its lifted state is c and the last input),
    ``search_`` (StructureSearch), ``bounded_``. Raises ValueError for options that can be nothing of their kind.

    Source: Korda and Mezic, Automatica 93 (2018), for the lift; evaluated anew it is a polynomial NARX model (Billings,
    Nonlinear System Identification, 2013) in principal coordinates.
    """

    def __init__(
        self,
        components: Sequence[int] = (6, 10, 16, 24),
        leading: Sequence[int] = (0, 4, 8),
        degrees: Sequence[int] = (2, 3),
        alphas: Sequence[float] | None = None,
        cv_states: str | Sequence[int] | Sequence[str] | None = None,
        omit: Sequence[str] = (),
        cv_horizon: int | None = None,
        cv_folds: int | None = None,
        tension: ob.Tension | None = None,
        slip: ob.Slip | None = None,
    ) -> None:
        _each(components, "components", 1)
        _each(leading, "leading", 0)
        if max(_each(degrees, "degrees", 1)) > 3:
            raise ValueError(f"degrees = {list(degrees)}; expected numbers from 1 to 3")
        if isinstance(alphas, str) or (alphas is not None and not (np.iterable(alphas) and len(list(alphas)))):
            raise ValueError(f"alphas = {alphas!r}; expected numbers to choose from, at least one")
        for i, value in enumerate(alphas or ()):
            non_negative(value, f"alphas[{i}]")
        for number, name in ((cv_horizon, "cv_horizon"), (cv_folds, "cv_folds")):
            if number is not None:
                count(number, name)
        self.components = components
        self.leading = leading
        self.degrees = degrees
        self.alphas = alphas
        self.cv_states = cv_states
        self.omit = omit
        self.cv_horizon = cv_horizon
        self.cv_folds = cv_folds
        Kinked(tension, slip)
        self.tension = tension
        self.slip = slip

    @property
    def n_delays(self) -> int:
        """Steps of history a prediction starts from: one, the last input."""
        return 1

    @one_blas_thread()
    def fit(
        self, d1: Episodes | Sequence[Episodes], pairs: Pairs | None = None, excitation: ArrayLike | str | None = "auto"
    ) -> ReliftedEDMDc:
        """Choose and fit on all pairs of the episodes ``d1``, or on ``pairs`` drawn from them. Returns itself.

        ``excitation`` (E, T, m): input sequences that the model has to stay bounded under
        (:class:`pisplit.estimators.boundedness.Excitation`). "auto" and "data": commands put together from the recorded
        ones (:func:`pisplit.estimators.commands.resampled_commands`); None: no test. Warns if no structure that was
        tried stays bounded.
        Raises ValueError for data of which no recording can be held out, and if every structure diverges on those.
        """
        d1 = together(d1, "d1")
        all_of = d1.pairs(1) if pairs is None else d1.checked_pairs(pairs, 1)
        theta = state_dictionary(d1)
        if set(self.omit) - set(theta.names.quantities):
            raise ValueError(f"omit = {list(self.omit)}; expected quantities of {sorted(set(theta.names.quantities))}")
        folds = make_folds(
            d1, all_of, 1, 1 if pairs is None else max(1, pairs.n_delays), self.cv_horizon, self.cv_folds
        )
        structures = self._structures(min(len(fold.training) for fold in folds))
        found = self._judged(d1, theta, all_of, folds, structures)
        errors = found.joint()
        if not np.isfinite(errors).any():
            raise ValueError(
                f"all {len(structures)} structures diverge on held-out recordings; give more data or components"
            )
        survive = None
        inputs = excitation_inputs(excitation, True, d1, self.cv_horizon)
        if inputs is not None:
            survive = Excitation.of(inputs, [d1.pairs(1)], theta.names.quantities)
        order = [i for i in np.argsort(errors, kind="stable").tolist() if np.isfinite(errors[i])]
        models = ((i, next(self._models(d1, all_of, theta, [structures[i]]))[1]) for i in order)
        chosen = next(((i, m) for i, m in models if survive is None or survive.bounds(m)), None)
        bounded = None if survive is None else chosen is not None
        if chosen is None:
            chosen = order[0], next(self._models(d1, all_of, theta, [structures[order[0]]]))[1]
            warnings.warn(
                "no structure that was tried stays bounded under the excitation; give more data", stacklevel=2
            )
        best = chosen[0]
        allowed = np.ones(len(order), dtype=bool) if bounded is False else np.arange(len(order)) >= order.index(best)
        permitted = np.zeros(len(structures), dtype=bool)
        permitted[np.array(order)[allowed]] = True
        said = reasons(found, list(map(str, structures)), best, permitted, 0.0)
        for reason in said:
            warnings.warn(reason, stacklevel=2)
        numbers = tuple(sorted({i for fold in folds for i in fold.numbers}))
        ranked = np.argsort(errors, kind="stable")
        tried = tuple(structures[i] for i in ranked)
        self.search_ = StructureSearch(
            tried, errors[ranked], structures[best], numbers, bounded, found.take(ranked.tolist()), said
        )
        self.lifted, self.theta_, self.bounded_ = chosen[1], theta, bounded
        return self

    def _judged(
        self, d1: Episodes, theta: Dictionary, pairs: Pairs, folds: Sequence[Fold], structures: Sequence[Structure]
    ) -> FoldErrors:
        """Roll-outs of ``structures`` on all ``folds``; what is far behind so far takes no part in the next."""
        weights = state_weights(theta, pairs, noise_margins(d1))
        verdicts: list[list[RolloutVerdict]] = [[] for _ in structures]
        constant, running = [], list(range(len(structures)))
        for number, fold in enumerate(folds, start=1):
            models = self._models(d1, fold.training, theta, [structures[i] for i in running])
            for i, (_, model) in zip(running, models, strict=True):
                verdicts[i].append(judged(model, fold, self.cv_states, weights))
                last = model
            constant.append(constant_error(last, fold, self.cv_states, weights))
            for row in verdicts:
                row += [LOST] * (number - len(row))
            joint = FoldErrors.of(folds[:number], verdicts, constant).joint()
            if np.isfinite(joint).any():
                running = np.flatnonzero(joint <= BEHIND * joint.min()).tolist()
        return FoldErrors.of(folds, verdicts, constant)

    def _structures(self, pairs: int) -> list[Structure]:
        """What is tried with so many ``pairs``."""
        seen: list[Structure] = []
        ridges = RIDGES if self.alphas is None else self.alphas
        for r in sorted({min(r, 2 * pairs) for r in map(int, self.components)}):
            for p in sorted({min(int(p), r) for p in self.leading}):
                for degree in sorted(set(map(int, self.degrees))):
                    seen += [Structure(r, p, degree, float(alpha)) for alpha in ridges]
        return seen

    def _models(
        self, d1: Episodes, pairs: Pairs, theta: Dictionary, structures: Sequence[Structure]
    ) -> Iterator[tuple[Structure, LiftedModel]]:
        """Models of the ``structures`` fitted to ``pairs``; those that differ in the ridge share a factorisation."""
        shape, solve, margins = None, None, noise_margins(d1)
        for s in structures:
            if shape is None or shape[0].sizes[0] != s.components or shape[1:] != (s.leading, s.degree):
                coordinates = Coordinates.of(pairs, theta.names.quantities, self.omit, s.components, margins)
                kinked = Kinked(self.tension, self.slip)
                solve = ReliftedRegression(coordinates, pairs, s.leading, s.degree, kinked, d1.dt)
                shape = coordinates, s.leading, s.degree
            assert solve is not None
            yield s, solve.model(s, d1, pairs, theta)


class ReliftedRegression:
    """Ridge regression of c+ - c on [1, c, mean input, change, products], for any ridge.

    ``coordinates`` of the states and inputs, ``pairs`` with one step of history, numbers of ``leading`` components and
    ``degree`` of their products; what is ``kinked`` in steps of ``dt`` in s beside them.
    """

    def __init__(
        self,
        coordinates: Coordinates,
        pairs: Pairs,
        leading: int,
        degree: int,
        kinked: Kinked | None = None,
        dt: float = 1.0,
    ) -> None:
        self.coordinates = coordinates
        r, q, m = coordinates.sizes
        basis, offset = coordinates.variables
        products = product_table(r, 2 * q, min(leading, r), degree)
        kinks, self.factors = (kinked or Kinked()).columns(coordinates, pairs, dt, products)
        self.term = ReliftedTerm(basis, offset, self.factors, np.zeros((r + m, len(self.factors))), kinks)
        c, after = ((x - coordinates.mean) @ coordinates.encode.T for x in (pairs.x, pairs.x_next))
        z = np.hstack([c, pairs.u_history[:, 0]])
        v = np.hstack([z, pairs.u]) @ basis.T + offset
        design, target = np.hstack([v, self.term.products(z, pairs.u)]), after - c
        self.centre, self.target_mean = design.mean(axis=0), target.mean(axis=0)
        joined = np.hstack([design - self.centre, target - self.target_mean])
        triangle = np.asarray(np.linalg.qr(joined, mode="r"))
        width = design.shape[1]
        u, self.s, self.vt = np.linalg.svd(triangle[:, :width], full_matrices=False)
        self.projected = u.T @ triangle[:, width:]

    def model(self, structure: Structure, d1: Episodes, pairs: Pairs, theta: Dictionary) -> LiftedModel:
        """The model with the ridge of the ``structure``; names of ``d1`` and ``theta``, inputs as in ``pairs``."""
        coordinates, s = self.coordinates, self.s
        r, _, m = coordinates.sizes
        alpha = structure.alpha * float((s**2).sum()) / self.vt.shape[1]
        gain = np.divide(s, s**2 + alpha, out=np.zeros_like(s), where=s > 1e-14 * s.max(initial=0.0))
        k = (self.vt.T * gain) @ self.projected
        one = self.target_mean - self.centre @ k
        basis, offset = coordinates.variables
        linear = np.asarray(k[: len(basis)].T @ basis, dtype=np.float64)
        a: Array = np.zeros((r + m, r + m))
        b: Array = np.zeros((r + m, m))
        c: Array = np.zeros(r + m)
        a[:r] = np.eye(r, r + m) + linear[:, : r + m]
        b[:r], b[r:] = linear[:, r + m :], np.eye(m)
        c[:r] = one + k[: len(basis)].T @ offset
        weights = np.vstack([k[len(basis) :].T, np.zeros((m, len(self.factors)))])
        directions = excited_inputs(pairs, d1.input_units)
        provenance = {
            "estimator": "ReliftedEDMDc",
            "structure": dict(vars(structure)),
            "pairs": len(pairs),
            "data": dict(d1.provenance or {}),
            "input_directions": list(directions.lines(theta.names.inputs)),
        }
        columns = (*(f"c{i + 1}" for i in range(r)), *(f"{name}[k-1]" for name in theta.names.inputs))
        u = ca.SX.sym("u", m)
        return LiftedModel(
            A=a,
            B=b,
            c=c,
            C=np.ascontiguousarray(np.hstack([coordinates.decode, np.zeros((len(coordinates.mean), m))])),
            d=coordinates.mean,
            dt=d1.dt,
            lift_function=_lift(coordinates),
            input_function=ca.Function("features", [u], [u]),
            n_delays=1,
            state_names=theta.names.states,
            input_names=theta.names.inputs,
            column_names=columns,
            feature_names=theta.names.inputs,
            input_offset=directions.offset,
            input_basis=directions.basis,
            state_range=state_range(pairs, theta.names.quantities),
            outputs={name: tuple(group) for name, group in (d1.outputs or {}).items()},
            provenance=provenance,
            state_units=d1.units,
            input_units=d1.input_units,
            relifted=ReliftedTerm(self.term.basis, self.term.offset, self.factors, weights, self.term.kinks),
        )


def _lift(coordinates: Coordinates) -> ca.Function:
    """(x_{k-1}, x_k), u_{k-1} -> (c, u_{k-1})."""
    _, _, m = coordinates.sizes
    x, u = ca.MX.sym("x", len(coordinates.mean), 2), ca.MX.sym("u", m, 1)
    c = ca.DM(coordinates.encode) @ (x[:, 1] - ca.DM(coordinates.mean))
    return ca.Function("lift", [x, u], [ca.densify(ca.vertcat(c, u))])


def state_dictionary(d1: Episodes) -> Dictionary:
    """States, inputs and the last input, with the names of ``d1``: what histories and names are checked with."""
    terms = (ob.Constant(), ob.States(), ob.Inputs(), ob.Delays(inputs=1))
    return Dictionary(*terms, n_states=d1.n_states, n_inputs=d1.n_inputs).named_after(d1)


def _each(values: Sequence[int], name: str, minimum: int) -> list[int]:
    if isinstance(values, str) or not np.iterable(values) or not len(list(values)):
        raise ValueError(f"{name} = {values!r}; expected numbers to choose from, at least one")
    return [count(value, f"{name}[{i}]", minimum) for i, value in enumerate(values)]
