"""Cells and columns that change places within a recording: lines with a cell missing, markers taken for each other."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from messy_generator import ASK, TIP, N, T, U, X, plain
from numpy.typing import NDArray

from pisplit import Episodes

Array = NDArray[np.float64]

ALL = [*TIP, "base X", "base Y", "base Z"]


def loaded(x: Array, u: Array = U) -> list[str]:
    """What is said of states (N, 6) and commands (N,)."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        Episodes.from_arrays(T, x, u, state_names=ALL)
    return [str(w.message) for w in said]


def changed(k: int, cells: list[str], delimiter: str = ",", head: str = "t,x,y,u") -> str:
    """The plain table whose row k holds ``cells``."""
    body = plain(head, delimiter).splitlines()
    body[k + 1] = delimiter.join(cells)
    return "\n".join(body) + "\n"


@pytest.mark.parametrize("delimiter", [",", ";", "\t", " "])
@pytest.mark.parametrize("missing", [0, 1, 2])
@pytest.mark.parametrize("padded", [False, True])
def test_a_line_with_a_cell_missing_is_refused(tmp_path: Path, delimiter: str, missing: int, padded: bool) -> None:
    cells = plain(delimiter=delimiter).splitlines()[71].split(delimiter)
    cells = cells[:missing] + cells[missing + 1 :] + [""] * padded
    (tmp_path / "run.csv").write_text(changed(70, cells, delimiter))
    with pytest.raises(ValueError, match=r"line 72 has 3 cells, (the lines beside|others) 4[:,]") as error:
        Episodes.from_csv(tmp_path / "run.csv", **ASK)
    assert "\n" not in str(error.value)


def test_a_line_with_a_cell_too_many_is_refused_where_the_header_has_room(tmp_path: Path) -> None:
    cells = plain().splitlines()[71].split(",")
    (tmp_path / "run.csv").write_text(changed(70, [cells[0], "0.4", *cells[1:]], head="t,x,y,u,note"))
    with pytest.raises(ValueError, match=r"line 72 has 5 cells, the lines beside 4, .* a cell is too many at column 2"):
        Episodes.from_csv(tmp_path / "run.csv", **ASK)


def test_lines_that_end_early_are_read_as_before(tmp_path: Path) -> None:
    """Cells that are missing at the end of a line are missing there."""
    cells = plain().splitlines()[71].split(",")
    for short in (cells[:3], cells[:2]):
        (tmp_path / "run.csv").write_text(changed(70, short))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = Episodes.from_csv(tmp_path / "run.csv", **ASK)
        np.testing.assert_allclose(found.xs[0], X[:, :2], atol=3e-3)


def test_a_row_of_arrays_that_is_moved_is_refused() -> None:
    x, u = X.copy(), U.copy()
    x[70], u[70] = [*X[70, :2], *X[70, 3:], U[70]], np.nan
    with pytest.raises(ValueError, match=r"sample at 0.7 s fits those beside only when moved: its column 3"):
        Episodes.from_arrays(T, x, u)


@pytest.mark.parametrize(
    ("columns", "text"),
    [
        ([1, 0, 2, 3, 4, 5], "from 0.7 s on tip X where tip Y was, tip Y where tip X was"),
        ([1, 2, 0, 3, 4, 5], "from 0.7 s on tip X where tip Y was, tip Y where tip Z was, tip Z where tip X"),
        ([3, 4, 5, 0, 1, 2], "tip X where base X was, tip Y where base Y was.*and 2 more"),
    ],
    ids=["axes", "another order", "markers"],
)
@pytest.mark.parametrize("after", [slice(70, N), slice(70, 71), slice(70, 90)], ids=["to the end", "once", "a while"])
def test_columns_that_change_places_are_said(columns: list[int], text: str, after: slice) -> None:
    x = X.copy()
    x[after] = X[after][:, columns]
    said = loaded(x)
    assert any(re.search(text, line) for line in said), said
    x[69:70] = np.nan  # lost before
    assert after.start + 1 == after.stop or any("changed places" in line for line in loaded(x))


def test_a_sign_that_changes_is_said_and_an_angle_that_wraps_is_not_taken_for_one() -> None:
    x = X.copy()
    x[70:, 2] *= -1.0
    assert any("tip Z goes on as its negative from 0.7 s on: did its sign change" in line for line in loaded(x))
    x[:, 2] = (-3.0 - 0.5 * T + np.pi) % (2.0 * np.pi) - np.pi
    assert not any("negative" in line for line in loaded(x))


def test_smooth_commands_that_change_places_are_said() -> None:
    u = np.column_stack([np.sin(3.0 * T), 0.5 + np.cos(2.0 * T)])
    u[70:] = u[70:, ::-1]
    with pytest.warns(UserWarning, match="from 0.7 s on u1 where u2 was, u2 where u1 was"):
        Episodes.from_arrays(T, X, u)


def test_valves_and_blows_are_left_alone() -> None:
    """Held states that exchange their values, a blow on all markers at once, and commands of either sign."""
    valves = np.where(np.arange(N) // 30 % 2, 1.0, 0.0)
    x = X.copy()
    x[:, 3], x[:, 4] = valves, 1.0 - valves
    x[100:, :3] += [0.3, -0.2, 0.4]
    assert not any("places" in line or "negative" in line for line in loaded(x, 2.0 * valves - 1.0))
