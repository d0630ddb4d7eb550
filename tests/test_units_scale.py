"""States of one unit share a scale: what hardly moves is not blown up to the size of the rest, its noise with it."""

import numpy as np
import pytest

from pisplit import Dictionary, Episodes, LinearEDMDc, horizon_errors
from pisplit import observables as ob
from pisplit.data import find_latency
from pisplit.data.noise import noise_margins
from pisplit.regression import column_scales

DT, NOISE, FREQUENCY = 0.05, 3e-4, 9.0


def recordings(units: list[str]) -> Episodes:
    """A pendulum seen in eight coordinates of markers, six of which hardly move; the noise of all is the same."""
    xs, us = [], []
    for k in range(8):
        rng = np.random.default_rng(k)
        u, q, v = np.repeat(rng.uniform(-1.0, 1.0, 20), 8), 0.0, 0.0
        angles = [q]
        for command in u:
            for _ in range(50):
                v += DT / 50 * (FREQUENCY**2 * (command - q) - 0.1 * FREQUENCY * v)
                q += DT / 50 * v
            angles.append(q)
        clean = np.outer(angles, 0.1 * np.array([0.01, 0.01, 0.02, 0.02, 0.01, 0.01, 0.6, 1.0]))
        xs.append(clean + NOISE * rng.standard_normal(clean.shape))
        us.append(u[:, None])
    return Episodes(xs, us, DT, state_names=list("abcdefgh"), units=units)


def without_units(data: Episodes, factors: np.ndarray, more: int = 0, seed: int = 0) -> Episodes:
    """Columns times ``factors`` (n,), and ``more`` columns of noise of very different sizes, one of them constant."""
    rng = np.random.default_rng(seed)
    beside = [10.0 ** np.arange(-3, 3 * more - 3, 3) * rng.standard_normal((len(x), more)) for x in data.xs]
    xs = [np.hstack([x * factors, z, 0.0 * x[:, :1] + 7.0]) for x, z in zip(data.xs, beside, strict=True)]
    return Episodes(xs, data.us, DT)


def error(data: Episodes) -> float:
    """Median squared error of the last column of the eight, in its unit."""
    theta = Dictionary(ob.Constant(), ob.Identity(), ob.Delays(4, 4), n_states=data.n_states, n_inputs=1)
    return LinearEDMDc(theta, alpha=1e-2).fit(data[:3]).score(data[6:], [7]).median


@pytest.mark.parametrize(("sizes", "more"), [((1.0,) * 8, 0), ((1e6, *(1.0,) * 7), 0), ((1.0,) * 8, 3)])
def test_columns_of_no_unit_that_hardly_move_are_not_blown_up_with_their_noise(sizes: tuple, more: int) -> None:
    """Whatever their sizes, and whatever noise stands beside them, they predict as well as columns in metres."""
    data = recordings(["m"] * 8)
    assert error(without_units(data, np.array(sizes), more)) < 1.3 * error(data)


def test_margins_know_noise_from_motion() -> None:
    """What follows an input within a step, what jumps and rests, and what is noise beside a clear column."""
    rng = np.random.default_rng(3)
    u = rng.uniform(-1.0, 1.0, (400, 1))
    clear = np.cumsum(0.01 * np.cumsum(np.vstack([u, u[:1]]), axis=0), axis=0)[:, 0]
    quick = 0.1 + np.append(0.0, u[:, 0])
    jumps = np.repeat(rng.uniform(-1.0, 1.0, 41), 10)[:401]
    noise, flicker = 5.0 * rng.standard_normal(401), 20.0 + 0.1 * (rng.uniform(size=401) < 0.1)
    names = ["clear", "quick", "jumps", "noise", "flicker"]
    data = Episodes([np.column_stack([clear, quick, jumps, noise, flicker])], [u], 0.1, state_names=names)
    found = noise_margins(data)
    assert set(found) == {"noise", "flicker"} and all(f > 200.0 for f in found.values())
    alike = noise_margins(Episodes([data.xs[0][:, 3:]], [u], 0.1))  # neither is clearer
    assert all(f < 1.1 for f in alike.values())


def test_quantities_follow_units_where_they_are_not_given() -> None:
    rng = np.random.default_rng(0)
    given = {"us": [np.ones((4, 1))], "dt": 0.1, "state_names": list("abcdef")}
    data = Episodes([rng.standard_normal((5, 6))], units=["m", "rad", "m", "1", "1", ""], **given)
    assert data.quantities == ("m", "b", "m", "d", "e", "f")
    own = Episodes([rng.standard_normal((5, 6))], units=["m"] * 6, quantities=list("ppqqrs"), **given)
    assert own.quantities == tuple("ppqqrs")


@pytest.mark.parametrize("factor", [1.0, 1e3])
def test_a_unit_of_all_changes_nothing(factor: float) -> None:
    data = recordings(["m"] * 8)
    scaled = Episodes([factor * x for x in data.xs], data.us, DT, units=["mm" if factor > 1 else "m"] * 8)
    theta = Dictionary(ob.Constant(), ob.Identity(), n_states=8, n_inputs=1)
    first, second = (LinearEDMDc(theta, alpha=1e-2).fit(d[:6]) for d in (data, scaled))
    np.testing.assert_allclose(second.score(scaled[6:]).median, factor**2 * first.score(data[6:]).median, rtol=1e-6)


def test_coordinates_of_noise_alone_do_not_hide_a_late_log() -> None:
    """A log stamped two steps late is found two steps before one that is right, within what is told."""
    data = recordings(["m"] * 8)
    right = find_latency(data.xs, data.us, DT)
    late = find_latency([x[2:-2] for x in data.xs], [u[:-4] for u in data.us], DT)
    assert right.delay is not None and late.delay is not None
    assert late.delay - right.delay == pytest.approx(-2.0 * DT, abs=late.error)
    assert late.error <= 2.0 * DT and late.delay < 0.0 <= right.delay + right.error


def test_products_have_the_margins_of_their_factors() -> None:
    given = column_scales(np.ones(4), ["a", "a*b", "b^2", "c"], margins={"a": 2.0, "b": 3.0})
    np.testing.assert_allclose(given, [2.0, 6.0, 9.0, 1.0])


@pytest.mark.parametrize("units", [["m"] * 8, [""] * 8], ids=["metres", "unknown"])
def test_errors_by_horizon_are_not_those_of_noise_where_little_moves(units: list[str]) -> None:
    """A fifth of six of the eight coordinates is noise; the error is told in parts of what moves."""
    data = recordings(units)
    theta = Dictionary(ob.Constant(), ob.Identity(), ob.Delays(4, 4), n_states=8, n_inputs=1)
    found = horizon_errors(LinearEDMDc(theta, alpha=1e-2).fit(data[:6]), data[6:], [1, 10])
    assert (found.rms[:, 0] > 0.15 * found.spread[0]).all() and (found.normalised < 0.05).all()
