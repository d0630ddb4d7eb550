"""Parts of C headers: numbers, comments, functions that CasADi writes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def checked_name(name: str) -> str:
    """The ``name``; raises ValueError where it is no C identifier."""
    if not re.fullmatch(r"[A-Za-z]\w*", name):
        raise ValueError(f"name = {name!r}; expected a C identifier")
    return name


def casadi_code(name: str, functions: Iterable[ca.Function]) -> str:
    """C of these ``functions``, with what they share under ``name``; raises ValueError where CasADi has none."""
    generator = ca.CodeGenerator(name, {"with_header": False, "casadi_real": "double"})
    try:
        for function in functions:
            generator.add(function)
        return str(generator.dump())
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1]
        raise ValueError(f"a function of the model cannot be written in C: {reason}") from None


def _number(value: float) -> str:
    if np.isnan(value):
        return "NAN"
    return repr(value) if np.isfinite(value) else ("INFINITY" if value > 0.0 else "-INFINITY")


def listed(names: Sequence[str], units: Sequence[str]) -> str:
    """``names`` and ``units`` for a comment in C, which they must not end."""
    text = ", ".join(f"{name} [{unit}]" if unit else name for name, unit in zip(names, units, strict=True))
    return re.sub(r"[^\x20-\x7e]", "?", text).replace("*/", "* /").replace("/*", "/ *") or "none"


def renamed(function: ca.Function, name: str) -> ca.Function:
    """The ``function`` under another ``name``, with dense results."""
    symbols = [ca.MX.sym(f"a{i}", *function.size_in(i)) for i in range(function.n_in())]
    return ca.Function(name, symbols, [ca.densify(function(*symbols))])


def array(name: str, values: Array) -> str:
    """A constant array of the ``values``, row by row, as ``name`` in C; one zero where there are none."""
    numbers = [_number(float(value)) for value in np.asarray(values).reshape(-1)] or ["0.0"]
    rows = [", ".join(numbers[i : i + 6]) for i in range(0, len(numbers), 6)]
    return f"static const double {name}[{len(numbers)}] = {{\n" + ",\n".join(rows) + "};"


def wrapper(name: str, what: str, function: ca.Function, arguments: tuple[str, ...], result: str) -> str:
    """``name``_``what`` in C: the ``function`` that CasADi wrote, of plain ``arguments``, into ``result``."""
    given = ", ".join(f"const double *{argument}" for argument in arguments)
    assign = " ".join(f"arg[{i}] = {argument};" for i, argument in enumerate(arguments))
    return (
        f"static void {name}_{what}({given}, double *{result}) {{\n"
        f"  const double *arg[{max(function.sz_arg(), 1)}]; double *res[{max(function.sz_res(), 1)}];\n"
        f"  casadi_int iw[{max(function.sz_iw(), 1)}]; double w[{max(function.sz_w(), 1)}];\n"
        f"  {assign} res[0] = {result};\n"
        f"  {function.name()}(arg, res, iw, w, 0);\n}}"
    )
