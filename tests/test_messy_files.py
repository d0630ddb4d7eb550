"""Files as robots and programs write them: each gives the numbers that were recorded, or one line that says what to do.

One motion is written by a generator in every spelling; what comes back is compared with the motion itself.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pisplit import Episodes

Array = NDArray[np.float64]

N, DT = 150, 0.01
T = DT * np.arange(N)
RNG = np.random.default_rng(5)
U = np.round(np.repeat(RNG.uniform(-1.0, 1.0, N // 6), 6), 6)
#: Two markers in m: tip X, Y, Z, base X, Y, Z, as a tracker sees them, with noise of 0.1 mm.
X = np.column_stack([0.30 + 0.1 * np.sin(3 * T), 0.2 * np.cos(2 * T), 0.5 + 0.05 * np.sin(5 * T)])
X = np.round(np.hstack([X, 0.3 * X + [0.2, 0.15, 0.1]]) + 1e-4 * RNG.standard_normal((N, 6)), 6)
TIP, BASE = ["tip X", "tip Y", "tip Z"], ["base X", "base Y", "base Z"]


def lines(columns: Sequence[Sequence[object]], delimiter: str = ",", decimal: str = ".") -> str:
    """Rows of ``columns``, numbers with their shortest digits."""

    def cell(value: object) -> str:
        return value if isinstance(value, str) else repr(float(value)).replace(".", decimal)  # type: ignore[arg-type]

    return "".join(delimiter.join(map(cell, row)) + "\n" for row in zip(*columns, strict=True))


def plain(header: str = "t,x,y,u", delimiter: str = ",", decimal: str = ".", **scale: float) -> str:
    """A table of time, tip X, tip Y and the command."""
    columns = [T * scale.get("t", 1.0), X[:, 0] * scale.get("x", 1.0), X[:, 1], U * scale.get("u", 1.0)]
    columns = [np.round(column, 14) for column in columns]
    head = f"{header.replace(',', delimiter)}\n" if header else ""
    return head + lines(columns, delimiter, decimal)  # type: ignore[arg-type]


@dataclass(frozen=True)
class File:
    """What is in a file, how it is asked for, and what has to come back: columns of the truth, or one line."""

    name: str
    content: str | bytes
    ask: dict[str, Any] = field(default_factory=dict)
    refused: str = ""
    warned: str = ""
    states: tuple[int, ...] = (0, 1)
    inputs: bool = True
    scale: float = 1.0
    units: tuple[str, ...] | None = None
    pieces: int = 1
    tolerance: float = 2e-6
    inputs_within: float = 1e-6
    dt: float = DT


ASK = {"time": "t", "states": ["x", "y"], "inputs": ["u"]}


def made() -> list[File]:
    return [*spellings(), *units_of_all_kinds(), *headers_of_all_kinds(), *trackers(), *faults(), *refusals()]


def spellings() -> list[File]:
    found = [
        File(f"delimiter {mark!r} decimal {decimal!r}", plain(delimiter=mark, decimal=decimal))
        for mark in (",", ";", "\t", "|", " ", "   ")
        for decimal in (".", ",")
        if mark != decimal and not (mark == "," and decimal == ",")
    ]
    umlaut = {"time": "Zeit", "states": ["Länge", "y"], "inputs": ["Größe"]}
    found += [
        File(f"encoding {code}", plain("Zeit,Länge,y,Größe").encode(code), umlaut)
        for code in ("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "latin-1", "cp1252")
    ]
    found += [
        File("windows line ends", plain().replace("\n", "\r\n")),
        File("old mac line ends", plain().replace("\n", "\r")),
        File("no line end at the end", plain().rstrip("\n")),
        File("blank lines", plain().replace("\n", "\n\n")),
        File("comments before", "# logger 2.1\n# arm 3\n" + plain()),
        File("header in a comment", "# " + plain()),
        File("matlab's comment", "% " + plain()),
        File("comment within", plain().replace("\n", "\n# checked\n", 5)),
        File("trailing delimiter", plain().replace("\n", ",\n")),
        File("quoted", re.sub(r"([^,\n]+)", r'"\1"', plain())),
        File("quoted with decimal comma", re.sub(r"([^,\n]+)", r'"\1"', plain()).replace(".", ","), {}),
        File("blanks around", plain().replace(",", " , ")),
        File("more columns", "t,note,x,y,u\n" + lines([T, ["ok"] * N, X[:, 0], X[:, 1], U])),
        File("exponents", "t,x,y,u\n" + "".join(f"{a:.6E},{b:.9e},{c:.9e},{d:.9e}\n" for a, b, c, d in table())),
        File("unicode minus", plain().replace("-", "\u2212")),
        File("order of columns", "u,y,x,t\n" + lines([U, X[:, 1], X[:, 0], T])),
        File("switches", "t,x,y,u\n" + lines([T, X[:, 0], X[:, 1], [str(u > 0) for u in U]]), inputs=False),
    ]
    return found


def table() -> list[tuple[float, float, float, float]]:
    return list(zip(T.tolist(), X[:, 0].tolist(), X[:, 1].tolist(), U.tolist(), strict=True))


def units_of_all_kinds() -> list[File]:
    def dates(text: Callable[[float], str]) -> str:
        return "t,x,y,u\n" + lines([[text(t) for t in T], X[:, 0], X[:, 1], U])

    found = [
        File(f"time in {unit}", plain(t=factor), {"time_unit": unit})
        for unit, factor in (("ms", 1e3), ("us", 1e6), ("ns", 1e9), ("minute", 1 / 60), ("day", 1 / 86400))
    ]
    found += [
        File(f"length in {unit}", plain(x=1 / factor), {"state_units": [unit, "m"]}, units=("m", "m"))
        for unit, factor in (("mm", 1e-3), ("inch", 0.0254), ("cm", 1e-2))
    ]
    found += [
        File(f"pressure in {unit}", plain(u=1 / factor), {"input_units": unit}, scale=1.0)
        for unit, factor in (("psi", 6894.757293168361), ("MPa", 1e6), ("kPa", 1e3))
    ]
    found += [
        File("units in brackets", plain("t [ms],x [mm],y (m),u [V]", t=1e3, x=1e3), units=("m", "m")),
        File("units in a row", plain("t,x,y,u\nms,mm,m,V", t=1e3, x=1e3), units=("m", "m")),
        File("units in a bracketed row", plain("t,x,y,u\n[s],[mm],[m],[-]", x=1e3), units=("m", "m")),
        File("clock that names its unit", plain("time_ms,x,y,u", t=1e3), {"time": "time_ms"}),
        File(
            "words in brackets that are no units",
            plain("t [min],x (in),y [g],u (min)", t=1 / 60),
            {"states": ["x (in)", "y"], "inputs": ["u"]},
            units=("", ""),
        ),
        File(
            "gravity in a row of units",
            plain("t,x,y,u\ns,m,g,V"),
            refused="not a number.*a second line of names or units: take it out",
        ),
        File(
            "units taken as they are", plain("t,x [mm],y [mm],u"), {"states": ["x [mm]", "y [mm]"], "state_units": ""}
        ),
        File(
            "ISO dates",
            dates(lambda t: f"2026-11-27T23:59:{t + 59.5:09.6f}" if t < 0.5 else f"2026-11-28T00:00:{t - 0.5:09.6f}"),
        ),
        File("dates of MATLAB", dates(lambda t: f"27-Nov-2026 10:20:{t:06.3f}")),
        File("dates with slashes", dates(lambda t: f"11/27/2026 10:20:{t:06.3f}")),
        File("dates of one day with slashes", dates(lambda t: f"11/10/2026 10:20:{t:06.3f}")),
        File("durations of a timetable", dates(lambda t: f"{t:.5g} sec")),
        File("hours, minutes, seconds", dates(lambda t: f"00:00:{t:06.3f}")),
        File(
            "midnight within the hours",
            dates(lambda t: f"23:59:{t + 59.5:06.3f}" if t < 0.495 else f"00:00:{t - 0.5:06.3f}"),
        ),
        File("decimal comma in hours", dates(lambda t: f"00:00:{t:06.3f}").replace(",", ";").replace(".", ",")),
    ]
    return found


def headers_of_all_kinds() -> list[File]:
    bare = plain("")
    return [
        File("no header", bare, {"names": ["t", "x", "y", "u"]}),
        File("no header behind a preamble", "run 7\nrate: 100 Hz\n\n" + bare, {"names": ["t", "x", "y", "u"]}),
        File("numbered by pandas", "0,1,2,3\n" + bare, {"names": ["t", "x", "y", "u"]}),
        File("numbered with an index", ",0,1,2\n" + bare, {"names": ["t", "x", "y", "u"]}),
        File("names instead of the file's", plain("a,b,b,b"), {"names": ["t", "x", "y", "u"]}),
        File("no clock", "x,y,u\n" + lines([X[:, 0], X[:, 1], U]), {"time": None, "dt": DT}),
        File(
            "frames counted",
            "frame,x,y,u\n" + lines([range(7, N + 7), X[:, 0], X[:, 1], U]),
            {"time": "frame", "time_unit": DT},
        ),
        File(
            "two rows of names",
            "time,tip,tip,command\n,X,Y,\n".replace(",X,Y,", "t,X,Y,u") + lines([T, X[:, 0], X[:, 1], U]),
            {"states": ["tip X", "tip Y"]},
        ),
        File(
            "an episode column",
            "t,x,y,u,run\n" + lines([[*T[:75], *T[:75]], X[:, 0], X[:, 1], U, ["a"] * 75 + ["b"] * 75]),
            {"episode": "run"},
            pieces=2,
        ),
        File(
            "an episode column without a clock",
            "x,y,u,run\n" + lines([X[:, 0], X[:, 1], U, ["1"] * 75 + ["2"] * 75]),
            {"time": None, "dt": DT, "episode": "run"},
            pieces=2,
        ),
    ]


def vicon() -> str:
    head = "Trajectories\n100\n,,arm:tip,,,arm:base,,,\nFrame,Sub Frame,X,Y,Z,X,Y,Z\n,,mm,mm,mm,mm,mm,mm\n"
    return head + "".join(f"{k + 1},0,{','.join(f'{1e3 * v:.3f}' for v in X[k])}\n" for k in range(N))


def sections(first: bool) -> str:
    """Vicon's file with the forces of a plate before the markers, or angles after them, each with its own head."""
    rows = "".join(f"{k + 1},0,1.5,{k},3\n" for k in range(250))
    other = "{0}\n1000\n,,{1},,,\nFrame,Sub Frame,X,Y,Z\n,,{2},{2},{2}\n" + rows
    if first:
        return other.format("Devices", "plate", "N") + "\n" + vicon()
    return vicon() + "\n" + other.format("Model Outputs", "angle", "deg")


def optitrack(header: bool = True) -> str:
    words = ["Rigid Body"] * 3 + ["Marker"] * 3
    head = (
        "Format Version,1.23,Take Name,run 1,Capture Frame Rate,100.0,Length Units,Millimeters\n\n"
        f",Type,{','.join(words)}\n,Name,tip,tip,tip,base,base,base\n,ID,1,1,1,2:8,2:8,2:8\n"
        f",,{','.join(['Position'] * 6)}\nFrame,Time (Seconds),X,Y,Z,X,Y,Z\n"
    )
    head = head if header else "Frame,Time (Seconds),X,Y,Z,X,Y,Z\n"
    return head + "".join(f"{k},{T[k]:.6f},{','.join(f'{1e3 * v:.3f}' for v in X[k])}\n" for k in range(N))


def qualisys(header: bool = True) -> str:
    head = f"NO_OF_FRAMES\t{N}\nNO_OF_MARKERS\t2\nFREQUENCY\t100\nDATA_INCLUDED\t3D\nMARKER_NAMES\ttip\tbase\n"
    if header:
        head += "Frame\tTime\t" + "\t".join(TIP + BASE) + "\n"
    front = "{k}\t{t:.5f}\t" if header else ""
    return head + "".join(
        front.format(k=k + 1, t=T[k]) + "\t".join(f"{1e3 * v:.3f}" for v in X[k]) + "\n" for k in range(N)
    )


ROS = 1_790_000_000_123_456_789


def trackers() -> list[File]:
    six = {"states": TIP + BASE, "inputs": []}
    all_six: dict[str, Any] = {"states": tuple(range(6)), "inputs": False, "units": ("m",) * 6}
    stamps = [str(ROS + 10_000_000 * k) for k in range(N)]
    later = [str(ROS % 10**9 + 10_000_000 * k) for k in range(N)]
    whole = [str(ROS // 10**9 + int(v) // 10**9) for v in later]
    rest = [str(int(v) % 10**9) for v in later]
    field_ = ["field.x", "field.y"]
    return [
        File("Vicon", vicon(), {**six, "time": "Frame", "time_unit": DT}, **all_six),
        File(
            "Vicon behind force plates",
            sections(True),
            {**six, "time": "Frame", "time_unit": DT},
            **all_six,
        ),
        File(
            "Vicon before model outputs",
            sections(False),
            {**six, "time": "Frame", "time_unit": DT},
            warned="another table begins at line 157; what follows is left out",
            **all_six,
        ),
        File("Vicon, rate told", vicon(), {**six, "time": None, "dt": DT}, **all_six),
        File("OptiTrack", optitrack(), {**six, "time": "Time"}, **all_six),
        File(
            "OptiTrack, names in full",
            optitrack(),
            {
                **six,
                "time": "Time (Seconds)",
                "states": [f"{'Rigid Body tip' if n < 3 else 'Marker base'} Position {'XYZ'[n % 3]}" for n in range(6)],
            },
            **all_six,
        ),
        File("Qualisys", qualisys(), {**six, "time": "Time", "state_units": "mm"}, **all_six),
        File(
            "Qualisys without names",
            qualisys(False),
            {**six, "time": None, "dt": DT, "names": TIP + BASE, "state_units": "mm"},
            **all_six,
        ),
        File(
            "ROS topic",
            "%time,field.header.seq,field.x,field.y,field.u\n" + lines([stamps, range(N), X[:, 0], X[:, 1], U]),
            {"time": "%time", "time_unit": "ns", "states": field_, "inputs": ["field.u"]},
        ),
        File(
            "ROS 2 stamps",
            "sec,nanosec,x,y,u\n" + lines([whole, rest, X[:, 0], X[:, 1], U]),
            {"time": ["sec", "nanosec"]},
        ),
        File(
            "PlotJuggler",
            "__time,/arm/tip/x,/arm/tip/y,/arm/u\n"
            + lines([[f"{ROS // 10**9 + t:.6f}" for t in T], X[:, 0], X[:, 1], U]),
            {"time": "__time", "states": ["/arm/tip/x", "/arm/tip/y"], "inputs": ["/arm/u"]},
            inputs_within=3e-4,  # 0.24 us of a clock since 1970 in a float, of 10 ms
        ),
        File(
            "MATLAB timetable",
            "Time,x,y,u\n" + lines([[f"{t:.4g} sec" for t in T], X[:, 0], X[:, 1], U]),
            {"time": "Time"},
        ),
    ]


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


FILES = made()


@pytest.mark.parametrize("file", FILES, ids=[file.name for file in FILES])
def test_a_messy_file_gives_right_numbers_or_one_line(file: File, tmp_path: Path) -> None:
    check(file, tmp_path)


def check(file: File, tmp_path: Path) -> None:
    """What comes back is the motion, or one line; what is said is what has to be."""
    path = tmp_path / "run.csv"
    path.write_bytes(file.content if isinstance(file.content, bytes) else file.content.encode())
    ask = {**ASK, **file.ask}
    if file.refused:
        with pytest.raises((ValueError, FileNotFoundError), match=file.refused) as error:
            Episodes.from_csv(path, **ask)
        assert "\n" not in str(error.value)
        return
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = Episodes.from_csv(path, **ask)
    texts = [str(w.message) for w in said]
    assert any(re.search(file.warned, text) for text in texts) if file.warned else not texts, texts
    assert len(found) == file.pieces and found.dt == pytest.approx(file.dt, rel=2e-6)
    truth = X[:, file.states]
    at = 0
    for x, u in zip(found.xs, found.us, strict=True):
        at = at + int(np.argmin(np.abs(truth[at:] - x[0]).sum(axis=1)))
        np.testing.assert_allclose(x, truth[at : at + len(x)], atol=file.tolerance)
        if file.inputs:
            np.testing.assert_allclose(u[:, 0], U[at : at + len(u)], atol=file.inputs_within)
        at += len(x)
    assert at >= 0.6 * N
    if file.units is not None:
        assert found.units == file.units


def test_there_are_enough_of_them() -> None:
    assert len(FILES) >= 100 and len({file.name for file in FILES}) == len(FILES)


def test_several_files_are_one_recording_that_knows_where_it_is_from(tmp_path: Path) -> None:
    for k, cut in ((2, slice(0, 50)), (10, slice(50, 150))):
        rows = lines([T[cut], 1e3 * X[cut, 0] if k == 2 else X[cut, 0], X[cut, 1], U[cut]])
        (tmp_path / f"run{k}.csv").write_text(f"t,x [{'mm' if k == 2 else 'm'}],y,u\n" + rows)
    found = Episodes.from_csv(str(tmp_path / "run*.csv"), **ASK, state_names=["x", "y"])
    assert found.provenance is not None and found.provenance["runs"] == ["run2.csv", "run10.csv"]
    assert found.units == ("m", "") and [len(x) for x in found.xs] == [50, 100]
    np.testing.assert_allclose(found.stacked_states(), X[:, :2], atol=1e-9)
    again = Episodes.from_csv([tmp_path / "run2.csv", tmp_path / "run10.csv"], **ASK)
    np.testing.assert_array_equal(again.stacked_states(), found.stacked_states())
    with pytest.raises(FileNotFoundError, match="fits no file"):
        Episodes.from_csv(str(tmp_path / "walk*.csv"), **ASK)
    with pytest.raises(ValueError, match="named twice"):
        Episodes.from_csv([tmp_path / "run2.csv", str(tmp_path / "run*.csv")], **ASK)
    (tmp_path / "run3.csv").write_text("t,x,y,u\n" + lines([T, X[:, 0], X[:, 1], U]))
    with pytest.raises(ValueError, match="has a unit in one file and none in another; give state_units="):
        Episodes.from_csv(str(tmp_path / "run*.csv"), **ASK)


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
