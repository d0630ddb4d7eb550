"""Units of recorded columns and their factors to SI."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

#: Unit: (SI unit, factor).
UNITS = {
    "m": ("m", 1.0),
    "cm": ("m", 1e-2),
    "mm": ("m", 1e-3),
    "um": ("m", 1e-6),
    "inch": ("m", 0.0254),
    "ft": ("m", 0.3048),
    "rad": ("rad", 1.0),
    "deg": ("rad", float(np.pi / 180.0)),
    "rev": ("rad", float(2.0 * np.pi)),
    "rpm": ("rad/s", float(np.pi / 30.0)),
    "s": ("s", 1.0),
    "ms": ("s", 1e-3),
    "us": ("s", 1e-6),
    "ns": ("s", 1e-9),
    "min": ("s", 60.0),
    "hour": ("s", 3600.0),
    "day": ("s", 86400.0),
    "s^2": ("s^2", 1.0),
    "Hz": ("Hz", 1.0),
    "kg": ("kg", 1.0),
    "g": ("kg", 1e-3),
    "N": ("N", 1.0),
    "mN": ("N", 1e-3),
    "kN": ("N", 1e3),
    "lbf": ("N", 4.4482216152605),
    "Nm": ("Nm", 1.0),
    "mNm": ("Nm", 1e-3),
    "Pa": ("Pa", 1.0),
    "hPa": ("Pa", 1e2),
    "kPa": ("Pa", 1e3),
    "MPa": ("Pa", 1e6),
    "bar": ("Pa", 1e5),
    "mbar": ("Pa", 1e2),
    "psi": ("Pa", 6894.757293168361),
    "V": ("V", 1.0),
    "mV": ("V", 1e-3),
    "A": ("A", 1.0),
    "mA": ("A", 1e-3),
    "": ("", 1.0),
}
#: Other words for them.
WORDS = {
    **dict.fromkeys(("in", "inches"), "inch"),
    **dict.fromkeys(("meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("millimeter", "millimeters", "millimetre", "millimetres"), "mm"),
    **dict.fromkeys(("centimeter", "centimeters", "centimetre", "centimetres"), "cm"),
    **dict.fromkeys(("feet", "foot"), "ft"),
    **dict.fromkeys(("degree", "degrees", "°"), "deg"),
    **dict.fromkeys(("radian", "radians"), "rad"),
    **dict.fromkeys(("sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("msec", "millisecond", "milliseconds"), "ms"),
    **dict.fromkeys(("usec", "microsecond", "microseconds", "µs", "μs"), "us"),
    **dict.fromkeys(("nsec", "nanosecond", "nanoseconds"), "ns"),
    **dict.fromkeys(("minute", "minutes"), "min"),
    **dict.fromkeys(("h", "hr", "hours"), "hour"),
    **dict.fromkeys(("d", "days"), "day"),
    **dict.fromkeys(("s2", "s²"), "s^2"),
    **dict.fromkeys(("N m", "N*m", "N·m"), "Nm"),
    **dict.fromkeys(("volt", "volts"), "V"),
    **dict.fromkeys(("pascal", "pascals"), "Pa"),
    **dict.fromkeys(("newton", "newtons"), "N"),
    **dict.fromkeys(("µm", "μm", "micron", "microns"), "um"),
}


def to_si(unit: str, what: str) -> tuple[str, float]:
    """SI unit and factor of a ``unit`` or of a quotient of two, such as "mm/s".

    Raises ValueError for unknown ones; ``what`` is what the message calls the column.
    """
    parts = [WORDS.get(part.strip(), part.strip()) for part in unit.split("/")]
    if len(parts) > 2 or any(part not in UNITS for part in parts):
        known = ", ".join(name for name in UNITS if name)
        raise ValueError(f"{what}: {unit!r} is no known unit; expected one of {known}, or a quotient of two")
    factor = UNITS[parts[0]][1] / (UNITS[parts[1]][1] if len(parts) == 2 else 1.0)
    return "/".join(UNITS[part][0] for part in parts), factor


def written(text: str) -> str | None:
    """The unit that a ``text`` of a file names, with or without brackets: "[mm]", "Seconds", "m/s"; None for others."""
    plain = re.sub(r"^[\[(<]\s*|\s*[\])>]$", "", text.strip())
    if plain in ("g", "G"):  # of accelerations more often than of masses
        return None
    for candidate in (plain, plain.lower()):
        try:
            to_si(candidate, "")
        except ValueError:
            continue
        return candidate or None
    return None


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
