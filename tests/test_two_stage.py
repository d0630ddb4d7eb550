"""toward="physics": between EDMDc and the physical map, both of which are limits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pisplit import Dictionary, Episodes, LinearEDMDc, PhaseSamples, PIEDMDc
from pisplit import observables as ob
from pisplit.evaluation.rollouts import rollout_errors
from pisplit.models import systems

DT = 0.02


def runs(count: int, steps: int = 150) -> Episodes:
    rng = np.random.default_rng(5)
    us = [0.3 * rng.normal(size=(steps, 1)) for _ in range(count)]
    return Episodes([systems.slow_manifold(delta=1.0).simulate([0.5, 0.4], u, DT) for u in us], us, DT)


def known() -> PhaseSamples:
    x = np.random.default_rng(1).uniform([0.0, -0.5], [0.6, 0.5], (200, 2))
    return PhaseSamples.from_system(systems.slow_manifold(delta=1.0), x, np.zeros((200, 1)))


def theta(*more: Any) -> Dictionary:
    return Dictionary(ob.Constant(), ob.Identity(), *more, n_states=2, n_inputs=1)


@pytest.mark.parametrize("split", ["strang", "lie"])
@pytest.mark.parametrize("penalty", ["ridge", "lasso"])
@pytest.mark.parametrize("delays", [ob.Delays(), ob.Delays(states=1, inputs=1)])
def test_both_limits_are_exact(split: str, penalty: str, delays: ob.Delays) -> None:
    rng, system = np.random.default_rng(2), systems.duffing()
    us = [rng.normal(size=(60, 1)) for _ in range(5)]
    xs = [system.simulate(rng.normal(size=2), u, 0.1, substeps=4) for u in us]
    d1 = Episodes(xs, us, 0.1, state_names=("x", "v"))
    d2 = PhaseSamples.from_system(system, rng.normal(size=(300, 2)), np.zeros((300, 1)))
    options: dict[str, Any] = {"split": split, "rows": "inputs"}
    physical = PIEDMDc(theta(delays), 0.0, penalty="ridge", **options).fit(d1, d2)
    plain = LinearEDMDc(theta(delays)).fit(d1)
    two = PIEDMDc(theta(delays), 0.0, penalty=penalty, toward="physics", **options).fit(d1, d2)
    np.testing.assert_allclose(two.K_, plain.K_, atol=1e-9)
    two.set_params(alpha=1e10).fit(d1, d2)
    np.testing.assert_allclose(two.K_, physical.K_, atol=1e-9)
    assert np.abs(plain.K_ - physical.K_).max() > 1e-4


def test_pairs_that_leave_columns_open_fall_back_on_physics() -> None:
    d1, d2 = runs(2), known()
    one = d1.pairs().take(np.array([0, 40]))
    options: dict[str, Any] = {"penalty": "ridge", "rows": "inputs"}
    physical = PIEDMDc(theta(), 0.0, **options).fit(d1, d2, one)
    two = PIEDMDc(theta(), 0.0, toward="physics", **options).fit(d1, d2, one)
    psi = physical.theta_.evaluate(one)
    np.testing.assert_allclose(psi @ two.K_.T, one.x_next, atol=1e-10)
    # The change has rank one: what two pairs say beside B.
    assert np.linalg.matrix_rank(two.K_ - physical.K_, tol=1e-10) == 1


@pytest.mark.parametrize("n", [8, 30, 150])
def test_cross_validation_is_never_worse_than_the_better_limit(n: int) -> None:
    d1, d2 = runs(8), known()
    part, held = d1.pairs().take(np.arange(n)), d1.subset(range(4, 8))
    options: dict[str, Any] = {"penalty": "ridge", "rows": "inputs"}
    model = PIEDMDc(theta(), "cv", toward="physics", **options).fit(d1, d2, part)
    assert model.cv_ is not None and model.cv_.held_out == (4, 5, 6, 7)
    limits = [PIEDMDc(theta(), 0.0, **options).fit(d1, d2, part), LinearEDMDc(theta()).fit(d1, part)]
    best = min(rollout_errors(m.lifted, held).median for m in limits)
    assert rollout_errors(model.lifted, held).median <= 1.02 * best


def test_what_makes_no_physical_map_is_refused() -> None:
    with pytest.raises(ValueError, match="needs rows"):
        PIEDMDc(theta(), toward="physics")
    with pytest.raises(ValueError, match="always fitted toward"):
        PIEDMDc(theta(), toward="physics", split="hold", rows="inputs")
