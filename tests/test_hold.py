"""The hold split: gains of known systems, first-order held inputs, equilibria, the limits of the penalty."""

from __future__ import annotations

import itertools
import warnings
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from scipy.integrate import solve_ivp

from pisplit import Dictionary, Episodes, LinearEDMDc, PhaseSamples, PIEDMDc
from pisplit import observables as ob
from pisplit.models import systems

DT = 0.1
A = np.array([[0.0, 1.0, 0.0], [-4.0, -0.4, 1.0], [0.5, 0.0, -2.0]])
E = np.array([[1.0, 0.2], [0.0, 0.0], [0.3, -0.5]])  # equilibrium x = E u
PORT = np.array([[0.0], [1.0], [0.3]])
LOAD = np.array([[1.0, 0.0, 0.5]])
GAIN = -1.7
TRUE = A + GAIN * PORT @ LOAD


def held(first: bool, drift: np.ndarray, drive: np.ndarray, x0: np.ndarray, u: np.ndarray) -> np.ndarray:
    """x' = drift x + drive u by a high-order method; u linear over the step from its last value, or constant."""
    xs = [x0]
    for k in range(len(u)):
        before = u[k - 1] if k and first else u[k]

        def rate(t: float, x: np.ndarray, before: np.ndarray = before, after: np.ndarray = u[k]) -> np.ndarray:
            return drift @ x + drive @ (before + (after - before) * t / DT)

        xs.append(solve_ivp(rate, (0.0, DT), xs[-1], method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1])
    return np.array(xs)


def data(first: bool, drift: np.ndarray, drive: np.ndarray, n: int = 3, steps: int = 20, seed: int = 0) -> Episodes:
    rng = np.random.default_rng(seed)
    us = [rng.normal(size=(steps, drive.shape[1])) for _ in range(n)]
    return Episodes([held(first, drift, drive, rng.normal(size=len(drift)), u) for u in us], us, dt=DT)


def samples(drift: np.ndarray, drive: np.ndarray, n: int = 40) -> PhaseSamples:
    rng = np.random.default_rng(9)
    x, u = rng.normal(size=(n, len(drift))), rng.normal(size=(n, drive.shape[1]))
    return PhaseSamples(x, u, x @ drift.T + u @ drive.T)


def dictionary(first: bool, constant: bool = True) -> Dictionary:
    parts: list[Any] = [ob.Constant()] if constant else []
    return Dictionary(*parts, ob.Identity(), ob.Delays(inputs=int(first)), n_states=3, n_inputs=2)


def worst_roll_out(model: PIEDMDc, first: bool, drift: np.ndarray, drive: np.ndarray) -> float:
    episode = data(first, drift, drive, n=1, steps=80, seed=77)
    start = episode.start(0, int(first))
    found = model.predict((start.x_history, start.u_history) if first else start.x_history[0], start.inputs)
    return float(np.abs(found - start.states).max())


@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("constant", [True, False])
@pytest.mark.parametrize("alpha", [0.0, 1e-3, 1e6])
def test_the_gain_of_a_load_on_the_deviation_is_recovered(first: bool, constant: bool, alpha: float) -> None:
    known = samples(A, -A @ E)
    d1 = data(first, TRUE, -TRUE @ E)
    options = {"equilibrium": E, "ports": PORT, "loads": LOAD}
    model = PIEDMDc(dictionary(first, constant), alpha=alpha, split="hold", penalty="ridge", options=options)
    model.fit(d1, known)
    np.testing.assert_allclose(model.fit_.details["gains"], [[GAIN]], atol=1e-6)
    assert worst_roll_out(model, first, TRUE, -TRUE @ E) < 1e-6
    columns = [model.theta_.column_names.index(name) for name in ("x1", "x2", "x3")]
    np.testing.assert_allclose(model.K_[:, columns], scipy.linalg.expm(TRUE * DT), atol=1e-6)


@pytest.mark.parametrize("first", [True, False])
def test_without_an_equilibrium_h_depends_on_states_and_inputs(first: bool) -> None:
    drive = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]])
    h_u = np.array([[0.4, -0.9]])
    true_drive = drive + PORT @ h_u
    model = PIEDMDc(dictionary(first, False), alpha=1e6, split="hold", penalty="ridge", options={"ports": PORT})
    model.fit(data(first, TRUE, true_drive), samples(A, drive))
    np.testing.assert_allclose(model.fit_.details["gains"], np.hstack([GAIN * LOAD, h_u]), atol=1e-6)
    assert worst_roll_out(model, first, TRUE, true_drive) < 1e-6


@pytest.mark.parametrize("first", [True, False])
def test_an_unknown_constant_load_is_found_with_a_constant_column(first: bool) -> None:
    # A constant load moves the equilibrium: x' = A (x - b) + B u.
    b = np.array([0.3, 0.0, -0.2])
    moved = data(first, A, -A @ E)
    d1 = Episodes([x + b for x in moved.xs], moved.us, dt=DT)
    model = PIEDMDc(dictionary(first), alpha=1e9, split="hold", penalty="ridge").fit(d1, samples(A, -A @ E))
    gains = np.array(model.fit_.details["gains"])
    np.testing.assert_allclose(gains, np.hstack([np.zeros((3, 5)), (-A @ b)[:, None]]), atol=1e-5)


@pytest.mark.parametrize("first", [True, False])
def test_the_data_agree_with_van_loans_exponential(first: bool) -> None:
    """The reference of these tests against a closed form."""
    drive = -TRUE @ E
    block = np.zeros((7, 7))
    block[:3, :3], block[:3, 3:5], block[3:5, 5:] = TRUE, drive, np.eye(2)
    step = scipy.linalg.expm(block * DT)
    episode = data(first, TRUE, drive, n=1)
    x, u = episode.xs[0], episode.us[0]
    for k in range(1, 5):
        before = u[k - 1] if first else u[k]
        exact = step[:3] @ np.concatenate([x[k], before, (u[k] - before) / DT])
        np.testing.assert_allclose(x[k + 1], exact, atol=1e-10)


def test_every_equilibrium_is_kept_by_the_physical_map() -> None:
    # The data are of another system, so h is wrong: the physical map keeps x = E u all the same.
    wrong = data(True, TRUE + np.diag([0.0, -0.5, -1.0]), -A @ E)
    options = {"equilibrium": E, "ports": PORT, "loads": LOAD}
    model = PIEDMDc(dictionary(True), alpha=1e14, split="hold", penalty="ridge", options=options)
    model.fit(wrong, samples(A, -A @ E))
    u = np.array([0.7, -1.2])
    x = model.predict((np.tile(E @ u, (2, 1)), u[None, :]), np.tile(u, (200, 1)))
    assert np.abs(x - E @ u).max() < 1e-9


@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("constant", [True, False])
@pytest.mark.parametrize("options", [{}, {"equilibrium": E, "ports": PORT, "loads": LOAD}])
def test_without_a_penalty_it_is_edmdc(first: bool, constant: bool, options: dict[str, Any]) -> None:
    rng = np.random.default_rng(3)
    exact = data(first, TRUE, np.ones((3, 2)), n=4)
    d1 = Episodes([x + 0.05 * rng.normal(size=x.shape) for x in exact.xs], exact.us, dt=DT)
    plain = LinearEDMDc(dictionary(first, constant)).fit(d1)
    split = PIEDMDc(dictionary(first, constant), alpha=0.0, split="hold", options=options).fit(d1, samples(A, -A @ E))
    np.testing.assert_allclose(split.K_, plain.K_, atol=1e-8)


def test_the_penalty_leads_from_edmdc_to_the_physical_map() -> None:
    rng = np.random.default_rng(3)
    exact = data(True, TRUE, -TRUE @ E)
    d1 = Episodes([x + 0.05 * rng.normal(size=x.shape) for x in exact.xs], exact.us, dt=DT)
    options = {"equilibrium": E, "ports": PORT, "loads": LOAD}

    def k(alpha: float) -> np.ndarray:
        model = PIEDMDc(dictionary(True), alpha=alpha, split="hold", penalty="ridge", options=options)
        return model.fit(d1, samples(A, -A @ E)).K_

    limit = k(1e12)
    distances = [np.abs(k(alpha) - limit).max() for alpha in (0.0, 1e-2, 1.0, 1e2, 1e6)]
    assert all(a > b for a, b in itertools.pairwise(distances)) and distances[-1] < 1e-5


def test_samples_at_one_state_stand_for_f_where_the_options_give_them() -> None:
    other = samples(np.diag([-1.0, -2.0, -3.0]), np.zeros((3, 2)))
    options = {"equilibrium": E, "ports": PORT, "loads": LOAD, "tangent": samples(A, -A @ E)}
    model = PIEDMDc(dictionary(True), alpha=1e6, split="hold", penalty="ridge", options=options)
    model.fit(data(True, TRUE, -TRUE @ E), other)
    np.testing.assert_allclose(model.fit_.details["gains"], [[GAIN]], atol=1e-6)


def test_on_the_slow_manifold_only_the_input_is_left_to_learn() -> None:
    step, square = 1e-3, ob.Expression(lambda x, u: x[0] ** 2, name="x1^2")
    system = systems.slow_manifold()

    def run(steps: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        u = np.repeat(0.1 * np.random.default_rng(seed).normal(size=(steps // 3 + 1, 1)), 3, axis=0)[:steps]
        return system.simulate([0.3, 0.7], u, step), u

    x2 = np.random.default_rng(1).uniform(-1, 1, (200, 2))
    d2 = PhaseSamples.from_system(system, x2, np.zeros((200, 1)))
    theta = Dictionary(ob.Constant(), ob.Identity(), square, n_states=2, n_inputs=1)
    for n in (16, 256):
        x, u = run(n, 0)
        model = PIEDMDc(theta, alpha=1e6, penalty="ridge", split="hold", rows="inputs")
        model.fit(Episodes([x], [u], dt=step), d2)
        assert np.array(model.fit_.details["gains"]).shape == (3, 1)
        x, u = run(10_000, 100)
        assert np.mean((model.predict(x[0], u) - x)[:, 1] ** 2) <= 1e-7


def test_states_that_are_no_columns_are_read_from_trajectories_and_phase_samples() -> None:
    # Two states 2 s and |s| are read from one column s: trajectories visit s > 0 only, phase samples s < 0 only.
    theta = Dictionary(
        ob.Constant(), ob.Expression(lambda x, u: x[0] / 2, name="s"), ob.Inputs(), n_states=2, n_inputs=1
    )
    rng = np.random.default_rng(0)
    u = 0.2 + 0.1 * rng.uniform(size=(40, 1))
    s = np.empty(41)
    s[0] = 1.0
    for k in range(40):
        s[k + 1] = 0.9 * s[k] + u[k, 0]
    d1 = Episodes([np.column_stack([2 * s, np.abs(s)])], [u], dt=DT)
    low = -rng.uniform(1, 2, size=200)
    d2 = PhaseSamples(np.column_stack([2 * low, np.abs(low)]), np.zeros((200, 1)), np.zeros((200, 2)))
    read = {
        "both": PIEDMDc(theta, alpha=1.0, split="hold", penalty="ridge").fit(d1, d2).lifted,
        "trajectories": LinearEDMDc(theta).fit(d1).lifted,
    }
    at = read["both"].column_names.index("s")
    for name, stack in (("both", np.concatenate([s[:-1], low])), ("trajectories", s[:-1])):
        model = read[name]
        slope, offset = np.polyfit(stack, np.abs(stack), 1)
        np.testing.assert_allclose(model.C[:, at], [2.0, slope], atol=1e-6)
        np.testing.assert_allclose(model.d, [0.0, offset], atol=1e-6)


def test_options_and_data_are_not_changed() -> None:
    options = {"equilibrium": E.copy(), "ports": PORT.copy(), "loads": LOAD.copy()}
    d1, d2 = data(True, TRUE, -TRUE @ E), samples(A, -A @ E)
    copies = [a.copy() for a in (*d1.xs, *d1.us, d2.x, d2.u, d2.xdot)]
    PIEDMDc(dictionary(True), alpha=0.1, split="hold", options=options).fit(d1, d2)
    for a, b in zip((*d1.xs, *d1.us, d2.x, d2.u, d2.xdot), copies, strict=True):
        np.testing.assert_array_equal(a, b)
    for name, value in (("equilibrium", E), ("ports", PORT), ("loads", LOAD)):
        np.testing.assert_array_equal(options[name], value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"port": PORT}, "'port'"),
        ({"equilibrium": E.T}, "equilibrium"),
        ({"equilibrium": E, "loads": np.ones((1, 2))}, "loads"),
        ({"loads": LOAD}, "equilibrium"),
        ({"ports": np.ones((2, 1))}, "ports"),
        ({"ports": np.ones((3, 0))}, "ports"),
        ({"equilibrium": E, "loads": np.ones((0, 3))}, "loads"),
        ({"ports": np.full((3, 1), np.nan)}, "ports"),
        ({"ports": np.zeros((3, 1))}, "ports"),
        ({"tangent": np.ones((3, 3))}, "tangent"),
        ({"tangent": PhaseSamples(np.ones((5, 2)), np.ones((5, 2)), np.ones((5, 2)))}, "2 states"),
    ],
)
def test_bad_options_are_refused_in_one_line(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        model = PIEDMDc(dictionary(True), alpha=1.0, split="hold", options=options)
        model.fit(data(True, A, -A @ E, n=1), samples(A, -A @ E))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("delays", [ob.Delays(states=1), ob.Delays(inputs=2), ob.Delays(states=2, inputs=1)])
def test_other_delays_are_refused_in_one_line(delays: ob.Delays) -> None:
    theta = Dictionary(ob.Constant(), ob.Identity(), delays, n_states=3, n_inputs=2)
    with pytest.raises(ValueError, match="Delays") as error:
        PIEDMDc(theta, alpha=1.0, split="hold").fit(data(True, A, -A @ E, n=1), samples(A, -A @ E))
    assert "\n" not in str(error.value)


def test_phase_samples_of_another_system_are_refused_in_one_line() -> None:
    other = PhaseSamples(np.ones((5, 2)), np.ones((5, 1)), np.ones((5, 2)))
    for options in ({}, {"tangent": samples(A, -A @ E), "equilibrium": E}):
        with pytest.raises(ValueError, match="2 states") as error:
            PIEDMDc(dictionary(True), alpha=1.0, split="hold", options=options).fit(data(True, A, -A @ E, n=1), other)
        assert "\n" not in str(error.value)


def test_the_radius_is_that_of_the_physical_map() -> None:
    d1 = data(False, TRUE, -TRUE @ E)
    options = {"equilibrium": E, "ports": PORT, "loads": LOAD}
    model = PIEDMDc(dictionary(False), 1e12, split="hold", options=options).fit(d1, samples(A, -A @ E))
    exact = np.exp(DT * np.linalg.eigvals(TRUE).real.max())
    assert model.fit_.details["radius"] == pytest.approx(exact, rel=1e-6)


def test_what_is_constant_in_the_known_rates_is_integrated() -> None:
    """x' = A x + B u + c known, h has the inputs only and is none: the map of the physics alone is exact."""
    drive, c, rng = -A @ E, np.array([0.3, -1.0, 0.5]), np.random.default_rng(2)
    full = np.block([[A, drive, c[:, None]], [np.zeros((3, 6))]])
    step, xs, us = scipy.linalg.expm(DT * full), [], []
    for _ in range(3):
        u = rng.normal(size=(20, 2))
        x = [rng.normal(size=3)]
        for value in u:
            x.append(step[:3] @ np.concatenate([x[-1], value, [1.0]]))
        xs.append(np.array(x))
        us.append(u)
    x, u = rng.normal(size=(40, 3)), rng.normal(size=(40, 2))
    d2 = PhaseSamples(x, u, x @ A.T + u @ drive.T + c)
    model = PIEDMDc(dictionary(False), 1e12, split="hold", rows="inputs").fit(Episodes(xs, us, dt=DT), d2)
    np.testing.assert_allclose(model.predict(xs[0][0], us[0]), xs[0], atol=1e-7)


@pytest.mark.parametrize("first", [True, False])
def test_a_free_unknown_part_is_said_with_past_inputs_and_without(first: bool) -> None:
    d1, d2 = data(first, TRUE, -TRUE @ E), samples(A, -A @ E)
    with pytest.warns(UserWarning, match="f has no effect"):
        PIEDMDc(dictionary(first), 0.1, split="hold").fit(d1, d2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # two loads of three leave something to f
        options = {"equilibrium": E, "loads": np.eye(3)[:2]}
        PIEDMDc(dictionary(first), 0.1, split="hold", options=options).fit(d1, d2)
