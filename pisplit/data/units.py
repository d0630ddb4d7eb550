"""Units of recorded columns and their factors to SI."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

#: Unit: (SI unit, factor).
UNITS = {
    "m": ("m", 1.0),
    "cm": ("m", 1e-2),
    "mm": ("m", 1e-3),
    "um": ("m", 1e-6),
    "rad": ("rad", 1.0),
    "deg": ("rad", float(np.pi / 180.0)),
    "s": ("s", 1.0),
    "ms": ("s", 1e-3),
    "us": ("s", 1e-6),
    "ns": ("s", 1e-9),
    "N": ("N", 1.0),
    "mN": ("N", 1e-3),
    "Pa": ("Pa", 1.0),
    "kPa": ("Pa", 1e3),
    "bar": ("Pa", 1e5),
    "V": ("V", 1.0),
    "A": ("A", 1.0),
    "": ("", 1.0),
}


def to_si(unit: str, what: str) -> tuple[str, float]:
    """SI unit and factor of a ``unit`` or of a quotient of two, such as "mm/s".

    Raises ValueError for unknown ones; ``what`` is what the message calls the column.
    """
    parts = unit.split("/")
    if len(parts) > 2 or any(part not in UNITS for part in parts):
        known = ", ".join(name for name in UNITS if name)
        raise ValueError(f"{what}: {unit!r} is no known unit; expected one of {known}, or a quotient of two")
    factor = UNITS[parts[0]][1] / (UNITS[parts[1]][1] if len(parts) == 2 else 1.0)
    return "/".join(UNITS[part][0] for part in parts), factor


def conversion(given: str, wanted: str) -> float | None:
    """Factor that turns a number in unit ``given`` into one in unit ``wanted``; None if they have no common SI unit."""
    try:
        (mine, factor), (theirs, other) = to_si(given, ""), to_si(wanted, "")
    except ValueError:
        return 1.0 if given == wanted else None
    return factor / other if mine == theirs else None


def columns_to_si(
    units: str | Sequence[str] | None, what: str, size: int
) -> tuple[tuple[str, ...], NDArray[np.float64]]:
    """SI units and factors (size,) of columns, from one unit for all or one a column; None leaves them as they are.

    Raises ValueError for another number of units and for unknown ones; ``what`` is what the message calls them.
    """
    given = [""] * size if units is None else [units] * size if isinstance(units, str) else list(units)
    if len(given) != size:
        raise ValueError(f"{what} has {len(given)} entries; expected {size}, one a column")
    found = [to_si(unit, what) for unit in given]
    return tuple(name for name, _ in found), np.array([factor for _, factor in found])
