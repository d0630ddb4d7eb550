"""Files as robots and programs write them: each gives the numbers that were recorded.

One motion is written by a generator in every spelling; what comes back is compared with the motion itself.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from messy_generator import ASK, BASE, DT, TIP, File, N, T, U, X, check, lines, optitrack, plain, sections, vicon

from pisplit import Episodes


def made() -> list[File]:
    return [*spellings(), *units_of_all_kinds(), *headers_of_all_kinds(), *trackers()]


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


FILES = made()


@pytest.mark.parametrize("file", FILES, ids=[file.name for file in FILES])
def test_a_messy_file_gives_right_numbers(file: File, tmp_path: Path) -> None:
    check(file, tmp_path)


def test_there_are_enough_of_them() -> None:
    assert len(FILES) >= 60 and len({file.name for file in FILES}) == len(FILES)


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
