"""Chains of several delays: the past of the past, in a model that is advanced step by step."""

from __future__ import annotations

import numpy as np

from pisplit import Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob


def recorded(steps: int = 40, seed: int = 0) -> Episodes:
    """x_{k+1} = 0.6 x_{k-2} - 0.3 x_{k-1} + u_{k-2}, for two states that mix."""
    rng = np.random.default_rng(seed)
    mix = np.array([[0.6, 0.2], [-0.3, 0.5]])
    u, x = rng.normal(size=(steps, 1)), np.zeros((steps + 1, 2))
    x[:3] = rng.normal(size=(3, 2))
    for k in range(2, steps):
        x[k + 1] = mix @ x[k - 2] - 0.3 * x[k - 1] + [0.0, 1.0] * u[k - 2]
    return Episodes([x], [u], 0.1)


def test_a_model_of_what_was_two_steps_ago_is_exact_over_a_roll_out() -> None:
    theta = Dictionary(ob.Identity(), ob.Delays(states=2, inputs=2), n_states=2, n_inputs=1)
    model = LinearEDMDc(theta).fit(recorded())
    test = recorded(seed=1)
    x, u = test.xs[0], test.us[0]
    np.testing.assert_allclose(model.predict((x[:3], u[:2]), u[2:]), x[2:], atol=1e-9)


def test_every_delayed_column_takes_the_place_of_the_one_before_it() -> None:
    theta = Dictionary(ob.Constant(), ob.Identity(), ob.Delays(states=3, inputs=2), n_states=2, n_inputs=1)
    lifted, data = LinearEDMDc(theta).fit(recorded()).lifted, recorded(seed=2)
    x, u = data.xs[0], data.us[0]
    z = lifted.lift(x[4:8], u[4:7])
    names = list(lifted.column_names)
    after = lifted.A @ z + lifted.B @ u[7]
    expected = {f"x{i + 1}[k-{j}]": x[8 - j, i] for i in range(2) for j in (1, 2, 3)}
    expected |= {f"u1[k-{j}]": u[8 - j, 0] for j in (1, 2)}
    for name, value in expected.items():
        assert after[names.index(name)] == value
