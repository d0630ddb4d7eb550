"""What a user hands in by mistake is refused at every door: masked entries, imaginary parts, texts, dates."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from pisplit import (
    BilinearEDMDc,
    Dictionary,
    Episodes,
    LinearEDMDc,
    PhaseSamples,
    RecursiveRegression,
    balanced_truncation,
    rollout_errors,
)
from pisplit import observables as ob
from pisplit.controllers import MPC
from pisplit.models import rod

#: Arrays that hold something else than two real numbers, and what is said of them.
NO_NUMBERS = {
    "masked": (np.ma.masked_greater([0.1, 5.0], 2.0), "[12] (masked, |masked or )?NaN"),
    "complex": (np.array([0.1, 0.2j]), "complex numbers"),
    "texts": (["0.1", "0.2"], "texts"),
    "dates": (np.array(["2026-01-01", "2026-01-02"], dtype="M8[s]"), "dates|datetime64"),
}


def twice(row: Any) -> Any:
    return np.ma.stack([row, row]) if isinstance(row, np.ma.MaskedArray) else [row, row]


@pytest.fixture(scope="module")
def given_two_numbers() -> dict[str, Callable[[Any], object]]:
    """Public calls that take two real numbers, or an array of such rows."""
    rng = np.random.default_rng(0)
    x = [rng.normal(size=(9, 2)) for _ in range(4)]
    data = Episodes(x, [rng.normal(size=(8, 2)) for _ in x], 0.1, outputs={"tip": (0, 1)})
    theta = Dictionary(ob.Identity(), n_states=2, n_inputs=2)
    model = LinearEDMDc(theta).fit(data).lifted
    mpc = MPC(model, 3, -1.0, 1.0, 1.0)
    section = rod.Circle(1e-3)
    scene = rod.Scene(
        rod.Rod(length=0.3, section=section, material=rod.Elastic(1e9, 4e8, 1e3)),
        rod.PointWrench(s=0.3, force=rod.Input("f", 3)),
        nodes=3,
    )
    return {
        "predict": lambda v: LinearEDMDc(theta).fit(data).predict(v, np.zeros((3, 2))),
        "inputs of predict": lambda v: LinearEDMDc(theta).fit(data).predict(x[0][0], twice(v)),
        "lift": model.lift,
        "read": model.read,
        "step": lambda v: model.step(model.lift(x[0][0]), v),
        "features": lambda v: model.features(twice(v)),
        "equilibria": lambda v: LinearEDMDc(theta).fit(data, equilibria=([v], [[0.0, 0.0]])),
        "excitation": lambda v: BilinearEDMDc(theta).fit(data, excitation=[[v, v]]),
        "weights of errors": lambda v: rollout_errors(model, data, weights=v),
        "reduction": lambda v: balanced_truncation(model, 1, starts=[v]),
        "recursion": lambda v: RecursiveRegression(2, 2).update(v, v),
        "phase samples": lambda v: PhaseSamples(x=[v], u=[[0.0]], xdot=[v]),
        "radial": lambda v: ob.Radial([v], width=1.0),
        "measurement": lambda v: mpc.step(v, np.zeros((3, 2))),
        "limit": lambda v: MPC(model, 3, v, 1.0, 1.0),
        "line": lambda v: rod.Line(v, (0.0, 0.0), 0.3),
        "strains": lambda v: scene.state([*v, *np.zeros(7)], np.zeros(9), np.zeros(3)),
        "wrench": lambda v: rod.TipWrench(force=(*v, 0.0)),
        "inputs at rest": lambda v: scene.statics().solve([*v, 0.0]),
        "states of fields": lambda v: scene.field_map(3).evaluate([*v, *np.zeros(19)]),
        "limits of inverse": lambda v: scene.statics().inverse((0.0, 0.0, 0.3), limits=v),
    }


@pytest.mark.parametrize("kind", NO_NUMBERS)
def test_every_call_refuses_what_is_no_number(given_two_numbers: dict[str, Callable[[Any], object]], kind: str) -> None:
    value, message = NO_NUMBERS[kind]
    taken = []
    for name, call in given_two_numbers.items():
        try:
            call(value)
            taken.append(name)
        except ValueError as error:
            assert "\n" not in str(error)
            assert re.search(message, str(error)), (name, str(error))
    assert not taken or (kind == "masked" and taken == ["read", "measurement"])  # NaN from NaN; not measured
