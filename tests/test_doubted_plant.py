"""The best model in the place of the system, off by what it missed of recordings."""

from dataclasses import replace

import numpy as np
import pytest

from pisplit import Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob
from pisplit.controllers.plants import ModelPlant
from pisplit.front.doubted import DoubtedPlant

A, B, OFF = np.array([[0.9, 0.1], [0.0, 0.8]]), np.array([[0.0], [0.5]]), np.array([0.02, -0.01])


def recorded(rng: np.random.Generator) -> Episodes:
    u, x = rng.uniform(-1.0, 1.0, (40, 1)), [np.zeros(2)]
    for command in u:
        x.append(A @ x[-1] + B @ command + OFF)
    return Episodes([np.array(x)], [u], 0.1)


def test_with_what_it_misses_a_wrong_model_moves_as_the_system_does() -> None:
    rng = np.random.default_rng(0)
    theta = Dictionary(ob.Constant(), ob.Identity(), n_states=2, n_inputs=1)
    model = LinearEDMDc(theta, alpha=0.0).fit([recorded(rng) for _ in range(3)]).lifted
    wrong = replace(model, A=model.A - np.outer(np.eye(3)[1], np.eye(3)[0]) * 0.1)  # a constant force is missed
    held, commands = recorded(rng), rng.uniform(-1.0, 1.0, (20, 1))
    truth, plain, doubted = (
        kind(m, np.zeros(2), *more)
        for kind, m, more in ((ModelPlant, model, ()), (ModelPlant, wrong, ()), (DoubtedPlant, wrong, (held,)))
    )
    for plant in (truth, plain, doubted):
        plant.reset(np.zeros(1))
    for u in commands:
        wanted, without, found = (plant.step(u).state for plant in (truth, plain, doubted))
    assert found == pytest.approx(wanted, abs=1e-9) and np.abs(without - wanted).max() > 0.1
