"""Recordings behind an actuator: positions in the place of commands, and the actuator found from recordings."""

from __future__ import annotations

import numpy as np
import pytest

from pisplit import Actuator, Dictionary, Episodes, LinearEDMDc, choose_actuator, find_actuator
from pisplit import observables as ob

DT = 0.05
A = np.array([[0.95, 0.2], [-0.2, 0.9]])


def recorded(actuator: Actuator, seed: int = 0, episodes: int = 4, steps: int = 80) -> Episodes:
    """A linear system under the mean position over each step; what is recorded are commands and states."""
    rng = np.random.default_rng(seed)
    xs, us = [], []
    for _ in range(episodes):
        knots = np.concatenate([[0.0], rng.normal(size=steps // 6 + 2)])
        u = np.interp(np.arange(steps) / 6.0, np.arange(len(knots)), knots)[:, None]
        moved = actuator.simulate(u, DT)[0]
        before = np.vstack([moved[:1], moved[:-1]])
        x = [np.zeros(2)]
        for k in range(steps):
            x.append(A @ x[-1] + np.array([0.05, 0.15]) * 0.5 * (moved[k] + before[k]))
        xs.append(np.array(x))
        us.append(u)
    return Episodes(xs, us, dt=DT)


@pytest.mark.parametrize(("lag", "play"), [(0.06, 0.0), (0.0, 0.3), (0.04, 0.2)])
def test_lag_and_play_are_found(lag: float, play: float) -> None:
    found = find_actuator(recorded(Actuator(lag=lag, play=play)))
    assert found.actuator.lag == pytest.approx(lag, abs=0.15 * lag)
    assert found.actuator.play == pytest.approx(play, abs=0.15 * play)
    assert found.residual < 0.2 * found.without
    assert found.residual - found.tried[:, 2].min() <= 0.02 * found.without


def pulled(actuator: Actuator, noise: float = 0.01) -> Episodes:
    """Two masses on three strings whose commands sum to zero, behind the actuator, seen with noise by ten sensors."""
    rng = np.random.default_rng(2)
    strings = np.array([[np.cos(a), np.sin(a)] for a in 2.0 * np.pi * np.arange(3) / 3.0])
    sensors, xs, us = rng.normal(size=(10, 4)), [], []
    for _ in range(5):
        knots = rng.normal(size=(24, 2)) @ strings.T
        u = np.stack([np.interp(np.arange(160) / 8.0, np.arange(24), k) for k in knots.T], axis=1)
        moved, z = actuator.simulate(u, DT)[0], np.zeros((161, 4))
        before = np.vstack([moved[:1], moved[:-1]])
        for k in range(160):
            push = 0.5 * (moved[k] + before[k]) @ strings
            z[k + 1, :2], z[k + 1, 2:] = A @ z[k, :2] + 0.15 * push[0] * A[1], A.T @ z[k, 2:] + 0.15 * push[1] * A[0]
        y = z @ sensors.T
        xs.append(y + noise * y.std() * rng.normal(size=y.shape))
        us.append(u)
    return Episodes(xs, us, dt=DT)


@pytest.mark.parametrize(("lag", "play"), [(0.08, 0.2), (0.0, 0.0)])
def test_noise_and_strings_that_sum_to_zero_hide_neither(lag: float, play: float) -> None:
    """Positions behind play do not sum to zero: a direction more in the map must not pass for a better actuator."""
    found = find_actuator(pulled(Actuator(lag=lag, play=play))).actuator
    assert found.lag == pytest.approx(lag, abs=0.25 * lag)
    assert found.play == pytest.approx(play, abs=0.25 * play)


def test_where_there_is_no_actuator_none_is_found() -> None:
    found = find_actuator(recorded(Actuator()))
    assert found.actuator == Actuator()
    assert found.residual == found.without < 1e-6


def test_positions_make_a_linear_model_exact_again() -> None:
    actuator = Actuator(lag=0.04, play=0.2)
    theta = Dictionary(ob.States(), ob.Inputs(), ob.Delays(inputs=1), n_states=2, n_inputs=1)
    d1, test = recorded(actuator), recorded(actuator, seed=1)
    commands = LinearEDMDc(theta).fit(d1).score(test).median
    positions = LinearEDMDc(theta).fit(d1.through(actuator)).score(test.through(actuator)).median
    assert positions < 1e-18 < 1e-4 < commands


@pytest.mark.parametrize("true", [Actuator(), Actuator(lag=0.04, play=0.2)])
def test_numbers_that_recordings_contradict_are_not_taken(true: Actuator) -> None:
    """Play where there is none, and three times too much of it; the first that fits is taken, not the best."""
    theta = Dictionary(ob.States(), ob.Inputs(), ob.Delays(inputs=1), n_states=2, n_inputs=1)
    told = [Actuator(play=0.6), true, Actuator(lag=0.2)]
    found = choose_actuator(LinearEDMDc(theta).fit, recorded(true), told)
    assert found.actuator == true
    assert found.errors[0] > 1.2 and found.errors[1] <= 1.0
    assert str(found).count("contradicted") == (found.errors > 1.2).sum()
    none = choose_actuator(LinearEDMDc(theta).fit, recorded(Actuator()), [Actuator(play=0.6), Actuator(lag=0.2)])
    assert none.actuator == Actuator()


def test_recordings_pass_through_one_by_one_and_say_so() -> None:
    d1, actuator = recorded(Actuator()), Actuator(lag=0.03, play=0.1)
    passed = d1.through(actuator, start=[0.0])
    for u, position in zip(d1.us, passed.us, strict=True):
        np.testing.assert_array_equal(position, actuator.simulate(u, DT)[0])  # commands begin at zero
    assert passed.provenance == {"actuator": {"lag": 0.03, "play": 0.1, "rate": None, "inputs": "ramp"}}
    np.testing.assert_array_equal(passed.xs[0], d1.xs[0])
    np.testing.assert_array_equal(d1.through(Actuator()).us[0], d1.us[0])


def test_what_does_not_fit_is_refused() -> None:
    d1 = recorded(Actuator())
    with pytest.raises(ValueError, match="expected an Actuator"):
        d1.through(0.03)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="start"):
        d1.through(Actuator(), start=[0.0, 1.0])
    with pytest.raises(ValueError, match="plays"):
        find_actuator(d1, plays=[-1.0])
    theta = Dictionary(ob.States(), ob.Inputs(), n_states=2, n_inputs=1)
    wrong = (d1[:1], [Actuator(0.1)], "two or more"), (d1, [], "empty"), (d1, [0.1], "Actuator")
    for data, candidates, said in wrong:
        with pytest.raises(ValueError, match=said):
            choose_actuator(LinearEDMDc(theta).fit, data, candidates)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="at least 20"):
        find_actuator(Episodes([d1.xs[0][:11]], [d1.us[0][:10]], DT))
