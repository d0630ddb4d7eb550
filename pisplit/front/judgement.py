"""What a model is not fit for and what would help most, read from its data and its held-out errors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pisplit import HorizonErrors
from pisplit.front.case import Case
from pisplit.front.report import Tried

#: Normalised error above which a prediction is of no use, and below which a model is as good as it needs to be.
USELESS, GOOD = 0.5, 0.02
#: A model with all recordings has to be so many times better than with half of them for more to be worth recording.
WORTH = 1.25
#: So many times worse is no prediction any more.
LOST = 30.0
#: Noise in parts of the spread from which on a state is named, where that of others is so many times less.
HEARD, BLOWN = 0.05, 10.0


def unfit(case: Case, estimator: Any, errors: HorizonErrors | None) -> tuple[str, ...]:
    """What the fitted ``estimator`` is not fit for, on recordings of the ``case`` with its held-out ``errors``."""
    d1, found = case.d1, []
    u = d1.stacked_inputs()
    low, high = u.min(axis=0), u.max(axis=0)
    rate = max((float(np.abs(np.diff(v, axis=0)).max()) for v in d1.us if len(v) > 1), default=0.0)
    unit = _unit(d1.input_units)
    found.append(
        f"inputs outside {_span(low)} .. {_span(high)}{unit}, or that change by more than {rate:.3g}{unit} a step"
    )
    _, basis = d1.input_subspace()
    if 0 < basis.shape[1] < d1.n_inputs:
        what = " such as a pull of all tendons at once" if case.arm is not None else ""
        found.append(
            f"inputs in other directions than the {basis.shape[1]} (of {d1.n_inputs}) that were recorded{what}"
        )
    if errors is not None:
        late = [d1.dt * h for h, e in zip(errors.horizons, errors.normalised, strict=True) if not e < USELESS]
        if late:
            found.append(f"predictions of {late[0]:.3g} s and more: the error there is half of the motion itself")
    if getattr(estimator, "bounded_", None) is False:
        found.append("long roll-outs: under inputs of the recorded kind it leaves three times the recorded range")
    return tuple(found)


def helps(
    case: Case, tried: Sequence[Tried], chosen: str, errors: HorizonErrors | None, gain: float | None
) -> tuple[str, ...]:
    """What would make the model better, most promising first.

    ``tried`` are all candidates, ``chosen`` the name of the best, ``errors`` its held-out errors and ``gain`` how many
    times better it is with all recordings of the ``case`` than with half of them, None where that is not known.
    """
    found = []
    last = np.inf if errors is None else float(errors.normalised[-1])
    steps = sum(map(len, case.d1.us))
    if gain is not None and gain >= LOST:
        found.append("more recordings, to be safe: fitted to half of them this model is lost on those held out")
    elif gain is not None and gain >= WORTH and last > GOOD:
        found.append(f"more recordings: with all {steps} steps it is {gain:.2g} times better than with half of them")
    if case.arm is None:
        if case.d1.n_states > 1 and last > GOOD:
            found.append("if this is an arm: a drawing of it (arm=ps.TendonArm(...)), from which physics is taken")
    elif case.shapes is None and not case.is_simulated:
        found.append("a dozen shapes at rest with their inputs (shapes=): they calibrate the drawing")
    if case.chosen is not None:
        found += [f"the form of the arm: {doubt}" for doubt in case.chosen.doubts]
    if blown := _blown_up(case):
        found.append(f"units of the states: those of one unit share a scale, here {blown} count with their noise alone")
    _, basis = case.d1.input_subspace()
    if 0 < basis.shape[1] < case.d1.n_inputs and case.arm is None:
        found.append(
            f"richer inputs: {case.d1.n_inputs - basis.shape[1]} of {case.d1.n_inputs} directions never change"
        )
    physical = [t.error for t in tried if t.name.startswith("PI") and np.isfinite(t.error)]
    data = [t.error for t in tried if not t.name.startswith("PI") and np.isfinite(t.error)]
    if physical and data and min(physical) > min(data) and case.arm is not None and case.chosen is None:
        found.append("a better drawing: models from the recordings alone are ahead of those with the drawn physics")
    if not found:
        least = f"its error is {100 * last:.2g} % of the motion" if np.isfinite(last) else "nothing was held out"
        found.append(f"nothing that is plain from these data: {least}; record what the arm shall do later")
    return tuple(found)


def _blown_up(case: Case) -> str:
    """States without a unit, each scaled by its own range, that are noise while others are clear; or nothing."""
    spread = case.d1.stacked_states().std(axis=0)
    share = case.noise / np.where(spread > 0.0, spread, np.inf)
    bare = np.array([not unit for unit in case.d1.units or ()])
    if not bare.any() or share[bare].min() * BLOWN > share[bare].max():
        return ""
    names = [n for n, s, b in zip(case.d1.state_names or (), share, bare, strict=True) if b and s > HEARD]
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def _span(values: Any) -> str:
    if np.ptp(values) < 0.05 * (np.abs(values).max() or 1.0):
        return f"{float(np.mean(values)):.3g}"
    return "(" + ", ".join(f"{v:.3g}" for v in values) + ")"


def _unit(units: Any) -> str:
    known = set(units or ())
    return f" {known.pop()}" if len(known) == 1 and "" not in known else ""
