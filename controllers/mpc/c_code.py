"""The step of an MPC in C: the numbers of a controller in front of the functions of ``step.h``."""

from __future__ import annotations

from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from pisplit.checks import Array
from pisplit.controllers.estimation.kalman import CLIPPED, MEAN_SIZE, NEWEST
from pisplit.controllers.estimation.lifted_state import PATIENCE
from pisplit.controllers.mpc.fallback import SLOWLY, THERE
from pisplit.controllers.mpc.limits import SPAN_TOLERANCE
from pisplit.controllers.mpc.steady import STAY
from pisplit.lifted.c_code import array, casadi_code, checked_name, listed, renamed, wrapper

if TYPE_CHECKING:
    from pisplit.controllers.mpc.mpc import MPC

#: A gate that rejects nothing.
GREATEST = 1e300


def c_step(mpc: MPC, name: str) -> str:
    """The header of :meth:`MPC.to_c`: the step of ``mpc``, whose functions and numbers begin with ``name``."""
    checked_name(name)
    _refuse(mpc)
    model, upper = mpc.model, name.upper()
    sizes, numbers, indices = _sizes(mpc), _numbers(mpc), _indices(mpc)
    for letter, matrix in (("A", model.A), ("C", model.C)):
        spans, kept = _spans(matrix)
        indices["span" if letter == "A" else "Cspan"], numbers[letter] = spans, kept
    lift = renamed(model.lift_function, f"{name}_casadi_lift")
    template = files("pisplit.controllers.mpc").joinpath("step.h").read_text(encoding="utf-8")
    head, code = template.split("*/\n", 1)
    parts = [
        head.replace("@N@", upper).replace("@n@", name) + "*/",
        f"/* every {model.dt:g} s\n   x: {listed(model.state_names, model.units)}",
        f"   u: {listed(model.input_names, model.input_units or ())}",
        f"   r: {listed([model.state_names[i] for i in mpc.tracked], [model.units[i] for i in mpc.tracked])} */",
        f"#ifndef {upper}_STEP_H\n#define {upper}_STEP_H\n#include <math.h>",
        *(f"#define {upper}_{key} {value!r}" for key, value in sizes.items()),
        casadi_code(name, [lift]),
        *(array(f"{name}_{key}", value) for key, value in numbers.items()),
        *(_integers(f"{name}_{key}", value) for key, value in indices.items()),
        wrapper(name, "lift", lift, ("x_history", "u_history"), "z"),
        code.replace("@N@", upper).replace("@n@", name).rstrip(),
        "#endif",
    ]
    return "\n".join(parts) + "\n"


def _refuse(mpc: MPC) -> None:
    if not mpc.model.features_are_inputs or mpc.model.relifted is not None:
        raise ValueError("C of the step is for linear and bilinear models; this one has other features or is re-lifted")
    if mpc.model.varies and mpc._latency.part:
        raise ValueError("C of the step of a bilinear model knows whole steps of delay; round the delays")
    if mpc._problem.n_variables != mpc._problem.n_moves:
        raise ValueError("C of the step knows no output limits; leave y_min and y_max out")
    if not mpc._servos.idle:
        raise ValueError("C of the step knows no servos; leave the actuator out")
    if mpc._estimation.watches:
        raise ValueError("C of the step does not look for stuck sensors; give stuck_after=None")


def _sizes(mpc: MPC) -> dict[str, Any]:
    """Sizes and single numbers by their names in C."""
    model, limits, latency, observer = mpc.model, mpc._limits, mpc._latency, mpc._estimation.observer
    shift = latency.steps - latency.measurement
    whole = int(np.floor(shift))
    return {
        "STATES": model.n_states,
        "INPUTS": model.n_inputs,
        "OUTPUTS": len(mpc.tracked),
        "LIFTED": model.n_lifted,
        "DELAYS": model.n_delays,
        "STAGES": mpc.horizon - latency.preview,
        "HORIZON": mpc.horizon,
        "COORDINATES": limits.basis.shape[1],
        "MOVING": len(mpc._problem.rate_rows),
        "SENSORS": 0 if observer is None else len(observer.measured),
        "LATE": latency.steps,
        "PART": float(latency.part),
        "SHIFT": whole,
        "SHIFT_PART": float(shift - whole),
        "GAIN": float(mpc._estimation.gain),
        "SCALE": float(mpc._problem.scale),
        "SPAN": float(SPAN_TOLERANCE * limits.amplitude.max()),
        "PATIENCE": PATIENCE,
        "GATE": GREATEST if observer is None or observer.gate is None else observer.gate,
        "CLIPPED": CLIPPED,
        "NEWEST": NEWEST,
        "MEAN_SIZE": MEAN_SIZE,
        "SLOWLY": SLOWLY,
        "THERE": THERE,
        "BILINEAR": int(model.varies),
        "CHANGED": 0 if model.bilinear_term is None else len(model.bilinear_term.rows),
        "COLUMNS": 0 if model.bilinear_term is None else len(model.bilinear_term.columns),
        "RESTS": int(_at_rest(mpc)),
        "RESTING": int(_resting(mpc) is not None),
    }


def _numbers(mpc: MPC) -> dict[str, Array]:
    """Arrays by their names in C."""
    model, limits, problem, observer = mpc.model, mpc._limits, mpc._problem, mpc._estimation.observer
    m, M = model.n_inputs, model.n_lifted
    box = slice(0, len(problem.rate_rows))
    normal = np.zeros(m) if limits.normal is None else limits.normal
    p, r = len(mpc.tracked), limits.basis.shape[1]
    resting = _resting(mpc)
    output, gain, push = mpc.steady.affine() if _at_rest(mpc) else (np.zeros(p), np.zeros((p, r)), np.zeros((p, M)))
    per_half = problem.T / limits.amplitude[:, None]
    rest_state, rest_slope = (np.zeros(M), np.zeros((M, m))) if resting is None else resting
    kalman = usual = np.zeros(0)
    if observer is not None:
        kalman, usual = observer.gain.T, observer.innovation_std
    return {
        "B": model.B,
        "c": model.c,
        "d": model.d,
        **_predicted(mpc),
        "Q": problem.weights_of_outputs,
        "moved": problem.input_hessian,
        "change": problem.rate_hessian,
        "rows": problem.rate_rows,
        "low": problem.box[0][box],
        "high": problem.box[1][box],
        "fastest": problem.rate_limit,
        "u_min": limits.u_min,
        "u_max": limits.u_max,
        "du_max": limits.du_max,
        "half": limits.amplitude,
        "offset": limits.offset,
        "basis": limits.basis,
        "normal": normal,
        "gain": kalman,
        "usual": usual,
        "stay": STAY * per_half.T @ per_half,
        "rest_output": output,
        "rest_gain": gain,
        "rest_push": push,
        "rest_weight": mpc.steady.weight,
        "rest_state": rest_state,
        "rest_slope": rest_slope,
    }


def _predicted(mpc: MPC) -> dict[str, Array]:
    """What predictions are made of: condensed once, or the products of a bilinear model."""
    prediction, term, none = mpc._prediction, mpc.model.bilinear_term, np.zeros(0)
    names = ("free", "push", "constant", "late", "S", "N")
    if term is not None:
        assert mpc.model.N is not None
        return dict.fromkeys(names, none) | {"N": mpc.model.N[:, term.rows][:, :, term.columns]}
    condensed = prediction.condensed
    values = (condensed.free, condensed.disturbance, prediction.constant, prediction.late, prediction.nominal, none)
    return dict(zip(names, values, strict=True))


def _at_rest(mpc: MPC) -> bool:
    """Whether the steady target is known in C: that of a bilinear model is not."""
    return mpc.steady.exists and not mpc.model.varies


def _indices(mpc: MPC) -> dict[str, Any]:
    observer = mpc._estimation.observer
    term = mpc.model.bilinear_term
    products = {} if term is None else {"changed": term.rows.tolist(), "column": term.columns.tolist()}
    return {"tracked": mpc.tracked, **products, "sensors": () if observer is None else observer.measured.tolist()}


def _resting(mpc: MPC) -> tuple[Array, Array] | None:
    """Fixed points z (M,) + slope (M, m) u of the model, None where it has none or they are not asked for."""
    model = mpc.model
    if mpc._estimation.observer is None or model.varies:
        return None
    try:
        start = model.fixed_point(np.zeros(model.n_inputs))
        steps = np.diag(mpc._limits.amplitude)
        slope = np.stack([(model.fixed_point(u) - start) / u.sum() for u in steps], axis=1)
    except ValueError:
        return None
    return start, slope


def _spans(matrix: Array) -> tuple[list[int], Array]:
    """(first, size, at) of every row, one after the other, and its entries from the first to the last that counts."""
    spans: list[int] = []
    kept: list[Array] = []
    at = 0
    for row in matrix:
        used = np.flatnonzero(row)
        first, size = (int(used[0]), int(used[-1] - used[0]) + 1) if len(used) else (0, 0)
        spans += [first, size, at]
        kept.append(row[first : first + size])
        at += size
    return spans, np.concatenate(kept)


def _integers(name: str, values: Any) -> str:
    numbers = [str(int(v)) for v in values] or ["0"]
    return f"static const int {name}[{len(numbers)}] = {{{', '.join(numbers)}}};"
