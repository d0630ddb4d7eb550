"""What a fit and a score need beside the data does not grow with the data."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from pisplit import Dictionary, Episodes, LinearEDMDc, PhaseSamples, PIEDMDc, StreamingEDMDc, horizon_errors
from pisplit import observables as ob
from pisplit.evaluation import pieces, rollout_errors

RNG = np.random.default_rng(3)


def data(episodes: int, steps: int = 100, n: int = 4, m: int = 1) -> Episodes:
    a = 0.98 * np.linalg.qr(RNG.normal(size=(n, n)))[0]
    x, u = np.zeros((episodes, steps + 1, n)), RNG.normal(size=(episodes, steps, m))
    x[:, 0] = RNG.normal(size=(episodes, n))
    for k in range(steps):
        x[:, k + 1] = x[:, k] @ a.T + 0.1 * u[:, k, :1]
    return Episodes(list(x), list(u), 0.1)


def peak(function: Callable[[], Any]) -> float:
    """Largest number of megabytes that a call holds at once."""
    tracemalloc.start()
    try:
        function()
        return tracemalloc.get_traced_memory()[1] / 1e6
    finally:
        tracemalloc.stop()


def test_a_fit_needs_as_much_for_many_pairs_as_for_some() -> None:
    theta = Dictionary(ob.Constant(), ob.Identity(), ob.Delays(1, 1), n_states=60, n_inputs=3)
    few, many = data(90, 100, 60, 3), data(300, 100, 60, 3)
    kinds = {
        "L-EDMDc": lambda d: LinearEDMDc(theta, alpha=1e-6).fit(d),
        "streaming": lambda d: StreamingEDMDc(theta, alpha=1e-6).update(d),
    }
    for name, fit in kinds.items():
        for d in (few, many):
            d.pairs(1)  # what the episodes keep of themselves is data
        low, high = peak(lambda: fit(few)), peak(lambda: fit(many))  # noqa: B023
        index = 4 * 8 * 300 * 100 / 1e6  # of the pairs: where each is from
        assert high < low + 4 * index + 1.0 and high < 60.0, f"{name}: {low:.1f} MB, then {high:.1f} MB"


def test_a_score_needs_the_errors_and_little_more() -> None:
    theta = Dictionary(ob.Constant(), ob.Identity(), ob.Polynomials(3), n_states=4, n_inputs=1)
    test = data(2000)
    model = LinearEDMDc(theta, alpha=1e-6).fit(test[:20]).lifted
    errors = 8 * 2000 * 100 / 1e6
    assert peak(lambda: rollout_errors(model, test).median) < 40.0 + 3 * errors
    assert peak(lambda: horizon_errors(model, test, [1, 50], stride=25)) < 40.0


def test_one_long_episode_is_rolled_out_in_stretches(monkeypatch: pytest.MonkeyPatch) -> None:
    theta = Dictionary(ob.Constant(), ob.Identity(), ob.Delays(1, 1), n_states=4, n_inputs=1)
    long = data(2, 301)
    model = LinearEDMDc(theta, alpha=1e-2).fit(long).lifted
    whole, ahead = rollout_errors(model, long), horizon_errors(model, long, [1, 7, 50])
    for budget in (1, 20_000):
        monkeypatch.setattr(pieces, "BUDGET", budget)
        cut = rollout_errors(model, long)
        for a, b in zip(cut.squared, whole.squared, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-20)
        np.testing.assert_allclose(horizon_errors(model, long, [1, 7, 50]).rms, ahead.rms, rtol=1e-9)


def test_the_known_part_is_learned_in_blocks_too() -> None:
    theta = Dictionary(ob.Constant(), ob.Identity(), n_states=40, n_inputs=3)
    d1 = data(4, 100, 40, 3)

    def samples(size: int) -> PhaseSamples:
        x = RNG.normal(size=(size, 40))
        return PhaseSamples(x=x, u=np.zeros((size, 3)), xdot=-x)

    few, many = samples(12_288), samples(40_000)
    fit = PIEDMDc(theta, alpha=1e-6, penalty="ridge", toward="identity")
    assert peak(lambda: fit.fit(d1, many)) < peak(lambda: fit.fit(d1, few)) + 2.0
