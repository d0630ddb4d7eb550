"""Options of the estimators: those that do not exist, or would have no effect, are refused at construction."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

from pisplit import (
    BilinearEDMDc,
    Dictionary,
    Episodes,
    LinearEDMDc,
    PhaseSamples,
    PIEDMDc,
    StreamingEDMDc,
    TwinEDMDc,
)
from pisplit import observables as ob
from pisplit.models import systems

PLAIN = Dictionary(ob.Constant(), ob.Identity(), n_states=2, n_inputs=1)
EQUILIBRIUM = {"equilibrium": np.array([[1.0], [0.0]])}


@pytest.mark.parametrize("estimator", [LinearEDMDc, BilinearEDMDc, PIEDMDc, TwinEDMDc])
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"alpha": "CV"}, "alpha = 'CV'; expected a number of at least zero, or 'cv'"),
        ({"alpha": None}, "alpha = None"),
        ({"alpha": -1.0}, "alpha = -1"),
        ({"scale": "qty"}, "scale = 'qty'; expected one of"),
        ({"alphas": "abc"}, "alphas = 'abc'; expected numbers"),
        ({"alphas": []}, "at least one"),
        ({"alphas": [1.0, -1.0]}, r"alphas\[1\] = -1"),
        ({"alphas": [np.nan]}, r"alphas\[0\] = nan"),
        ({"cv_tolerance": -0.1}, "cv_tolerance"),
        ({"cv_states": 3.0}, "cv_states"),
        ({"max_radius": 0.0}, "max_radius"),
        ({"theta": np.eye(2)}, "theta is a ndarray; expected a Dictionary"),
    ],
)
def test_options_of_every_estimator_are_checked_when_it_is_made(
    estimator: Any, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message) as error:
        estimator(**{"theta": PLAIN, **options})
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rows": "input"}, "rows = 'input'; expected None, 'inputs'"),
        ({"rows": []}, "rows is empty"),
        ({"rows": [1, 2]}, r"rows = \[1, 2\]"),
        ({"rows": {"x1": -1.0}}, "weight of rows"),
        ({"options": {"typo": 3}}, "split='strang' takes no options; got 'typo'"),
        ({"split": "lie", "options": EQUILIBRIUM}, "split='lie' takes no options"),
        ({"split": "hold", "options": {"port": np.eye(2)}}, "options of split='hold' are .*; got 'port'"),
        ({"split": "hold", "half_step": "flow"}, "half_step='flow' is of Strang and Lie"),
        ({"split": "balanced", "half_step": "first-order"}, "half_step='first-order' is of Strang and Lie"),
        ({"split": "hold", "toward": "identity"}, "toward='identity'"),
        ({"split": "balanced", "rows": "inputs"}, "rows='inputs' has no effect"),
        ({"split": "hold", "rows": "inputs", "options": EQUILIBRIUM}, "rows='inputs' has no effect"),
        ({"split": "hold", "rows": ["x1"], "options": {"ports": np.eye(2)}}, "give one of them"),
        ({"split": "hold", "past": "equal"}, "past='equal'"),
        ({"past": "equal"}, "without delays"),
        ({"past": "none"}, "past = 'none'"),
        ({"generator_penalty": "lasso"}, "give generator_alpha"),
        ({"generator_penalty": "l1", "generator_alpha": 1.0}, "penalty = 'l1'"),
        ({"known_rows": {"x1": 1.0}}, "known rows are"),
        ({"known_rows": {"x1": {"x2": np.inf}}}, "coefficient of 'x2' in the known row 'x1'"),
        ({"known_rows": {"x1": {"x2": 1.0}}, "half_step": "flow"}, "half_step='flow' has none"),
    ],
)
def test_options_of_a_split_that_would_have_no_effect_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        PIEDMDc(PLAIN, **options)
    assert "\n" not in str(error.value)


def test_a_hold_split_in_which_f_has_no_effect_says_so() -> None:
    rng, system = np.random.default_rng(0), systems.duffing()
    d1 = Episodes.from_system(system, rng.uniform(-1, 1, (3, 2)), [rng.uniform(-1, 1, (20, 1)) for _ in range(3)], 0.1)
    x = rng.uniform(-1, 1, (50, 2))
    right, wrong = (PhaseSamples(x, np.zeros((50, 1)), v) for v in (np.column_stack([x[:, 1], -x[:, 0]]), 0.3 * x))
    free = [PIEDMDc(PLAIN, 1e6, "ridge", split="hold") for _ in range(2)]
    for model, d2 in zip(free, (right, wrong), strict=True):
        with pytest.warns(UserWarning, match="f has no effect on these data; say where h acts"):
            model.fit(d1, d2)
    np.testing.assert_allclose(free[0].K_, free[1].K_, atol=1e-6)  # whatever f is, h makes up for it
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        held = [PIEDMDc(PLAIN, 1e6, "ridge", split="hold", rows=["v"]).fit(d1, d2).K_ for d2 in (right, wrong)]
        few = [PIEDMDc(PLAIN, 1e6, "ridge", split="hold").fit(d1, d2, d1.pairs().take([3])).K_ for d2 in (right, wrong)]
    assert np.abs(held[0] - held[1]).max() > 1e-3 and np.abs(few[0] - few[1]).max() > 1e-3


@pytest.mark.parametrize(
    "estimator",
    [
        LinearEDMDc(PLAIN, alphas=np.logspace(-3, 0, 3), cv_states=["x1"]),
        BilinearEDMDc(PLAIN, "cv", "lasso", solver="cvxpy"),
        PIEDMDc(PLAIN, rows=["x2"], alphas=[0.1], known_rows={"x1": {"x2": 1.0}}, half_step="first-order"),
        PIEDMDc(PLAIN, split="hold", options={"ports": np.eye(2)}),
        TwinEDMDc(PLAIN, omit=["x1"]),
        StreamingEDMDc(PLAIN, 0.99, 1e-3),
    ],
)
def test_every_estimator_can_be_cloned(estimator: Any) -> None:
    clone = pytest.importorskip("sklearn.base").clone
    twin = clone(estimator)
    assert type(twin) is type(estimator) and twin is not estimator
    np.testing.assert_equal(twin.get_params(), estimator.get_params())
    assert twin.get_params()["theta"] is estimator.theta  # dictionaries are never changed
    with pytest.raises(ValueError, match="has no option 'alfa'"):
        twin.set_params(alfa=1.0)
    assert twin.set_params(alpha=0.5).alpha == 0.5
