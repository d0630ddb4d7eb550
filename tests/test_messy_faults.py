"""Readings that are none, and files that are no tables of what was asked for: what is kept is right, the rest is said.

The motion is that of ``messy_generator``.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from messy_generator import ASK, DT, File, N, T, U, X, check, lines, optitrack, plain, vicon

from pisplit import Episodes


def faults() -> list[File]:
    def changed(rows: slice, text: Callable[[int, list[str]], str]) -> str:
        body = plain().splitlines()
        for k in range(*rows.indices(N)):
            body[k + 1] = text(k, body[k + 1].split(","))
        return "\n".join(body) + "\n"

    still = [repr(float(v)) for v in X[39, :2]]
    bad = "readings, from 0.4 s on"
    return [
        *[
            File(
                f"missing is {word!r}",
                changed(slice(40, 42), lambda k, c, w=word: f"{c[0]},{w},{w},{c[3]}"),
                tolerance=3e-3,
            )  # type: ignore[misc]
            for word in ("", "nan", "NaN", "NA", "null", "-", "None", "#N/A", "-nan(ind)", "1.#IND", "#DIV/0!")
        ],
        File(
            "zeros of lost tracking",
            changed(slice(40, 42), lambda k, c: f"{c[0]},0.000,0.000,{c[3]}"),
            tolerance=3e-3,
            warned=f"2 of {N} {bad}, at exactly 0",
        ),
        File(
            "long loss",
            changed(slice(40, 60), lambda k, c: f"{c[0]},0,0,{c[3]}"),
            pieces=2,
            warned=f"20 of {N} {bad}, at exactly 0",
        ),
        File(
            "-9999",
            changed(slice(40, 60, 10), lambda k, c: f"{c[0]},-9999,-9999,{c[3]}"),
            tolerance=3e-3,
            warned="at exactly -9999",
        ),
        File(
            "one spike of a logger",
            changed(slice(40, 41), lambda k, c: f"{c[0]},1e30,{c[2]},{c[3]}"),
            tolerance=3e-3,
            warned=r"at exactly 1e\+30",
        ),
        File(
            "stall",
            changed(slice(40, 60), lambda k, c: f"{c[0]},{still[0]},{still[1]},{c[3]}"),
            pieces=2,
            warned=f"20 of {N} {bad}, that repeat",
        ),
        File("gap in the clock", re.sub(r"(?m)^0\.(4\d?|5[0-4]?),.*\n", "", plain()), pieces=2),
        File(
            "commands where they change",
            "t,x,y,u\n" + lines([T, X[:, 0], X[:, 1], [repr(float(u)) if k % 6 == 0 else "" for k, u in enumerate(U)]]),
        ),
        File("cut off in a line", plain()[:-12], tolerance=1e-9),
        File(
            "unplugged for ever", changed(slice(100, N), lambda k, c: f"{c[0]},,,{c[3]}"), warned="33 % of the samples"
        ),
    ]


def refusals() -> list[File]:
    return [
        File("no header, no names", plain(""), refused="has no header line; give names="),
        File("names miscounted", plain(""), {"names": ["t", "x", "y"]}, refused="no line of 3 numbers"),
        File("no such column", plain("t,x,z,u"), refused="has no column 'y'; it has t, x, z, u"),
        File("a name too short", plain("t,x 1,x 2,u"), {"states": ["x"]}, refused="near it are 'x 1', 'x 2', out of 4"),
        File(
            "names with blanks, none of them asked for",
            plain("time [s],tip x [mm],tip y [mm],u [mm]"),
            refused="it has time \\[s\\], tip x \\[mm\\]",
        ),
        File("a name misspelt", plain("t,tip_x,tip_y,u"), {"states": ["Tip_X"]}, refused="near it are 'tip_x'"),
        File("twice the same name", plain("t,x,x,u"), {"states": ["x"]}, refused="several columns 'x'"),
        File(
            "OptiTrack without its upper rows",
            optitrack(False),
            {"time": "Time (Seconds)", "states": ["X", "Y"], "inputs": []},
            refused="several columns 'X'.*give names=",
        ),
        File(
            "OptiTrack, which X",
            optitrack(),
            {"time": "Time", "states": ["X"], "inputs": []},
            refused="several columns 'X'.*name one: 'Rigid Body tip 1 Position X'",
        ),
        File(
            "Vicon, which X",
            vicon(),
            {"time": "Frame", "time_unit": DT, "states": ["X"], "inputs": []},
            refused="name one: 'arm:tip X', 'arm:base X'",
        ),
        File(
            "no clock, no dt",
            "x,y,u\n" + lines([X[:, 0], X[:, 1], U]),
            {"time": None},
            refused="no column of times and no dt",
        ),
        File(
            "unit against the file's",
            plain("t,x [mm],y [mm],u"),
            {"state_units": "m"},
            refused="x is in mm by .*, not in m",
        ),
        File("clock against the file's", plain("t [ms],x,y,u"), {"time_unit": "s"}, refused="in ms by their file"),
        File("unit of nothing", plain(), {"state_units": "furlong"}, refused="no known unit"),
        File("both decimal marks", plain(delimiter=";").replace("0.01;", "0,01;", 1), refused="one decimal mark"),
        File(
            "a thousand or a fraction",
            "t;x;y;u\n" + "".join(f"{k};1,{200 + k};2,{300 + k};1\n" for k in range(N)),
            refused="may be 1.200 or a thousand",
        ),
        File(
            "day or month",
            "t,x,y,u\n"
            + lines([[f"0{1 + k // 75}/02/2026 10:20:{t:06.3f}" for k, t in enumerate(T)], X[:, 0], X[:, 1], U]),
            refused="day or month first",
        ),
        File("text within", plain().replace("\n0.5,", "\nfive,"), refused="'five' is not a number"),
        File("unit in a cell", plain().replace("\n0.5,", "\n0.5 V,"), refused="is not a number"),
        File(
            "a second line of words",
            plain("t,x,y,u\ndouble,double,double,double"),
            refused="take it out, or give names=",
        ),
        File("a clock of whole seconds", re.sub(r"(?m)^(\d)\.\d+,", r"\1,", plain()), refused="too few digits"),
        File(
            "one sensor a row",
            "t,name,x,y,u\n" + lines([np.repeat(T, 2), ["a", "b"] * N, *(np.repeat(v, 2) for v in (*X.T[:2], U))]),
            refused="every row holds another sensor",
        ),
        File("state and input at once", plain(), {"inputs": ["x"]}, refused="'x' is named as a state and as an input"),
        File("header again", plain() + plain(), refused="line 152 repeats the header"),
        File("clock restarts", plain() + plain(""), refused="several runs.*give episode="),
        File(
            "clock runs backwards",
            plain().split("\n")[0] + "\n" + "\n".join(plain("").split("\n")[-2::-1]),
            refused="backwards",
        ),
        File("too many cells", plain().replace("\n0.5,", "\n0.5,7,"), refused="has 5 cells; the header has 4"),
        File("infinite", "t,x,y,u\n0,1,1,1\n1,inf,1,1\n2,1,1,1\n", refused="'inf' is not a number"),
        File("a workbook", b"PK\x03\x04\x14\x00", refused="Excel workbook or another archive; save it as CSV"),
        File("a MATLAB file", b"MATLAB 5.0 MAT-file, Platform", refused="a MATLAB file; read it by Episodes.from_mat"),
        File("a ROS bag", b"#ROSBAG V2.0\n", refused="a ROS bag; export its topics as CSV"),
        File("bytes", bytes(range(256)) * 4, refused="no text|no column"),
        File("empty", "", refused="has no column 't'; it has none"),
        File("header alone", "t,x,y,u\n", refused="a header and no rows"),
        File(
            "wrong encoding told",
            plain("Zeit,Länge,y,u").encode("latin-1"),
            {"encoding": "utf-8"},
            refused="no text in utf-8",
        ),
    ]


FILES = [*faults(), *refusals()]


@pytest.mark.parametrize("file", FILES, ids=[file.name for file in FILES])
def test_a_fault_is_mended_or_said_in_one_line(file: File, tmp_path: Path) -> None:
    check(file, tmp_path)


def test_there_are_enough_of_them() -> None:
    assert len(FILES) >= 40 and len({file.name for file in FILES}) == len(FILES)


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        ({"names": "txyu"}, "names = 'txyu' is one text"),
        ({"screen": None}, "screen = None; expected any of 'zeros', 'stalls'"),
        ({"time_unit": True}, "time_unit = True; expected a unit of time"),
        ({"delimiter": ";;"}, "is no table"),
        ({"path": 5}, "path is a int; expected a file"),
        ({"path": []}, "path is an empty list"),
        ({"decimal": ";"}, r"decimal = ';'; expected '\.' or ','"),
        ({"inputs": [], "commands": "run.csv"}, "inputs names no columns"),
        ({"header": 1}, "unknown argument 'header'"),
    ],
)
def test_wrong_arguments_are_one_line(ask: dict[str, Any], message: str, tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text(plain())
    with pytest.raises(ValueError, match=message) as error:
        Episodes.from_csv(**{"path": tmp_path / "run.csv", **ASK, **ask})
    assert "\n" not in str(error.value)
    with pytest.raises(ValueError, match="is a folder; give a file, or a pattern such as"):
        Episodes.from_csv(tmp_path, **ASK)
