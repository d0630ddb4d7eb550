"""More files as spreadsheets, trackers and drives write them: right numbers, or one line that says what to do."""

from __future__ import annotations

import re
import warnings
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from messy_generator import DT, File, N, T, U, X, check, lines, plain
from numpy.typing import NDArray

from pisplit import Episodes

Array = NDArray[np.float64]

START = datetime(2026, 11, 27, 23, 59, 59, 500000)
NOT_A_NUMBER = "is not a number"


def grouped(mark: str, decimal: str) -> str:
    """x in tenths of mm, with marks of thousands, as spreadsheets write it."""
    rows = []
    for t, x, y, u in zip(T, X[:, 0], X[:, 1], U, strict=True):
        cells = [f"{t:.2f}", f"{1e4 * x:,.3f}".replace(",", "!"), f"{y:.6f}", f"{u:.6f}"]
        rows.append(";".join(cell.replace(".", decimal).replace("!", mark) for cell in cells))
    return "t;x;y;u\n" + "\n".join(rows) + "\n"


def moments(kind: str) -> str:
    """A clock that passes midnight, in words of ``kind``."""

    def text(t: float) -> str:
        now = START + timedelta(seconds=round(float(t), 6))
        return (now.strftime(kind)).replace("MILLI", f"{now.microsecond // 1000:03d}")

    return "t;x;y;u\n" + lines([[text(t) for t in T], X[:, 0], X[:, 1], U], ";")


def with_cell(word: str) -> str:
    """One cell of x is a ``word``."""
    return re.sub(r"(?m)^0\.4,[^,]+,", f"0.4,{word},", plain())


def spreadsheets() -> list[Any]:
    return [
        File("separator told to a spreadsheet", "\ufeffsep=;\n" + plain(delimiter=";", decimal=",")),
        File("unicode text of a spreadsheet", plain(delimiter="\t").encode("utf-16")),
        File("hours of twelve, past midnight", moments("%I:%M:%S.MILLI %p")),
        File("hours of 24, past midnight", moments("%H:%M:%S.MILLI")),
        File("German dates with a comma", moments("%d.%m.%Y %H:%M:%S,MILLI")),
        File("dates with a zone", moments("%Y-%m-%dT%H:%M:%S.MILLI+01:00")),
        File(
            "days of a spreadsheet",
            "t,x,y,u\n" + lines([[f"{46353.5 + t / 86400:.12f}" for t in T], X[:, 0], X[:, 1], U]),
            {"time_unit": "day", "dt": DT},
            tolerance=2e-3,
            inputs_within=2e-2,  # 12 digits of a day are a tenth of a millisecond
        ),
        File(
            "names that hold the delimiter",
            "t;x; mm;y; m;u\n" + plain("", ";"),
            refused="header of 6 cells and rows of",
        ),
        File("a line of means at the end", plain() + "mean,0.3,0.1,0\n", refused=f"line 152: 'mean' {NOT_A_NUMBER}"),
        File(
            "percent",
            "t,x,y,u\n" + lines([T, X[:, 0], X[:, 1], [f"{50 + 40 * u:.3f}%" for u in U]]),
            refused="%' is not",
        ),
    ]


def drives() -> list[Any]:
    words = ("NaN", "", "NULL", "#N/A", "--", "nan", "None", "N/A", "-NaN", "missing")
    body = plain().splitlines()
    for i, word in enumerate(words):
        cells = body[10 + 12 * i].split(",")
        body[10 + 12 * i] = ",".join([cells[0], word, words[(i + 3) % len(words)], cells[3]])
    twice = plain().splitlines()
    twice.insert(41, twice[40])
    epoch = [str(1_790_000_000_123 + k) for k in range(N)]
    reset = [[*T[:75], *T[:75]], X[:, 0], X[:, 1], U, [0.0] * 75 + [1.0] * 75]
    return [
        File("words for nothing, mixed", "\n".join(body) + "\n", tolerance=3e-3),
        File("one row twice", "\n".join(twice) + "\n", refused="1 repeated times; keep one sample of each"),
        File(
            "every row twice",
            "t,x,y,u\n" + lines([np.repeat(v, 2) for v in (T, X[:, 0], X[:, 1], U)]),
            refused="every row holds another sensor",
        ),
        File("numbers of runs as fractions", "t,x,y,u,run\n" + lines(reset), {"episode": "run"}, pieces=2),
        File(
            "milliseconds since 1970 without a unit",
            "t,x,y,u\n" + lines([epoch, X[:, 0], X[:, 1], U]),
            refused="too many for seconds since 1970; give time_unit",
        ),
        File(
            "milliseconds since 1970",
            "t,x,y,u\n" + lines([epoch, X[:, 0], X[:, 1], U]),
            {"time_unit": "ms"},
            dt=1e-3,
            inputs_within=3e-4,  # 0.24 us of a clock since 1970 in a float, of 1 ms
        ),
        File("units in names", plain("t_s,x_m,y_m,u"), {"time": "t_s", "states": ["x_m", "y_m"]}, units=("", "")),
        File("a row of units with a hole", plain("t,x,y,u\ns,mm,,m/s^2", x=1e3), units=("m", "")),
        File("hexadecimal", "t,x,y,u\n" + lines([T, [hex(int(1e6 * x)) for x in X[:, 0]], X[:, 1], U]), refused="'0x"),
        *[
            File(f"a cell {word!r}", with_cell(word), refused=NOT_A_NUMBER)
            for word in (".", "?", "12.3 mm", "1e", "O.5")
        ],
        File(
            "frames behind seconds",
            "t,x,y,u\n" + lines([[f"00:00:{k // 25:02d}:{k % 25:02d}" for k in range(N)], X[:, 0], X[:, 1], U]),
            refused=NOT_A_NUMBER,
        ),
    ]


FILES = [*spreadsheets(), *drives()]


@pytest.mark.parametrize("file", FILES, ids=[file.name for file in FILES])
def test_it_gives_right_numbers_or_one_line(file: Any, tmp_path: Path) -> None:
    check(file, tmp_path)


def read(path: Path, head: str, columns: list[Any], states: list[str]) -> tuple[Episodes, list[str]]:
    path.write_text(head + "\n" + lines(columns))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = Episodes.from_csv(path, "t", states, ["u"])
    return found, [str(w.message) for w in said]


@pytest.mark.parametrize(("mark", "decimal"), [(".", ","), ("'", "."), ("\u2019", "."), ("\u202f", ","), (",", ".")])
def test_marks_of_thousands_with_a_decimal_mark_behind_are_read(tmp_path: Path, mark: str, decimal: str) -> None:
    (tmp_path / "run.csv").write_text(grouped(mark, decimal))
    found = Episodes.from_csv(tmp_path / "run.csv", "t", ["x", "y"], ["u"])
    np.testing.assert_allclose(found.xs[0], X[:, :2] * [1e4, 1.0], atol=1e-3)
    np.testing.assert_allclose(found.us[0][:, 0], U[:-1], atol=1e-6)


ANGLE = 0.8 * T
QUATERNION = np.column_stack([np.cos(ANGLE / 2), 0.6 * np.sin(ANGLE / 2), 0.8 * np.sin(ANGLE / 2), 0.0 * ANGLE])
NAMES = ["qw", "qx", "qy", "qz"]


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [1, 2, 3, 0]], ids=["w first", "x first"])
def test_quaternions_are_found_by_name_and_their_turns_are_said(tmp_path: Path, order: list[int]) -> None:
    head = ",".join(["t", *(NAMES[i] for i in order), "u"])
    found, said = read(tmp_path / "q.csv", head, [T, *QUATERNION[:, order].T, U], NAMES)
    assert not said
    np.testing.assert_allclose(found.xs[0], QUATERNION, atol=1e-12)
    turned = QUATERNION * np.where(np.arange(N) // 20 % 2, -1.0, 1.0)[:, None]
    _, said = read(tmp_path / "q.csv", head, [T, *turned[:, order].T, U], NAMES)
    assert len(said) == 1 and "qw, qx, qy, qz turn to their negatives, 7 times, first at 0.2 s" in said[0]


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("yaw", (170.0 + 60.0 * T + 180.0) % 360.0 - 180.0),
        ("yaw", (-3.0 - 0.5 * T + np.pi) % (2.0 * np.pi) - np.pi),
        ("n", np.round(65000.0 + 9000.0 * T) % 65536),
        ("phase", (40.0 * T) % 10.0),  # a period of its own, seen several times
    ],
)
def test_angles_and_counters_that_wrap_are_said(tmp_path: Path, name: str, values: Array) -> None:
    _, said = read(tmp_path / "w.csv", f"t,{name},u", [T, values, U], [name])
    assert len(said) == 1 and re.search(rf"{name} jumps from .* wraps\? unwrap it", said[0])


@pytest.mark.parametrize(
    "values",
    [
        np.where(np.arange(N) // 30 % 2, 1.0, 0.0) + 0.01 * np.sin(9.0 * T),  # a valve
        np.where(T > 0.7, 5.0, 0.0) + np.sin(3.0 * T),  # a push
        np.round(1e6 * X[:, 0]),  # counts that do not wrap
        np.cos(4.0 * T),
    ],
)
def test_what_jumps_for_other_reasons_is_not_taken_for_a_wrap(tmp_path: Path, values: Array) -> None:
    _, said = read(tmp_path / "w.csv", "t,x,u", [T, values, U], ["x"])
    assert not any("wraps" in text for text in said)


def test_clocks_that_are_too_fast_are_doubted(tmp_path: Path) -> None:
    _, said = read(tmp_path / "d.csv", "t,x,u", [[f"{46353.5 + t / 86400:.12f}" for t in T], X[:, 0], U], ["x"])
    assert len(said) == 1 and "s apart: is the clock in another unit? give time_unit, 'day'" in said[0]
