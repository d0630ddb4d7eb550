"""What arrays hold is what the package computes with: nothing is dropped, rounded or guessed on the way in."""

from __future__ import annotations

import datetime
import re
from decimal import Decimal
from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np
import pytest

from pisplit.checks import (
    check_same_step,
    count,
    differing,
    finite_array,
    finite_number,
    positive,
    real_array,
    same_step,
)


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ([1, 2], [1.0, 2.0]),
        (np.array([1, 2], dtype=np.int8), [1.0, 2.0]),
        (np.array([0.5, 2], dtype=np.float32), [0.5, 2.0]),
        (np.array([0.5, 2], dtype=">f8"), [0.5, 2.0]),
        ([True, False], [1.0, 0.0]),
        ([Fraction(1, 2), Decimal("0.25")], [0.5, 0.25]),
        (np.array([1, np.True_, 0.5], dtype=object), [1.0, 1.0, 0.5]),
        (range(3), [0.0, 1.0, 2.0]),
        (np.ma.array([1.0, 2.0]), [1.0, 2.0]),
    ],
)
def test_real_numbers_of_any_kind_are_taken(value: Any, expected: list[float]) -> None:
    found = finite_array(value, "x", (None,))
    assert found.dtype == np.float64 and found.tolist() == expected


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([1.0, 2.0 + 0j], "complex"),
        (["1_00.5"], "texts"),
        ([b"1.5"], "texts"),
        (np.array(["1.5"], dtype=object), "'1.5'"),
        (np.array([1, 2], dtype="M8[s]"), "dates"),
        (np.array([1, 2], dtype="m8[ms]"), "durations"),
        ([datetime.datetime(2026, 1, 1)], "datetime"),
        (np.zeros(2, dtype=[("a", float)]), "records"),
        ([[1.0, 2.0], [3.0]], "rows of one length"),
        (ca.SX.sym("x", 2), "SX"),
        ({"a": 1.0}, "'a'"),
        (np.ma.masked_values([1.0, -999.0], -999.0), "1 masked"),
        ([1.0, None], "1 NaN"),
        ([1.0, np.inf], "1 NaN or infinite"),
    ],
)
def test_what_is_no_real_number_is_refused_in_one_line(value: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        finite_array(value, "x", (None,))
    assert "\n" not in str(error.value) and str(error.value).startswith("x ")


def test_masked_and_absent_entries_are_missing() -> None:
    masked = np.ma.masked_values([1.0, -999.0], -999.0)
    for value in (masked, [1.0, None], [1.0, np.ma.masked]):
        np.testing.assert_array_equal(real_array(value, "x"), [1.0, np.nan])
    np.testing.assert_array_equal(real_array([masked, masked], "x"), [[1.0, np.nan]] * 2)
    assert masked.data[1] == -999.0, "the caller's array is left alone"


def test_tables_of_numbers_are_arrays() -> None:
    pandas = pytest.importorskip("pandas")
    table = pandas.DataFrame({"a": [1, 2], "b": [True, False]})
    np.testing.assert_array_equal(finite_array(table, "x", (None, 2)), [[1, 1], [2, 0]])
    np.testing.assert_array_equal(real_array(pandas.Series([1, None], dtype="Int64"), "x"), [1, np.nan])
    with pytest.raises(ValueError, match="'left'"):
        finite_array(table.assign(b=["left", "right"]), "x", (None, 2))


def test_float64_is_not_copied() -> None:
    x = np.zeros(4)
    assert finite_array(x, "x", (4,)) is x


@pytest.mark.parametrize(
    ("shape", "wanted", "hint"),
    [
        ((11,), (None, 1), r"give \(11, 1\): x\[:, None\]"),
        ((11,), (None, None), r"give \(11, 1\): x\[:, None\]"),
        ((3,), (None, 3), r"give \(1, 3\): x\[None\]"),
        ((2, 5), (5, 2), "its transpose, x.T"),
        ((2, 5), (4, 2), r"expected \(4, 2\)$"),
    ],
)
def test_a_shape_that_one_step_mends_is_told_the_step(
    shape: tuple[int, ...], wanted: tuple[int | None, ...], hint: str
) -> None:
    with pytest.raises(ValueError, match=hint):
        finite_array(np.zeros(shape), "x", wanted)


def test_numbers_are_no_texts_and_no_ticks() -> None:
    for value in ("1_0", b"1", np.timedelta64(5, "s"), datetime.timedelta(seconds=1), np.ma.masked, 1j, None):
        with pytest.raises(ValueError, match="dt"):
            finite_number(value, "dt")
    with pytest.raises(ValueError, match="whole number"):
        count(np.timedelta64(5, "s"), "steps")
    assert finite_number(np.float32(0.5), "dt") == 0.5 and finite_number(Fraction(1, 4), "dt") == 0.25


def test_two_numbers_are_told_apart() -> None:
    assert differing(0.1, 0.2) == ("0.1", "0.2")
    first, second = differing(0.1, 0.1 * (1 + 1e-8))
    assert first == "0.1" and second == "0.100000001"


@pytest.mark.parametrize("step", [1e-6, 0.03, 250.0])
def test_time_steps_are_one_up_to_the_digits_of_a_file(step: float) -> None:
    assert same_step(step, step * (1 + 0.9e-6)) and same_step(step, step * (1 - 0.9e-6))
    assert not same_step(step, step * (1 + 1.1e-6)) and not same_step(step, step * (1 - 1.1e-6))
    with pytest.raises(ValueError, match=r"the file has dt = (.*) s, the model (.*) s; give both") as found:
        check_same_step(step * (1 + 2e-6), step, "the file has", "the model")
    one, other = re.findall(r"([0-9.e+-]+) s[,;]", str(found.value))
    assert one != other and float(other) == step


def test_masks_in_lists_are_missing_too() -> None:
    row = np.ma.masked_greater([1.0, 5.0], 2.0)
    np.testing.assert_array_equal(real_array([[row, [3.0, 4.0]]], "x"), [[[1.0, np.nan], [3.0, 4.0]]])


def test_a_complex_number_is_no_length() -> None:
    with pytest.raises(ValueError, match="length is not a number"):
        positive(np.complex128(1.0 + 2.0j), "length", "m")
