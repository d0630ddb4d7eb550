"""The known half step: exact where the dictionary is closed under f, and honest where it is not."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from pisplit import Dictionary, PhaseSamples
from pisplit import observables as ob
from pisplit.generator import flow_map, generator_edmd, half_step
from pisplit.models import systems

RNG = np.random.default_rng(2)
MU, LAM = -0.1, -1.0


def slow_manifold_samples(n: int = 60, flow: bool = False) -> PhaseSamples:
    system = systems.slow_manifold(mu=MU, lam=LAM)
    x, u = RNG.uniform(-1, 1, (n, 2)), RNG.uniform(-1, 1, (n, 1))
    return PhaseSamples.from_system(system, x, u, dt=0.2, flow=flow)


def closed_dictionary(*more: ob.Observable | ob.Delays) -> Dictionary:
    square = ob.Expression(lambda x, u: x[0] ** 2, name="x1^2")
    return Dictionary(ob.Constant(), ob.Identity(), square, *more, n_states=2, n_inputs=1)


def test_the_generator_of_an_invariant_dictionary_is_exact() -> None:
    theta = closed_dictionary()
    exact = np.zeros((5, 5))  # columns 1, x1, x2, x1^2, u
    exact[1, 1], exact[2, 2], exact[2, 3], exact[3, 3] = MU, LAM, -LAM, 2 * MU
    found = generator_edmd(theta, slow_manifold_samples(), np.ones(5))
    np.testing.assert_allclose(found, exact, atol=1e-12)


def test_scaled_columns_give_a_similar_generator() -> None:
    theta, samples = closed_dictionary(), slow_manifold_samples()
    scale = np.array([1.0, 3.0, 0.01, 5.0, 2.0])
    plain, scaled = generator_edmd(theta, samples, np.ones(5)), generator_edmd(theta, samples, scale)
    np.testing.assert_allclose(scaled * scale[:, None] / scale, plain, atol=1e-10)


def test_delays_and_inputs_do_not_move_in_a_half_step() -> None:
    theta = closed_dictionary(ob.Delays(states=2, inputs=1))
    half = half_step(theta, slow_manifold_samples(), 0.2, np.ones(theta.n_columns), "generator")
    delayed = np.arange(theta.n_present, theta.n_columns)
    np.testing.assert_array_equal(half.K[delayed], np.eye(theta.n_columns)[delayed])
    np.testing.assert_allclose(half.K[: theta.n_present, delayed], 0, atol=1e-12)


def test_the_half_step_of_a_linear_system_is_its_exponential() -> None:
    a = RNG.normal(size=(3, 3))
    x = RNG.normal(size=(20, 3))
    samples = PhaseSamples(x, np.zeros((20, 2)), x @ a.T)
    half = half_step(Dictionary(ob.Identity(), n_states=3, n_inputs=2), samples, 0.1, np.ones(5), "generator")
    np.testing.assert_allclose(half.K[:3, :3], scipy.linalg.expm(0.05 * a), atol=1e-12)
    assert half.max_real == pytest.approx(max(np.linalg.eigvals(a).real.max(), 0.0))


def test_generator_and_flow_agree_on_an_invariant_dictionary() -> None:
    theta, samples = closed_dictionary(), slow_manifold_samples(flow=True)
    by_generator = half_step(theta, samples, 0.2, np.ones(5), "generator")
    by_flow = half_step(theta, samples, 0.2, np.ones(5), "flow")
    np.testing.assert_allclose(by_flow.K, by_generator.K, atol=1e-9)


def test_an_input_that_never_varies_gets_no_column() -> None:
    x = RNG.normal(size=(30, 2))
    samples = PhaseSamples(x, np.full((30, 1), 0.3), np.column_stack([x[:, 1], 1.0 - x[:, 0]]))
    found = generator_edmd(Dictionary(ob.Constant(), ob.Identity(), n_states=2, n_inputs=1), samples, np.ones(4))
    np.testing.assert_allclose(found[1:3], [[0, 0, 1, 0], [1, -1, 0, 0]], atol=1e-12)


def test_auto_takes_the_flow_when_the_generator_is_spurious_and_says_why() -> None:
    # The flow decays as exp(-t), while the derivatives are wrong: they make the half step grow by exp(1).
    x = RNG.normal(size=(20, 1))
    theta = Dictionary(ob.Identity(), n_states=1, n_inputs=1)
    with_flow = PhaseSamples(x, 0 * x, 4.0 * x, x_half=np.exp(-0.25) * x, dt=0.5)
    half = half_step(theta, with_flow, 0.5, np.ones(2), "auto")
    assert half.kind == "flow" and "grows by 2.72" in half.reason
    np.testing.assert_allclose(half.K[0, 0], np.exp(-0.25))
    with pytest.warns(UserWarning, match="no flow"):
        assert half_step(theta, PhaseSamples(x, 0 * x, 4.0 * x), 0.5, np.ones(2), "auto").kind == "generator"


def test_auto_keeps_a_sound_generator() -> None:
    half = half_step(closed_dictionary(), slow_manifold_samples(flow=True), 0.2, np.ones(5), "auto")
    assert half.kind == "generator" and half.growth == pytest.approx(1.0)


def test_a_singular_half_step_is_announced() -> None:
    x = RNG.normal(size=(20, 2))
    samples = PhaseSamples(x, np.zeros((20, 1)), x * np.array([-1e4, -1.0]))
    theta = Dictionary(ob.Identity(), n_states=2, n_inputs=1)
    with pytest.warns(UserWarning, match="cond.* or else penalty='ridge'"):
        half_step(theta, samples, 0.1, np.ones(3), "generator")
    with pytest.warns(UserWarning, match="use split='hold'$"):  # a ridge that is on is not advised
        half_step(theta, samples, 0.1, np.ones(3), "generator", inverted=False)


def test_flows_of_the_wrong_step_and_wrong_sizes_are_refused() -> None:
    theta = closed_dictionary()
    with pytest.raises(ValueError, match="needs phase samples with x_half"):
        flow_map(theta, slow_manifold_samples(), 0.2, np.ones(5))
    with pytest.raises(ValueError, match="dt"):
        flow_map(theta, slow_manifold_samples(flow=True), 0.1, np.ones(5))
    with pytest.raises(ValueError, match="the dictionary expects"):
        half_step(theta, PhaseSamples(np.zeros((2, 3)), np.zeros((2, 1)), np.zeros((2, 3))), 0.2, np.ones(5))
    with pytest.raises(ValueError, match="half_step"):
        half_step(theta, slow_manifold_samples(), 0.2, np.ones(5), "euler")


def test_a_half_step_that_overflows_is_refused_or_gives_way_to_the_flow() -> None:
    x = np.random.default_rng(0).normal(size=(30, 1))
    theta = Dictionary(ob.States(), n_states=1, n_inputs=1)
    stiff = PhaseSamples(x, np.zeros((30, 1)), 1e6 * x)
    with pytest.raises(ValueError, match=r"overflows: it has eigenvalues up to 1\.0e\+06 1/s") as found:
        half_step(theta, stiff, 0.1, np.ones(1))
    assert "\n" not in str(found.value)
    moved = half_step(theta, PhaseSamples(x, np.zeros((30, 1)), 1e6 * x, x_half=0.5 * x, dt=0.1), 0.1, np.ones(1))
    assert moved.kind == "flow"
    assert "overflows" in moved.reason
    np.testing.assert_allclose(moved.K, [[0.5]], atol=1e-12)


@pytest.mark.parametrize("held", [-0.3, 0.3])
def test_an_input_that_only_rounds_says_nothing_of_its_effect(held: float) -> None:
    x = RNG.uniform(-1, 1, (40, 2))
    u = held + 1e-12 * RNG.integers(-1, 2, (40, 1))
    samples = PhaseSamples(x, u, np.column_stack([-x[:, 0] + 2.0 * u[:, 0], x[:, 0] - x[:, 1]]))
    found = generator_edmd(Dictionary(ob.Identity(), n_states=2, n_inputs=1), samples, np.ones(3))
    np.testing.assert_array_equal(found[:, 2], 0.0)


def test_a_tiny_input_that_varies_is_no_constant() -> None:
    x, u = RNG.uniform(-1, 1, (40, 1)), 1e-11 * RNG.uniform(-1, 1, (40, 1))
    theta = Dictionary(ob.Constant(), ob.Identity(), n_states=1, n_inputs=1)
    found = generator_edmd(theta, PhaseSamples(x, u, 1e11 * u - x), np.ones(3))
    np.testing.assert_allclose(found[1], [0.0, -1.0, 1e11], rtol=1e-6, atol=1e-9)
