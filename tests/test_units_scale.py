"""States of one unit share a scale: what hardly moves is not blown up to the size of the rest, its noise with it."""

import numpy as np
import pytest

from pisplit import Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob
from pisplit.data import find_latency

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


def test_markers_of_one_unit_predict_better_than_each_by_its_own_range() -> None:
    errors = {}
    for label, units in (("metres", ["m"] * 8), ("unknown", [""] * 8)):
        data = recordings(units)
        theta = Dictionary(ob.Constant(), ob.Identity(), ob.Delays(4, 4), n_states=8, n_inputs=1)
        errors[label] = LinearEDMDc(theta, alpha=1e-2).fit(data[:3]).score(data[6:]).median
    assert errors["metres"] < 0.5 * errors["unknown"]


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
