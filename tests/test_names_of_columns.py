"""A model meets data: columns are found by name, in any order and known unit, or refused in one line."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pisplit import (
    Dictionary,
    Episodes,
    LinearEDMDc,
    PhaseSamples,
    StreamingEDMDc,
    compare,
    horizon_errors,
    learning_curve,
)
from pisplit import observables as ob
from pisplit.lifted.formats import to_control
from pisplit.models import rod

A, B = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[0.0, 0.1], [0.5, -0.3]])


def recorded(**more: Any) -> Episodes:
    rng, xs, us = np.random.default_rng(0), [], []
    for _ in range(3):
        x, u = np.zeros((41, 2)), rng.normal(size=(40, 2))
        for k in range(40):
            x[k + 1] = A @ x[k] + B @ u[k]
        xs.append(x)
        us.append(u)
    named = {
        "state_names": ["angle", "rate"],
        "input_names": ["left", "right"],
        "units": ["rad", "rad/s"],
        "input_units": ["V", "V"],
        "outputs": {"tip": (1,)},
    }
    return Episodes(xs, us, 0.1, **(named | more))


def turned(data: Episodes) -> Episodes:
    """The same runs with states and inputs in the opposite order."""
    return Episodes(
        [x[:, ::-1] for x in data.xs],
        [u[:, ::-1] for u in data.us],
        data.dt,
        state_names=tuple(data.state_names or ())[::-1],
        input_names=tuple(data.input_names or ())[::-1],
        units=tuple(data.units or ())[::-1],
        input_units=tuple(data.input_units or ())[::-1],
        outputs={"tip": (0,)},
    )


def theta() -> Dictionary:
    return Dictionary(ob.Identity(), n_states=2, n_inputs=2)


@pytest.fixture(scope="module")
def fitted() -> LinearEDMDc:
    return LinearEDMDc(theta()).fit(recorded())


def test_columns_in_another_order_and_unit_are_the_same_data(fitted: LinearEDMDc) -> None:
    same = turned(recorded())
    degrees = replace(same, xs=[np.rad2deg(x) for x in same.xs], units=["deg/s", "deg"])
    for data in (same, degrees):
        for states in (None, "tip", ["angle"]):
            assert fitted.score(data, states).mean < 1e-24
            assert horizon_errors(fitted, data, [1, 10], states).normalised.max() < 1e-12
        assert compare({"estimator": fitted, "model": fitted.lifted}, data).errors["model"].mean < 1e-24
        curve = learning_curve({"a": LinearEDMDc(theta())}, recorded(), data, [40], [0])
        assert curve.errors["a"].max() < 1e-20


def test_data_may_stream_in_with_other_orders_and_units() -> None:
    data = recorded()
    truth = StreamingEDMDc(theta()).update(data).update(data).lifted
    degrees = replace(data, xs=[np.rad2deg(x) for x in data.xs], units=["deg", "deg/s"])
    for again in (turned(data), degrees):
        found = StreamingEDMDc(theta()).update(data).update(again).lifted
        np.testing.assert_allclose(found.A, truth.A, atol=1e-12)
        assert found.state_names == ("angle", "rate") and found.outputs == {"tip": (1,)}
        assert found.units == ("rad", "rad/s") and found.input_units == ("V", "V")
    with pytest.raises(ValueError, match=r"no states named rate of the episodes before, but speed"):
        StreamingEDMDc(theta()).update(data).update(recorded(state_names=["angle", "speed"]))


@pytest.mark.parametrize(
    ("other", "message"),
    [
        ({"state_names": ["angle", "speed"]}, "no states named rate of the model, but speed"),
        ({"input_names": ["left", "up"]}, "no inputs named right of the model, but up"),
        ({"units": ["m", "rad/s"]}, "angle is in m in the data, in rad in the model"),
        ({"input_units": ["V", "A"]}, "right is in A in the data, in V in the model"),
    ],
)
def test_other_data_are_refused(fitted: LinearEDMDc, other: dict[str, Any], message: str) -> None:
    for question in (fitted.score, lambda e: horizon_errors(fitted, e, [1]), lambda e: compare({"a": fitted}, e)):
        with pytest.raises(ValueError, match=message) as error:
            question(recorded(**other))
        assert "\n" not in str(error.value)


def test_an_output_means_the_same_states_on_both_sides(fitted: LinearEDMDc) -> None:
    other = recorded(outputs={"tip": (0,)})
    with pytest.raises(ValueError, match=r"'tip' are the states \['angle'\] in the data, \['rate'\] in the model"):
        fitted.score(other, "tip")
    assert fitted.score(other, ["rate"]).mean < 1e-24


def test_data_without_names_are_matched_by_position(fitted: LinearEDMDc) -> None:
    bare = Episodes(recorded().xs, recorded().us, 0.1)
    assert fitted.score(bare).mean < 1e-24


def test_errors_say_their_units(fitted: LinearEDMDc) -> None:
    assert fitted.score(recorded(), ["angle"]).unit == "rad^2" and "rad^2" in str(fitted.score(recorded(), ["angle"]))
    assert fitted.score(recorded(), ["rate"]).unit == "(rad/s)^2"
    assert fitted.score(recorded()).unit == ""  # a sum of both has none
    assert "rad/s" in str(horizon_errors(fitted, recorded(), [2], ["rate"]))
    assert "squared errors in rad^2" in str(compare({"a": fitted}, recorded(), ["angle"]))


def test_labels_in_python_control_differ_and_hold_units() -> None:
    pytest.importorskip("control")
    hinges = Dictionary(ob.Identity(), ob.Hinge([[1.0, 1.0], [1.0, -1.0]]), n_states=2, n_inputs=2)
    system = to_control(LinearEDMDc(hinges, alpha=1e-6).fit(recorded()).lifted)
    assert len(set(system.state_labels)) == system.nstates == 4
    assert system.output_labels == ["angle_rad", "rate_rad_s"] and system.input_labels == ["left_V", "right_V"]


def test_inputs_alone_are_converted() -> None:
    """Nobody wants units of the states: they keep theirs."""
    d1 = Episodes([np.ones((3, 1))], [np.ones((2, 1))], 0.1, units=["m"], input_units=["mm"])
    wanted = d1.arranged(input_units=["m"])
    assert (wanted.units, wanted.input_units) == (("m",), ("m",)) and wanted.us[0][0, 0] == 1e-3


def test_rows_and_tables_that_name_their_columns_are_matched_by_name(fitted: LinearEDMDc) -> None:
    pd = pytest.importorskip("pandas")
    data = recorded()
    x, u = data.xs[0][0], data.us[0]
    state = pd.Series(x, index=data.state_names)
    inputs = pd.DataFrame(u, columns=list(data.input_names or ()))
    exact = fitted.predict(x, u)
    assert np.array_equal(fitted.predict(state[::-1], inputs[inputs.columns[::-1]]), exact)
    assert np.array_equal(fitted.lifted.lift(state[::-1]), fitted.lifted.lift(x))
    with pytest.raises(ValueError, match="the table has no states named"):
        fitted.predict(state.rename({state.index[0]: "elsewhere"}), u)
    with pytest.raises(ValueError, match="the table has no inputs named"):
        fitted.predict(x, inputs.rename(columns={inputs.columns[0]: "elsewhere"}))


def test_inputs_of_a_scene_are_matched_by_name() -> None:
    pd = pytest.importorskip("pandas")
    scene = rod.Scene(
        rod.Rod(length=0.3, section=rod.Circle(1e-3), material=rod.Elastic(1e9, 4e8, 1e3)),
        rod.TipWrench(force=rod.Input("f", 3)),
        nodes=4,
    )
    force = pd.Series([1e-2, 0.0, 2e-2], index=scene.input_names)
    assert np.array_equal(scene.statics().solve(force[::-1]).tip, scene.statics().solve(force.to_numpy()).tip)
    with pytest.raises(ValueError, match="named f"):
        scene.statics().solve(force.rename({"f[0]": "g"}))


def test_phase_samples_take_names_from_tables() -> None:
    pd = pytest.importorskip("pandas")
    x = pd.DataFrame([[1.0, 2.0], [3.0, 4.0]], columns=["angle", "rate"])
    samples = PhaseSamples(x=x, u=np.zeros((2, 1)), xdot=np.ones((2, 2)))
    assert samples.state_names == ("angle", "rate")
    with pytest.raises(ValueError, match="give the order"):
        PhaseSamples(x=x, u=np.zeros((2, 1)), xdot=np.ones((2, 2)), state_names=("rate", "angle"))
