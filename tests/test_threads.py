"""One object used by several threads gives the numbers that one thread gets."""

from __future__ import annotations

import copy
import pickle
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from pisplit import Dictionary, Episodes, LiftedModel, LinearEDMDc
from pisplit import observables as ob
from pisplit.mapping import Mapped

RNG = np.random.default_rng(8)


@pytest.fixture(autouse=True)
def impatient_threads() -> Iterator[None]:
    """Threads take turns every few microseconds, so that one shared buffer shows within a few hundred calls."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


def differing(function: Callable[[Any], NDArray[np.float64]], arguments: Sequence[Any], rounds: int = 8) -> int:
    """How many results of four threads differ from those of one."""
    truth = [function(argument) for argument in arguments]
    with ThreadPoolExecutor(4) as pool:
        found = [list(pool.map(function, arguments)) for _ in range(rounds)]
    return sum(not np.array_equal(a, b) for results in found for a, b in zip(results, truth, strict=True))


@pytest.fixture(scope="module")
def model() -> LiftedModel:
    data = Episodes([RNG.normal(size=(81, 2))], [RNG.normal(size=(80, 1))], 0.1)
    theta = Dictionary(ob.Constant(), ob.Identity(), ob.Polynomials(3), ob.Slack(width=0.1), n_states=2, n_inputs=1)
    return LinearEDMDc(theta, alpha=1e-6).fit(data).lifted


@pytest.mark.parametrize(
    "what",
    [
        lambda model, x: model.lift(x),
        lambda model, x: model.features(x[:, None]),
        lambda model, x: model.feature_jacobian(x[:, None]),
        lambda model, x: model.step(model.lift(x), x[:1]),
        lambda model, x: model.predict(x, None, x[:, None]).z,
    ],
    ids=["lift", "features", "feature_jacobian", "step", "predict"],
)
def test_a_model_may_be_shared(model: LiftedModel, what: Callable[..., NDArray[np.float64]]) -> None:
    assert differing(lambda x: what(model, x), list(RNG.uniform(-1, 1, (150, 2)))) == 0


def test_a_root_finder_may_be_shared() -> None:
    x, p = ca.MX.sym("x"), ca.MX.sym("p")
    root = ca.rootfinder("root", "newton", {"x": x, "p": p, "g": x**3 + x - p})
    mapped = Mapped(ca.Function("solved", [p], [root(0.0, p)]))
    samples = [RNG.normal(size=(size, 1)) for size in (1, 2, 3) * 20]
    assert differing(mapped, samples) == 0
    solved = mapped(samples[2])
    np.testing.assert_allclose(solved**3 + solved, samples[2], atol=1e-9)


def test_a_failed_call_leaves_the_others_alone_and_copies_share_nothing() -> None:
    x, p = ca.MX.sym("x"), ca.MX.sym("p")
    root = ca.rootfinder("root", "newton", {"x": x, "p": p, "g": x**2 - p})
    mapped = Mapped(ca.Function("solved", [p], [root(0.5, p)]))
    with pytest.raises(ValueError, match="samples 0 to 0"):
        mapped(np.array([[-1.0]]))
    for same in (mapped, copy.deepcopy(mapped), pickle.loads(pickle.dumps(mapped))):
        np.testing.assert_allclose(same(np.array([[4.0]])), [[2.0]])
