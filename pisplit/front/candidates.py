"""The models that ``identify`` tries: each says what it needs, how it is fitted, and the code that does the same."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from pisplit import BilinearEDMDc, Dictionary, LinearEDMDc, PIEDMDc, TwinEDMDc
from pisplit import observables as ob
from pisplit.front.case import Case
from pisplit.models.arm.twin import OMIT, SLACK_WIDTH, twin_dictionaries

#: Ridges to choose from: with few pairs bilinear models need more than the estimators' own grid has.
RIDGES = tuple(np.logspace(-10, 3, 14).tolist())
#: Most states of models with delays, and of those with polynomials of the states.
DELAYED, POLYNOMIAL = 40, 6
#: Costs within this part of the smallest error are worth a larger penalty: margins count in control.
TOLERANCE = 0.1
#: Folds for models of data alone, and for those with physics: these need little from data, and their regressions are
#: the dear ones.
FOLDS, PHYSICAL_FOLDS = 3, 1


@dataclass(frozen=True)
class Candidate:
    """A kind of model.

    Attributes:
        name: in the report.
        missing: why it cannot be tried on a case, empty if it can.
        fit: the fitted estimator; may raise ValueError, RuntimeError or LinAlgError.
        code: what does the same by hand, from ``d1`` and what else the code of :func:`preamble` has made.
    """

    name: str
    missing: Callable[[Case], str]
    fit: Callable[[Case], Any]
    code: str


#: Observables of a dictionary: class and arguments.
Terms = tuple[tuple[str, dict[str, Any]], ...]


def _data_only(name: str, kind: Any, missing: Callable[[Case], str], **more: dict[str, Any]) -> Candidate:
    """EDMDc on the recordings alone: constant, states and inputs, and ``more`` observables with their arguments."""
    terms: Terms = (("Constant", {}), ("States", {}), ("Inputs", {}), *more.items())

    def fit(case: Case) -> Any:
        d1 = case.d1
        theta = Dictionary(*(getattr(ob, n)(**a) for n, a in terms), n_states=d1.n_states, n_inputs=d1.n_inputs)
        estimator = kind(theta, "cv", alphas=RIDGES, cv_states=case.states, cv_tolerance=TOLERANCE, cv_folds=FOLDS)
        return estimator.fit(d1, excitation=case.excitation)

    shown = ", ".join(f"ob.{n}({', '.join(f'{k}={v!r}' for k, v in a.items())})" for n, a in terms)
    code = f"""theta = Dictionary(
    {shown},
    n_states=d1.n_states, n_inputs=d1.n_inputs,
)
ridges = np.logspace(-10, 3, 14).tolist()
model = {kind.__name__}(
    theta, alpha="cv", alphas=ridges, cv_states=states, cv_tolerance={TOLERANCE}, cv_folds={FOLDS}
).fit(d1, excitation=excitation)"""
    return Candidate(name, missing, fit, code)


def _always(case: Case) -> str:
    return ""


def _few_states(most: int) -> Callable[[Case], str]:
    return lambda case: "" if case.d1.n_states <= most else f"{case.d1.n_states} states; tried up to {most}"


def _pulls(case: Case) -> str:
    return "" if case.arm is not None else "for tendons: no arm given"


def _hold(case: Case) -> Any:
    physics = case.physics()
    estimator = PIEDMDc(
        physics.dictionary(),
        alpha="cv",
        penalty="ridge",
        split="hold",
        options=physics.options(),
        cv_states=case.states,
        cv_tolerance=TOLERANCE,
        cv_folds=PHYSICAL_FOLDS,
    )
    return estimator.fit(case.d1, case.phase_samples(), excitation=case.excitation)


HOLD = f"""from pisplit.models.arm import ArmPhysics, equilibrium_table, make_phase_samples

physics = ArmPhysics(equilibrium_table(arm, half_width=2.2 * arm.amplitude), stations=d1.n_states // 24)
n, x = arm.scene.n_strains, np.concatenate([x[1:] for x in d1.xs])
rods = np.asarray(arm.scene.coordinates(d1.n_states // 24).function.map(len(x))(x.T)).T
rest = physics.table.values(d1.stacked_inputs())[:, :n]
d2 = make_phase_samples(
    arm, "d2.h5", samples=1000, rates=rods[:, n:], deviations=rods[:, :n] - rest, stations=d1.n_states // 24, seed=7919
)
model = PIEDMDc(
    physics.dictionary(), alpha="cv", penalty="ridge", split="hold", options=physics.options(), cv_states=states,
    cv_tolerance={TOLERANCE}, cv_folds={PHYSICAL_FOLDS},
).fit(d1, d2, excitation=excitation)"""


def _no_twin(case: Case) -> str:
    if reason := case.no_rod():
        return reason
    if case.shapes is None and not case.is_simulated:
        return "no shapes at rest: a dozen photographs with their inputs calibrate the drawing (shapes=)"
    return ""


def _twin(case: Case) -> Any:
    twin, moved = case.twin(), case.twin_excitation()
    if "dictionaries" not in case.made:
        case.made["dictionaries"] = twin_dictionaries(twin, moved)
    theta, ridge = case.made["dictionaries"][-1]
    estimator = TwinEDMDc(
        theta, "cv", ridge, omit=OMIT, cv_states=case.states, cv_tolerance=TOLERANCE, cv_folds=PHYSICAL_FOLDS
    )
    return estimator.fit(case.d1, twin, excitation=moved)


TWIN = f"""from pisplit.models.arm import random_displacements, twin_dictionaries

twin = arm.record(16, seed=7919, steps=min(200, max(60, *map(len, d1.us))), dt=d1.dt, stations=d1.n_states // 24)
moved = np.stack([random_displacements(arm, 120, np.random.default_rng(7919 + k)) for k in range(4)])
theta, ridge = twin_dictionaries(twin, moved)[-1]
model = TwinEDMDc(
    theta, "cv", ridge, omit={OMIT!r}, cv_states=states, cv_tolerance={TOLERANCE}, cv_folds={PHYSICAL_FOLDS}
).fit(d1, twin, excitation=moved)"""

#: In the order in which they are told; the first of equal ones is taken.
CANDIDATES: tuple[Candidate, ...] = (
    _data_only("L-EDMDc", LinearEDMDc, _always, Delays={"inputs": 1}),
    _data_only("L-EDMDc, 4 delays", LinearEDMDc, _few_states(DELAYED), Delays={"states": 4, "inputs": 4}),
    _data_only("L-EDMDc, 8 delays", LinearEDMDc, _few_states(DELAYED), Delays={"states": 8, "inputs": 8}),
    _data_only("L-EDMDc, cubic", LinearEDMDc, _few_states(POLYNOMIAL), Polynomials={"degree": 3}),
    _data_only("B-EDMDc", BilinearEDMDc, _always, Delays={"inputs": 1}, Bilinear={}),
    _data_only(
        "B-EDMDc, 4 delays", BilinearEDMDc, _few_states(DELAYED), Delays={"states": 4, "inputs": 4}, Bilinear={}
    ),
    _data_only("B-EDMDc, cubic", BilinearEDMDc, _few_states(POLYNOMIAL), Polynomials={"degree": 3}, Bilinear={}),
    _data_only(
        "B-EDMDc, slack", BilinearEDMDc, _pulls, Delays={"inputs": 1}, Slack={"width": SLACK_WIDTH}, Bilinear={}
    ),
    Candidate("PI-EDMDc, hold", Case.no_rod, _hold, HOLD),
    Candidate("PI-EDMDc, twin", _no_twin, _twin, TWIN),
)

CALIBRATE = """from pisplit.models.calibration import calibrate_from_shapes

drawn = arm
found = calibrate_from_shapes(
    drawn, shapes.inputs, shapes.fields, shapes.position_error, shapes.rotation_error, shapes.stations
)
arm = found.arm  # then its damping: pisplit.models.calibration.calibrate_from_recordings(free=("damping",))
"""


CHOOSE = """from pisplit.models.calibration import choose_calibration

drawn = arm
found = choose_calibration(drawn, d1, shapes, disks={disks!r})
arm = found.arm  # behind the servos found.actuator; found.predictor() rolls it out
"""


def by_hand(case: Case, candidate: Candidate) -> str:
    """The code that fits ``candidate`` to all recordings of the ``case``, from ``d1`` (and ``arm``, ``shapes``)."""
    lines = [
        "import numpy as np",
        "from pisplit import BilinearEDMDc, Dictionary, LinearEDMDc, PIEDMDc, TwinEDMDc, observables as ob",
        "",
        f"states = {case.states!r}",
        "steps = min(map(len, d1.us))",
        "excitation = np.stack([u[:steps] for u in d1.us[:8]])",
    ]
    if case.shapes is not None and candidate.name.startswith("PI"):
        chosen = CHOOSE.format(disks=case.forms)
        lines += (CALIBRATE if case.chosen is None else chosen).splitlines()
    return "\n".join([*lines, *candidate.code.splitlines()])


def fitted(candidate: Candidate, case: Case) -> tuple[Any, str]:
    """The estimator of the ``candidate`` fitted to the ``case`` without a word, or None and why not."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # what matters of it is in the report
        try:
            return candidate.fit(case), ""
        except (ValueError, RuntimeError, np.linalg.LinAlgError) as error:
            return None, " ".join(str(error).split())
