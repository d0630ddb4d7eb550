"""Models for other tools: arrays, state-space objects, C code."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pisplit.files import write_text
from pisplit.lifted.c_code import array, casadi_code, checked_name, listed, renamed, wrapper
from pisplit.lifted.model import LiftedModel
from pisplit.lifted.modes import refuse_bilinear, refuse_relifted

Array = NDArray[np.float64]


def to_numpy(model: LiftedModel) -> dict[str, Any]:
    """A, B, c, C, d (and N of a bilinear ``model``), dt, names and units as arrays, numbers and lists of text (copies).

    Raises ValueError for a re-lifted model, whose products these do not hold: ``model.save`` does.
    """
    refuse_relifted(model, "complete list of matrices")
    arrays = {name: np.array(getattr(model, name)) for name in ("A", "B", "c", "C", "d", "state_range")}
    arrays |= {} if model.N is None else {"N": np.array(model.N)}
    names = ("state_names", "input_names", "column_names", "feature_names", "state_units", "input_units")
    return {
        **arrays,
        "dt": model.dt,
        "n_delays": model.n_delays,
        **{name: list(getattr(model, name)) for name in names},
    }


def state_space_matrices(model: LiftedModel) -> tuple[Array, Array, Array, Array, tuple[str, ...]]:
    """A, B, C, D and the names of the inputs of z+ = A z + B v, y = C z + D v with the features as inputs v.

    A model with an affine term has one more input, "1", that is to be held at 1. Raises ValueError for bilinear models.
    """
    refuse_bilinear(model, "state-space form")
    b, d = model.B, np.zeros((model.n_states, model.n_features))
    names = model.feature_names
    if model.c.any() or model.d.any():
        b, d, names = np.column_stack([b, model.c]), np.column_stack([d, model.d]), (*names, "1")
    return model.A, b, model.C, d, names


def to_state_space(model: LiftedModel) -> Any:
    """The ``model`` as ``scipy.signal.StateSpace`` in discrete time.

    Its inputs are the features of the inputs (plus "1" if affine).
    """
    from scipy.signal import StateSpace

    a, b, c, d, _ = state_space_matrices(model)
    return StateSpace(a, b, c, d, dt=model.dt)


def to_control(model: LiftedModel) -> Any:
    """The ``model`` as ``control.StateSpace`` with names, for python-control.

    Raises ValueError if that is not installed.
    """
    try:
        import control
    except ImportError:
        raise ValueError("python-control is not installed; run: pip install control") from None
    a, b, c, d, names = state_space_matrices(model)
    units = dict(zip(model.state_names + model.input_names, model.units + tuple(model.input_units or ()), strict=True))
    return control.ss(
        a,
        b,
        c,
        d,
        model.dt,
        states=_labels(model.column_names, {}),
        outputs=_labels(model.state_names, units),
        inputs=_labels(names, units),
    )


def _labels(names: Sequence[str], units: Mapping[str, str]) -> list[str]:
    """Names with units, all different, without characters that python-control reserves for itself (x1[k-1])."""
    found: list[str] = []
    for name in names:
        text = f"{name}_{units[name]}" if units.get(name) else name
        text = re.sub(r"\W+", "_", text.replace("+", "_plus_").replace("-", "_minus_")).strip("_") or "_"
        label, number = text, 2
        while label in found:
            label, number = f"{text}_{number}", number + 1
        found.append(label)
    return found


def to_c_header(model: LiftedModel, path: str | os.PathLike[str], name: str = "model") -> None:
    """Write the ``model`` to ``path`` as one C99 header without dependencies but <math.h>: whole or not at all.

    With ``name`` = NAME it defines NAME_STATES, NAME_INPUTS, NAME_LIFTED, NAME_FEATURES, NAME_DELAYS, NAME_DT and

        void name_lift(const double *x_history, const double *u_history, double *z);
        void name_features(const double *u, double *phi);
        void name_step(const double *z, const double *u, double *z_next);
        void name_read(const double *z, double *x);

    Histories hold one time after another, oldest first; z_next must not be z.
    Raises ValueError for a re-lifted model, if the name is no C identifier, the folder is missing, or a function cannot
    be written in C.
    """
    checked_name(name)
    refuse_relifted(model, "C form")
    write_text(path, _header(model, name))


def _header(model: LiftedModel, name: str) -> str:
    upper = name.upper()
    functions = {"lift": renamed(model.lift_function, f"{name}_casadi_lift")}
    functions["features"] = renamed(model.input_function, f"{name}_casadi_features")
    code = casadi_code(name, functions.values())
    sizes = {
        "STATES": model.n_states,
        "INPUTS": model.n_inputs,
        "LIFTED": model.n_lifted,
        "FEATURES": model.n_features,
        "DELAYS": model.n_delays,
    }
    lines = [
        f"/* z+ = A z + B phi(u) + c, x = C z + d, every {model.dt:g} s. Include it in one source file.",
        f"   x: {listed(model.state_names, model.units)}",
        f"   u: {listed(model.input_names, model.input_units or ())} */",
        f"#ifndef {upper}_H",
        f"#define {upper}_H",
        *(f"#define {upper}_{key} {value}" for key, value in sizes.items()),
        f"#define {upper}_DT {model.dt!r}",
        code,
        *(array(f"{name}_{letter}", getattr(model, letter)) for letter in ("A", "B", "c", "C", "d")),
        *([] if model.N is None else [array(f"{name}_N", model.N)]),
        wrapper(name, "lift", functions["lift"], ("x_history", "u_history"), "z"),
        wrapper(name, "features", functions["features"], ("u",), "phi"),
        (_STEP % ("" if model.N is None else _BILINEAR)).replace("NAME", upper).replace("name", name),
        "#endif",
    ]
    return "\n".join(lines) + "\n"


_STEP = """static void name_step(const double *z, const double *u, double *z_next) {
  double phi[NAME_FEATURES + 1];
  name_features(u, phi);
  for (int i = 0; i < NAME_LIFTED; ++i) {
    double sum = name_c[i];
    for (int j = 0; j < NAME_LIFTED; ++j) sum += name_A[i * NAME_LIFTED + j] * z[j];
    for (int j = 0; j < NAME_FEATURES; ++j) sum += name_B[i * NAME_FEATURES + j] * phi[j];
%s    z_next[i] = sum;
  }
}
static void name_read(const double *z, double *x) {
  for (int i = 0; i < NAME_STATES; ++i) {
    double sum = name_d[i];
    for (int j = 0; j < NAME_LIFTED; ++j) sum += name_C[i * NAME_LIFTED + j] * z[j];
    x[i] = sum;
  }
}"""

_BILINEAR = """    for (int k = 0; k < NAME_INPUTS; ++k)
      for (int j = 0; j < NAME_LIFTED; ++j)
        sum += u[k] * name_N[(k * NAME_LIFTED + i) * NAME_LIFTED + j] * z[j];
"""
