"""Lag, play and rate limit between command and tendon: closed forms, fine integration, properties of play."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pisplit import Actuator
from pisplit.data import ActuatorState

DT = 0.03
RNG = np.random.default_rng(0)
COMMANDS = np.cumsum(RNG.standard_normal((40, 3)), axis=0)
PATHS = st.lists(st.floats(-5, 5), min_size=1, max_size=20)


def finely(actuator: Actuator, commands: np.ndarray, inputs: str, parts: int) -> np.ndarray:
    """Explicit Euler steps of setpoint and servo, and the play on them."""
    r, y, z = (commands[0].copy() for _ in range(3))
    h, found = DT / parts, []
    limit = np.inf if actuator.rate is None else actuator.rate
    for command in commands:
        ramp = np.clip(command - r, -limit * DT, limit * DT) / parts
        for _ in range(parts):
            r = r + (ramp if inputs == "ramp" else np.clip(command - r, -limit * h, limit * h))
            y = y + h / actuator.lag * (r - y)
            z = np.clip(z, y - actuator.play / 2, y + actuator.play / 2)
        found.append(z)
    return np.array(found)


def test_nothing_in_it_does_nothing() -> None:
    np.testing.assert_array_equal(Actuator().simulate(COMMANDS, DT)[0], COMMANDS)


def test_a_held_command_is_approached_exponentially_and_a_ramp_followed_at_a_distance() -> None:
    lag = 0.04
    t = DT * np.arange(1, 31)
    steps, _ = Actuator(lag=lag).simulate(np.ones((30, 1)), DT, ActuatorState.at([0.0]), "step")
    np.testing.assert_allclose(steps[:, 0], 1.0 - np.exp(-t / lag), rtol=1e-12)
    ramp, _ = Actuator(lag=lag).simulate(2.0 * t[:, None], DT, ActuatorState.at([0.0]))
    np.testing.assert_allclose(ramp[:, 0], 2.0 * (t - lag + lag * np.exp(-t / lag)), atol=1e-13)


@pytest.mark.parametrize("inputs", ["ramp", "step"])
@pytest.mark.parametrize("rate", [None, 20.0])
def test_steps_are_the_limit_of_fine_integration(inputs: str, rate: float | None) -> None:
    actuator = Actuator(lag=0.04, play=0.5, rate=rate)
    exact, _ = actuator.simulate(COMMANDS, DT, inputs=inputs)
    errors = [np.abs(finely(actuator, COMMANDS, inputs, n) - exact).max() for n in (40, 400)]
    assert errors[1] < 5e-3 and errors[1] < 0.12 * errors[0]  # order one of Euler's steps


def test_the_state_carries_on_to_the_last_bit_and_channels_do_not_mix() -> None:
    actuator = Actuator(lag=0.02, play=0.3, rate=30.0)
    whole, end = actuator.simulate(COMMANDS, DT)
    first, between = actuator.simulate(COMMANDS[:17], DT)
    second, last = pickle.loads(pickle.dumps(actuator)).simulate(COMMANDS[17:], DT, between)
    assert np.vstack([first, second]).tobytes() == whole.tobytes()
    assert last.position.tobytes() == end.position.tobytes()
    np.testing.assert_array_equal(actuator.simulate(COMMANDS[:, 1:2], DT)[0], whole[:, 1:2])


@settings(deadline=None, max_examples=50)
@given(PATHS, st.floats(0.0, 3.0), st.floats(-5, 5), st.floats(-5, 5))
def test_play_is_rate_independent_idempotent_and_contracts(path: list[float], play: float, a: float, b: float) -> None:
    actuator, u = Actuator(play=play), np.array(path)[:, None]
    once, _ = actuator.simulate(u, DT, ActuatorState.at([a]))
    slower, _ = actuator.simulate(u, 7 * DT, ActuatorState.at([a]))
    np.testing.assert_array_equal(once, slower)
    twice = np.repeat(u, 2, axis=0)  # to stand still moves nothing
    np.testing.assert_array_equal(actuator.simulate(twice, DT, ActuatorState.at([a]))[0][1::2], once)
    other, _ = actuator.simulate(u, DT, ActuatorState.at([b]))
    assert (np.diff(np.abs(other - once)[:, 0], prepend=abs(a - b)) <= 1e-12).all()
    assert (np.abs(once - u) <= 0.5 * play + 1e-12).all()


def test_play_follows_when_it_is_used_up_and_remembers_where_it_came_from() -> None:
    up, down = np.linspace(0.0, 1.0, 101)[:, None], np.linspace(1.0, 0.0, 101)[:, None]
    moved, _ = Actuator(play=0.2).simulate(np.vstack([up, down]), DT)
    np.testing.assert_allclose(moved[:101], np.maximum(up - 0.1, 0.0), atol=1e-15)
    np.testing.assert_allclose(moved[101:], np.minimum(down + 0.1, 0.9), atol=1e-15)


def test_a_large_sweep_erases_what_was_before() -> None:
    sweep = np.array([[3.0], [-3.0]])
    ends = [Actuator(play=1.0).simulate(sweep, DT, ActuatorState.at([x]))[0][-1] for x in (-2.0, 0.0, 2.0)]
    assert ends[0] == ends[1] == ends[2] == -2.5


@pytest.mark.parametrize("options", [{"lag": -1.0}, {"play": np.nan}, {"rate": 0.0}])
def test_what_is_no_actuator_is_refused(options: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="Actuator"):
        Actuator(**options)


def test_the_way_back_and_forth_within_one_step_uses_up_the_play() -> None:
    """The setpoint turns at the start of a step while the servo still lags behind: it goes on, then turns within it."""
    actuator, start = Actuator(lag=0.1, play=0.2), ActuatorState(np.array([1.0]), np.array([0.5]), np.array([0.4]))
    found, end = actuator.simulate(np.array([[0.0]]), 0.3, start)
    t = np.linspace(0.0, 0.3, 200_001)
    setpoint = 1.0 - t / 0.3
    servo = setpoint + 0.1 / 0.3 + (0.5 - 1.0 - 0.1 / 0.3) * np.exp(-t / 0.1)
    assert servo.max() > 0.55 and end.servo[0] == pytest.approx(servo[-1], rel=1e-12)
    highest = max(0.4, servo.max() - 0.1)
    assert found[0, 0] == pytest.approx(min(highest, servo[-1] + 0.1), abs=1e-9)
