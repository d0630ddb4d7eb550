"""Columns are matched by name: the order in which a recorder wrote them, and the unit it used, change no number."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pisplit import Episodes
from pisplit.data import column_order, unit_factors
from pisplit.models import systems

RNG = np.random.default_rng(0)


def arm() -> Episodes:
    return Episodes(
        [RNG.normal(size=(t + 1, 3)) for t in (4, 6)],
        [RNG.normal(size=(t, 2)) for t in (4, 6)],
        dt=0.1,
        state_names=("x", "y", "bend"),
        input_names=("left", "right"),
        quantities=("p", "p", "w"),
        units=("m", "m", "1/m"),
        input_units=("mm", "N"),
        outputs={"tip": (0, 1), "bend": (2,)},
        extra={"load": [np.zeros(4), np.ones(6)]},
        provenance={"seed": 3},
    )


@settings(max_examples=30, deadline=None)
@given(st.permutations(range(3)), st.permutations(range(2)))
def test_any_order_of_columns_is_put_back(states: list[int], inputs: list[int]) -> None:
    d = arm()
    names, commands = [d.state_names[i] for i in states], [d.input_names[i] for i in inputs]  # type: ignore[index]
    mixed = d.arranged(names, commands)
    assert mixed.state_names == tuple(names) and mixed.input_names == tuple(commands)
    assert mixed.units == tuple(d.units[i] for i in states)  # type: ignore[index]
    assert mixed.input_units == tuple(d.input_units[i] for i in inputs)  # type: ignore[index]
    assert mixed.quantities == tuple(d.quantities[i] for i in states)  # type: ignore[index]
    for x, y in zip(d.xs, mixed.xs, strict=True):
        np.testing.assert_array_equal(x[:, states], y)
    for group, columns in mixed.outputs.items():  # type: ignore[union-attr]
        assert [names[i] for i in columns] == [d.state_names[i] for i in d.outputs[group]]  # type: ignore[index]
    back = mixed.arranged(d.state_names, d.input_names)
    for a, b in zip([*d.xs, *d.us, *d.extra["load"]], [*back.xs, *back.us, *back.extra["load"]], strict=True):  # type: ignore[index]
        np.testing.assert_array_equal(a, b)
    assert (back.outputs, back.units, back.provenance) == (d.outputs, d.units, d.provenance)


def test_what_is_in_order_is_the_same_object() -> None:
    d = arm()
    assert d.arranged() is d
    assert d.arranged(d.state_names, d.input_names, d.units, d.input_units) is d


def test_units_are_converted_by_known_factors_alone() -> None:
    d = arm()
    found = d.arranged(("y", "x", "bend"), d.input_names, ("mm", "m", "1/m"), ("m", "N"))
    np.testing.assert_allclose(found.xs[0], d.xs[0][:, [1, 0, 2]] * [1e3, 1.0, 1.0])
    np.testing.assert_allclose(found.us[1], d.us[1] * [1e-3, 1.0])
    assert found.units == ("mm", "m", "1/m") and found.input_units == ("m", "N")
    np.testing.assert_array_equal(unit_factors(("deg", "", "cm/ms"), ("rad", "m", "m/s"), "abc"), [np.pi / 180, 1, 10])
    with pytest.raises(ValueError, match="x is in m in the data, in rad in the model"):
        d.arranged(units=("rad", "m", "1/m"))
    with pytest.raises(ValueError, match="bend is in 1/m in the data, in 1/ft in the plant"):
        d.arranged(units=("m", "m", "1/ft"), owner="the plant")


def test_columns_without_names_are_matched_by_position() -> None:
    plain = Episodes([np.zeros((3, 2))], [np.zeros((2, 1))], 0.1)
    assert plain.arranged(("angle", "rate"), ("pull",)) is plain
    np.testing.assert_array_equal(column_order(("a", "b"), ("x1", "x2"), "states"), [0, 1])
    np.testing.assert_array_equal(column_order(("x1", "x2"), ("x2", "x1"), "states"), [1, 0])
    np.testing.assert_array_equal(column_order(None, ("u1",), "inputs"), [0])
    assert len(column_order((), (), "inputs")) == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((("x", "y"), None), "3 states, the model 2"),
        ((("x", "y", "twist"), None), "no states named twist of the model, but bend"),
        ((None, ("left", "top")), "no inputs named top of the model, but right"),
    ],
)
def test_other_columns_are_refused_in_one_line(arguments: tuple, message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        arm().arranged(*arguments)
    assert "\n" not in str(error.value)


def test_units_travel_with_the_columns(tmp_path: Path) -> None:
    arm().save(tmp_path / "d.h5")
    for d in (arm()[1], arm()[:1], arm().subset([1, 0]), Episodes.load(tmp_path / "d.h5")):
        assert d.units == ("m", "m", "1/m") and d.input_units == ("mm", "N")
    pendulum = systems.two_link_arm()
    made = Episodes.from_system(pendulum, np.zeros((1, 4)), [np.zeros((3, 2))], dt=0.01)
    assert made.units == ("rad", "rad", "rad/s", "rad/s") and made.input_units == ("N m", "N m")
    recorded = Episodes.from_arrays([0, 1, 2], np.zeros(3), np.zeros(3), state_units="mm", input_units="kPa")
    assert recorded.units == ("m",) and recorded.input_units == ("Pa",)
