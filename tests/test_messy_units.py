"""Units wherever files write them, clocks in two columns, and other habits of programs: right numbers, or one line.

The motion is that of ``messy_generator``.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from messy_generator import ASK, DT, File, N, T, U, X, check, plain

from pisplit import Episodes

ROWS = [row.split(",") for row in plain().splitlines()[1:]]


def rows(header: str, cells: Callable[[str, str, str, str], str]) -> str:
    """A table with that ``header``, of lines that ``cells`` makes of time, x, y and command."""
    return header + "\n" + "".join(cells(*row) + "\n" for row in ROWS)


def times(x: str, factor: float) -> str:
    return repr(float(x) * factor)


def split(ns: int, digits: str) -> Callable[[str, str, str, str], str]:
    """Whole seconds, and what is left in ticks of ``ns`` nanoseconds."""

    def cells(t: str, x: str, y: str, u: str) -> str:
        left = round(1e9 * float(t)) % 1_000_000_000 // ns
        return f"{int(float(t) + 1e-9)},{left:{digits}},{x},{y},{u}"

    return cells


def at(k: int, word: str) -> str:
    """The table with ``word`` in the place of x in row ``k``."""
    changed = [[t, word if i == k else x, y, u] for i, (t, x, y, u) in enumerate(ROWS)]
    return "t,x,y,u\n" + "".join(",".join(row) + "\n" for row in changed)


def seam(factor: float) -> str:
    """The table with positions in another unit from its middle on."""
    changed = [
        [t, times(x, factor), times(y, factor), u] if 2 * i >= N else [t, x, y, u]
        for i, (t, x, y, u) in enumerate(ROWS)
    ]
    return "t,x,y,u\n" + "".join(",".join(row) + "\n" for row in changed)


def milli(t: str, x: str, y: str, u: str) -> str:
    return f"{t},{times(x, 1e3)},{y},{u}"


def of(factor: float) -> Callable[[str, str, str, str], str]:
    """Lines with x in another unit."""
    return lambda t, x, y, u: f"{t},{times(x, factor)},{y},{u}"


METRES, LOST = ("m", "m"), "taken for lost"
ONE, BOTH = {"states": ["x_mm", "y"]}, {"states": ["x_mm", "y_m"], "state_units": ["mm", "m"]}
LINUX = {"time": ["tv_sec", "tv_usec"]}
BACKWARDS = "t,x,y,u\n" + "".join(",".join(row) + "\n" for row in ROWS[::-1])
READ = [
    File("units above the names", rows("s,mm,m,V\nt,x,y,u", milli), units=METRES),
    File("units in brackets above the names", rows("[s],[mm],[m],[-]\nt,x,y,u", milli), units=METRES),
    File("units behind a stroke", rows("t / s,x / mm,y / m,u / V", milli), units=METRES),
    File("units behind a comma", rows("t, s;x, mm;y, m;u, V", lambda *c: milli(*c).replace(",", ";")), units=METRES),
    File(
        "units behind a stroke, full names",
        rows("t / s,x / mm,y / m,u / V", milli),
        {"time": "t / s", "states": ["x / mm", "y / m"], "inputs": ["u / V"]},
        units=METRES,
    ),
    File(
        "degrees",
        rows("t,x [\u00b0],y,u", of(180 / np.pi)),
        units=("rad", ""),
    ),
    File("micrometres", rows("t,x (\u03bcm),y,u", of(1e6)), units=("m", "")),
    File(
        "inches",
        rows("t,x [in],y [in],u", lambda t, x, y, u: f"{t},{times(x, 1 / 0.0254)},{times(y, 1 / 0.0254)},{u}"),
        units=METRES,
    ),
    File("what goes in is no inch", plain("t,x (in),y (out),u"), units=("", "")),
    File("speeds", rows("t,x [mm/s],y,u", milli), units=("m/s", "")),
    File(
        "name and unit by a line",
        rows("t,x_mm,y,u", milli),
        {"states": ["x_mm", "y"]},
        scale=1e3,
        warned="'x_mm': in mm by its name",
    ),
    File(
        "name and unit by a line, told",
        rows("t,x_mm,y_m,u", milli),
        {"states": ["x_mm", "y_m"], "state_units": ["mm", "m"]},
    ),
    File(
        "microseconds beside seconds", rows("tv_sec,tv_usec,x,y,u", split(1000, "d")), {"time": ["tv_sec", "tv_usec"]}
    ),
    File("milliseconds beside seconds", rows("sec,msec,x,y,u", split(1_000_000, "03d")), {"time": ["sec", "msec"]}),
    File("nanoseconds beside seconds", rows("secs,nsecs,x,y,u", split(1, "09d")), {"time": ["secs", "nsecs"]}),
    File("nanoseconds of a nameless column", rows("a,b,x,y,u", split(1, "d")), {"time": ["a", "b"]}),
    File(
        "microseconds of a nameless column",
        rows("a,b,x,y,u", split(1_000_000, "d")),
        {"time": ["a", "b"]},
        refused="goes to 990 beside whole seconds; expected nanoseconds, or a name",
    ),
    File(
        "nanoseconds that call themselves micro",
        rows("sec,usec,x,y,u", split(1, "d")),
        {"time": ["sec", "usec"]},
        refused="'usec' goes to 990000000 beside whole seconds",
    ),
    File("every line quoted", "".join(f'"{line}"\n' for line in plain().splitlines())),
    File("a line for spreadsheets", "sep=;\n" + plain(delimiter=";")),
    File("padded with zeros", plain().encode() + bytes(4096)),
    File("numbered rows of R", rows('"","t","x","y","u"', lambda *c: f'"{c[0]}",' + ",".join(c))),
    File("a table of markdown", rows("| t | x | y | u |\n|---|---|---|---|", lambda *c: f"| {' | '.join(c)} |")),
    File("a note of two lines", rows("t,note,x,y,u", lambda t, *c: f'{t},"a\nb",' + ",".join(c))),
    File("dates with a zone", rows("t,x,y,u", lambda t, *c: f"2026-11-27T10:20:{float(t):06.3f}+01:00," + ",".join(c))),
    File("dates without marks", rows("t,x,y,u", lambda t, *c: f"20261127T1020{float(t):06.3f}," + ",".join(c))),
    File("minutes", rows("t (min),x,y,u", lambda t, *c: f"{times(t, 1 / 60)}," + ",".join(c))),
    *[File(f"missing is {word}", at(70, word), tolerance=3e-3) for word in ("n.a.", "#REF!", "nan(snan)")],
    *[
        File(f"out of range is {word}", at(70, word), tolerance=3e-3, warned="taken for lost")
        for word in ("1e38", "65535")
    ],
    File("a sensor that says OL", at(70, "OL"), refused="line 72: 'OL' is not a number"),
    File("a foot of means", plain() + "mean,0.3,0.2,0.0\n", refused="line 152: 'mean' is not a number"),
    File("hexadecimal", at(70, "0x94ed6"), refused="line 72: '0x94ed6' is not a number"),
    File("logged text", rows("t,x,y,u", lambda *c: f"t={c[0]},x={c[1]},y={c[2]},u={c[3]}"), refused="is not a number"),
    File(
        "rows from last to first",
        "t,x,y,u\n" + "".join(",".join(r) + "\n" for r in ROWS[::-1]),
        refused="runs backwards",
    ),
]


@pytest.mark.parametrize("file", READ, ids=[file.name for file in READ])
def test_it_gives_right_numbers_or_one_line(file: File, tmp_path: Path) -> None:
    if file.scale != 1.0:  # taken as it is, and doubted
        (tmp_path / "run.csv").write_text(str(file.content))
        with pytest.warns(UserWarning, match=file.warned):
            found = Episodes.from_csv(tmp_path / "run.csv", **{**ASK, **file.ask})
        np.testing.assert_allclose(found.xs[0][:, 0], file.scale * X[:, 0], rtol=1e-9)
        return
    check(file, tmp_path)


@pytest.mark.parametrize("factor", [1e3, 1e-3, 180.0 / np.pi, 25.4])
def test_a_unit_that_changes_in_a_recording_is_said(tmp_path: Path, factor: float) -> None:
    (tmp_path / "run.csv").write_text(seam(factor))
    with pytest.warns(UserWarning, match=re.escape(f"x: readings from 0.75 s on are {factor:.3g} times those before")):
        Episodes.from_csv(tmp_path / "run.csv", **ASK)


@pytest.mark.parametrize("kind", ["steps", "burst", "decay", "growth", "crossing", "offset"])
def test_motion_that_grows_or_jumps_is_no_other_unit(kind: str) -> None:
    rng = np.random.default_rng(3)
    t = DT * np.arange(400)
    made = {
        "steps": np.repeat(rng.choice([0.001, 0.1, 1.0], 20), 20),
        "burst": np.where((t > 1.0) & (t < 1.2), 1.0, 0.01) * np.sin(20.0 * t),
        "decay": np.exp(-6.0 * t),
        "growth": 1e-3 * np.exp(2.5 * t) * np.sin(9.0 * t),
        "crossing": np.sin(5.0 * t) + 1e-3 * rng.standard_normal(400),
        "offset": 0.01 * np.sin(9.0 * t) + np.where(t > 2.0, 1.0, 0.0),
    }[kind]
    other = np.sin(3.0 * t)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        Episodes.from_arrays(t, np.column_stack([made, other]), np.repeat(rng.standard_normal((40, 1)), 10, axis=0))
    assert not any("unit change" in str(w.message) for w in said)


def test_there_are_enough_of_them() -> None:
    assert len(READ) >= 25 and len({file.name for file in READ}) == len(READ) and len(T) == len(U) == N
