"""L-, B- and PI-EDMDc as the paper prints them: its dictionary, its LASSO in every regression, Strang, identity rows.

They are the estimators of the package with the paper's options, on data in the units of the method. Everything that the
paper leaves open is an entry of :class:`Choices`.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.protocol import HISTORY, Draw, Lifted, Method, Prediction, Predictor, pairs_at
from pisplit import BilinearEDMDc, Dictionary, Episodes, LiftedModel, LinearEDMDc, PhaseSamples, PIEDMDc
from pisplit import observables as ob
from pisplit.regression.scaling import column_scales

Array = NDArray[np.float64]

#: Unknown part of the paper's split: h acts on the velocities alone (its eq. cosserat_rod_eq).
UNKNOWN = ("q", "omega")
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
    half_step   exponential of the generator ("generator"), its first order ("first-order"), EDMD on the flow of f
                ("flow"), or the generator unless its half step grows ("auto"); printed: the generator, the flow map
                where that is unstable, a first order where the flow is not to be had
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
        Method("L-EDMDc", Printed("L-EDMDc", chosen)),
        Method("B-EDMDc", Printed("B-EDMDc", chosen)),
        Method("PI-EDMDc", Printed("PI-EDMDc", chosen)),
    )


def dictionary(data: Episodes) -> Dictionary:
    """144 states, 4 delays and the inputs: M = 723."""
    theta = Dictionary(ob.Identity(), ob.Delays(states=HISTORY), n_states=data.n_states, n_inputs=data.n_inputs)
    return theta.named_after(data)


def estimator(name: str, data: Episodes, choices: Choices) -> Any:
    """The estimator of the method ``name`` for episodes in its units."""
    options: dict[str, Any] = {
        "alpha": choices.alpha,
        "penalty": "lasso",
        "relative": "samples",  # 0.01 N
        "solver": "active-set",
        "scale": None,
    }
    theta = dictionary(data)
    if name != "PI-EDMDc":
        return (BilinearEDMDc if name == "B-EDMDc" else LinearEDMDc)(theta, **options)
    sparse = choices.known == "lasso"
    return PIEDMDc(
        theta,
        **options,
        half_step=choices.half_step,
        rows=list(UNKNOWN) if choices.rows == "velocities" else None,
        generator_penalty="lasso" if sparse else "ridge",
        generator_alpha=choices.alpha if sparse else 0.0,
        past=choices.past,
    )


@dataclass(frozen=True)
class Printed:
    """Fits the method ``name``, "L-EDMDc", "B-EDMDc" or "PI-EDMDc", to a draw."""

    name: str
    choices: Choices
    memory: Memory = field(default_factory=lambda: Memory(), repr=False)

    def __call__(self, draw: Draw) -> Predictor:
        """Fit to the pairs of a draw, and to its phase-space samples."""
        model, units = self.fitted(draw)
        return InUnits(model.lifted, units)

    def fitted(self, draw: Draw) -> tuple[Any, Units]:
        """The fitted estimator, and the units it works in. Raises ValueError for an operator that is not finite."""
        units = self.memory.of("units", draw.episodes, lambda: Units.of(draw.episodes, self.choices.scaling))
        data = self.memory.of("data", draw.episodes, lambda: units.episodes(draw.episodes))
        model = estimator(self.name, data, self.choices)
        pairs = pairs_at(data, draw.rows, HISTORY)
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # gaps and conditions are in the details of every fit
            if self.name == "PI-EDMDc":
                samples = self.memory.of("samples", draw.d2, lambda: units.samples(draw.d2))
                model.fit(data, samples, pairs)
            else:
                model.fit(data, pairs)
        if not np.isfinite(model.K_).all():
            raise ValueError("the operator is not finite")
        return model, units


class Memory:
    """The data in their units that the last fit of a method had: draws of one run share them."""

    def __init__(self) -> None:
        self._last: dict[str, tuple[Any, Any]] = {}

    def of(self, name: str, source: Any, make: Callable[[], Any]) -> Any:
        """What ``make`` makes of ``source``; what it made last is kept, with its source."""
        if name not in self._last or self._last[name][0] is not source:
            self._last[name] = source, make()
        return self._last[name][1]


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
