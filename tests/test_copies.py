"""Whatever a user holds gives the same numbers, to the last bit, after a copy, a pickle, another process or a file."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from pisplit import (
    BilinearEDMDc,
    Dictionary,
    Episodes,
    LiftedModel,
    LinearEDMDc,
    Pairs,
    PhaseSamples,
    PIEDMDc,
    StreamingEDMDc,
    TwinEDMDc,
)
from pisplit import observables as ob
from pisplit.data import store

RNG = np.random.default_rng(5)
US = [RNG.normal(size=(steps, 1)) for steps in (30, 40, 25)]
XS = [0.1 * np.cumsum(RNG.normal(size=(len(u) + 1, 2)), axis=0) for u in US]
D1 = Episodes(XS, US, 0.1, quantities=("p", "p"), units=("m", "m"), extra={"state": XS}, provenance={"seed": 5})
D2 = PhaseSamples(RNG.normal(size=(60, 2)), np.zeros((60, 1)), -RNG.normal(size=(60, 2)), weights=RNG.uniform(size=60))
THETA = Dictionary(
    ob.Identity(),
    ob.Expression(lambda x, u: ca.sin(x[0]) * x[1], name="s"),  # no lambda can be pickled
    ob.Expression(lambda x, u: u**3, name="u^3"),
    ob.Delays(states=1, inputs=1),
    n_states=2,
    n_inputs=1,
)


def numbers(held: Any) -> list[Any]:
    """All that a user can read out of an object, as bytes and texts."""
    if isinstance(held, Episodes):
        extra = [(name, *(a.tobytes() for a in arrays)) for name, arrays in (held.extra or {}).items()]
        labels = [held.dt, held.state_names, held.input_names, held.quantities, held.units, held.provenance]
        return [*(a.tobytes() for a in (*held.xs, *held.us)), *extra, *labels, *numbers(held.pairs(1))]
    if isinstance(held, PhaseSamples):
        return [*(getattr(held, name).tobytes() for name in ("x", "u", "xdot", "weights")), held.provenance]
    if isinstance(held, Pairs):
        return [getattr(held, name).tobytes() for name in ("x", "x_next", "u", "x_history", "u_history")]
    if isinstance(held, Dictionary):
        return [held.fingerprint(), held.column_names, held.evaluate(D1.pairs(held.n_delays)).tobytes()]
    if isinstance(held, LiftedModel):
        start = D1.start(0, held.n_delays)
        rollout = held.predict(start.x_history, start.u_history, start.inputs)
        return [rollout.x.tobytes(), rollout.z.tobytes(), held.A.tobytes(), held.column_names, dict(held.provenance)]
    return numbers(held.lifted)


MADE: dict[str, Callable[[], Any]] = {
    "episodes": lambda: D1,
    "phase samples": lambda: D2,
    "pairs": lambda: D1.pairs(1).sample(20, seed=0),
    "dictionary": lambda: THETA,
    "dictionary with products": THETA.bilinear,
    "L-EDMDc": lambda: LinearEDMDc(THETA, alpha=0.1).fit(D1),
    "LASSO": lambda: LinearEDMDc(THETA, alpha=0.1, penalty="lasso").fit(D1),
    "B-EDMDc": lambda: BilinearEDMDc(THETA, alpha=0.1).fit(D1),
    "PI-EDMDc": lambda: PIEDMDc(THETA, alpha=0.1).fit(D1, D2),
    "twin": lambda: TwinEDMDc(THETA, alpha=0.1).fit(D1, D1),
    "stream": lambda: StreamingEDMDc(THETA, alpha=0.1).update(D1),
    "model": lambda: PIEDMDc(THETA, alpha=0.1).fit(D1, D2).lifted,
}


@pytest.mark.parametrize("name", MADE)
def test_copies_and_pickles_give_the_same_numbers(name: str) -> None:
    held = MADE[name]()
    unused = pickle.dumps(held)
    truth = numbers(held)
    for other in (copy.copy(held), copy.deepcopy(held), pickle.loads(unused), pickle.loads(pickle.dumps(held))):
        assert numbers(other) == truth
        assert numbers(pickle.loads(pickle.dumps(other))) == truth


@pytest.mark.parametrize("name", ["episodes", "phase samples", "dictionary", "dictionary with products", "model"])
def test_files_give_the_same_numbers_and_the_same_file(name: str, tmp_path: Path) -> None:
    held = MADE[name]()
    held.save(tmp_path / "one.h5")
    loaded = type(held).load(tmp_path / "one.h5")
    assert numbers(loaded) == numbers(held)
    loaded.save(tmp_path / "two.h5")
    assert (tmp_path / "one.h5").read_bytes() == (tmp_path / "two.h5").read_bytes()


OTHER_PROCESS = """
import pickle, sys
import numpy as np
made = pickle.load(open(sys.argv[1], "rb"))
theta, estimator, d1 = made["theta"], made["estimator"], made["d1"]
refitted = type(estimator)(theta, alpha=0.1).fit(d1).lifted
pickle.dump([estimator.lifted.A, refitted.A, refitted.state_names], open(sys.argv[2], "wb"))
"""


def test_another_process_fits_the_same_model(tmp_path: Path) -> None:
    """A dictionary with a lambda takes names and quantities from the data there too: they decide the scaling."""
    d1 = Episodes(XS, US, 0.1, state_names=("tip x", "tip y"), quantities=("p", "p"))
    estimator = LinearEDMDc(THETA, alpha=0.1).fit(d1)
    sent, got = tmp_path / "sent", tmp_path / "got"
    sent.write_bytes(pickle.dumps({"theta": THETA, "estimator": estimator, "d1": d1}))
    subprocess.run([sys.executable, "-c", OTHER_PROCESS, str(sent), str(got)], check=True)
    fitted, refitted, names = pickle.loads(got.read_bytes())
    assert fitted.tobytes() == refitted.tobytes() == estimator.lifted.A.tobytes() and names == ("tip x", "tip y")


def test_an_expression_from_elsewhere_knows_the_sizes_it_has_met() -> None:
    expression = ob.Expression(lambda x, u: x[0] ** 2, name="q")
    Dictionary(ob.Identity(), expression, n_states=2, n_inputs=1)
    assert copy.deepcopy(expression).function is expression.function
    travelled = pickle.loads(pickle.dumps(expression))
    Dictionary(ob.Identity(), travelled, n_states=2, n_inputs=1)
    with pytest.raises(ValueError, match=r"asked for 3 states and 1 inputs; it knows \[\(2, 1\)\]") as error:
        Dictionary(ob.Identity(), travelled, n_states=3, n_inputs=1)
    assert "\n" not in str(error.value)


def test_verification_costs_little(tmp_path: Path) -> None:
    """At least 100 MB/s on any machine; with SHA instructions it is ten times that."""
    with store.writing(tmp_path / "large.h5", "pisplit/test") as file:
        file["x"] = np.zeros(4_000_000)
    began = time.process_time()
    with store.reading(tmp_path / "large.h5", "pisplit/test") as file:
        assert file["x"].shape == (4_000_000,)
    assert time.process_time() - began < 0.32
