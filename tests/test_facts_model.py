"""Facts of lifted models: when a model is affine, which modes last, where a roll-out is held."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from pisplit import Dictionary, Episodes, LiftedModel, LinearEDMDc, PhaseSamples, modes
from pisplit import observables as ob
from pisplit.generator import generator_edmd, half_step
from pisplit.lifted.formats import _labels, state_space_matrices
from pisplit.lifted.operators import excited_inputs


def model(a: np.ndarray, c: np.ndarray | None = None, d: np.ndarray | None = None, reach: float = 1.0) -> LiftedModel:
    n = len(a)
    x, past, u = ca.SX.sym("x", n), ca.SX.sym("v", 1, 0), ca.SX.sym("u")
    names = tuple(f"x{i}" for i in range(n))
    return LiftedModel(
        A=a,
        B=np.ones((n, 1)),
        c=np.zeros(n) if c is None else c,
        C=np.eye(n),
        d=np.zeros(n) if d is None else d,
        dt=0.1,
        lift_function=ca.Function("lift", [x, past], [x]),
        input_function=ca.Function("phi", [u], [u]),
        n_delays=0,
        state_names=names,
        input_names=("u",),
        column_names=names,
        feature_names=("u",),
        input_offset=np.zeros(1),
        input_basis=np.eye(1),
        state_range=np.full(n, reach),
    )


@pytest.mark.parametrize("where", ["c", "d"])
def test_one_affine_entry_makes_the_input_of_ones(where: str) -> None:
    plain = model(0.5 * np.eye(2))
    affine = model(0.5 * np.eye(2), **{where: np.array([0.0, 0.3])})
    assert state_space_matrices(plain)[-1] == ("u",)
    a, b, c, d, names = state_space_matrices(affine)
    assert names == ("u", "1")
    z, u = np.array([0.2, -0.1]), np.array([0.4])
    assert a @ z + b @ [0.4, 1.0] == pytest.approx(affine.step(z, u))
    assert c @ z + d @ [0.4, 1.0] == pytest.approx(affine.C @ z + affine.d)


def test_damping_of_what_stays_falls_and_vanishes() -> None:
    """Eigenvalues 1 (stays), 0 (gone at once), exp(-0.1 zeta w +- i 0.1 w sqrt(1 - zeta^2)) (swings), 0.5 (creeps)."""
    w, zeta = 3.0, 0.2
    rate = complex(-zeta * w, w * np.sqrt(1.0 - zeta**2))
    swing = np.exp(0.1 * rate)
    a = np.zeros((5, 5))
    a[0, 0], a[3, 3] = 1.0, 0.5
    a[1:3, 1:3] = [[swing.real, swing.imag], [-swing.imag, swing.real]]
    found = modes(model(a))
    by_value = {complex(np.round(v, 9)): i for i, v in enumerate(found.eigenvalues)}
    stays, gone, creeps = by_value[1.0 + 0j], by_value[0j], by_value[0.5 + 0j]
    assert found.rates[stays] == 0.0 and found.damping[stays] == 0.0 and np.isinf(found.time_constants[stays])
    assert found.rates[gone].real == -np.inf and found.damping[gone] == 1.0 and found.time_constants[gone] == 0.0
    assert found.rates[creeps] == pytest.approx(np.log(0.5) / 0.1) and found.damping[creeps] == pytest.approx(1.0)
    swings = [i for i, v in enumerate(found.eigenvalues) if abs(v.imag) > 0.1]
    assert found.damping[swings] == pytest.approx(zeta) and found.frequencies[swings] == pytest.approx(
        w * np.sqrt(1.0 - zeta**2) / (2.0 * np.pi)
    )


@pytest.mark.parametrize("growth", [3.0, 1e7])
def test_a_roll_out_is_held_at_the_last_state_before_it_diverges(growth: float) -> None:
    grown = model(np.array([[growth]]))
    found = grown.rollout(np.array([1.0]), np.zeros((12, 1)))
    first = next(k for k in range(13) if growth**k > 1e3)
    assert found.diverged and found.diverged_at == first
    assert found.x[:first, 0] == pytest.approx(growth ** np.arange(first))
    assert np.all(found.x[first:, 0] == found.x[first - 1, 0])


def test_a_start_outside_the_range_diverges_at_once() -> None:
    found = model(np.array([[0.5]])).rollout(np.array([[2e3], [1.0]]), np.zeros((2, 4, 1)))
    assert np.asarray(found.diverged_at).tolist() == [0, -1]
    assert np.all(found.x[0, :, 0] == 2e3) and found.x[1, -1, 0] == pytest.approx(0.5**4)


@pytest.mark.parametrize("varied", [False, True])
def test_inputs_that_vary_by_rounding_are_not_excited(varied: bool) -> None:
    rng = np.random.default_rng(0)
    u = 1e3 / 3.0 * (1.0 + 4.0 * np.finfo(float).eps * rng.choice([-1.0, 1.0], size=(400, 2)))
    if varied:
        u[:, 1] += rng.normal(size=400)
    x = rng.normal(size=(401, 1))
    found = excited_inputs(Episodes([x], [u], 0.1).pairs())
    mean, basis = found.offset, found.basis
    assert mean == pytest.approx(1e3 / 3.0, rel=1e-2) and basis.shape == (2, int(varied))
    if varied:
        assert np.abs(basis[:, 0]) == pytest.approx([0.0, 1.0], abs=1e-9)


def test_features_that_saturate_are_not_the_inputs() -> None:
    """Inputs up to ten pass unchanged: only a large probe tells."""
    plain = model(0.5 * np.eye(2))
    u = ca.SX.sym("u")
    clipped = replace(plain, input_function=ca.Function("phi", [u], [ca.fmin(ca.fmax(u, -10.0), 10.0)]))
    assert plain.linear_in_u and not clipped.linear_in_u


def test_outputs_are_c_z_and_d_also_where_c_nearly_takes_states() -> None:
    z = np.array([0.3, -0.2])
    for c, d in ((np.eye(2), [0.0, 0.0]), (np.eye(2), [0.5, 0.0]), (np.array([[1.0, 0.0], [1.0, 1.0]]), [0.0, 0.0])):
        made = replace(model(0.5 * np.eye(2), d=np.array(d)), C=c)
        assert made.predict(z, np.zeros((0, 1)), np.zeros((1, 1))).x[1] == pytest.approx(c @ (0.5 * z) + d)


def test_labels_that_collide_count_upwards() -> None:
    assert _labels(["x[k-1]", "x(k-1)", "x{k-1}", "y"], {}) == [
        "x_k_minus_1",
        "x_k_minus_1_2",
        "x_k_minus_1_3",
        "y",
    ]


def test_phase_samples_of_another_system_are_refused_by_the_generator() -> None:
    theta = Dictionary(ob.Identity(), n_states=2, n_inputs=1)
    samples = PhaseSamples(x=np.ones((4, 3)), u=np.zeros((4, 1)), xdot=np.ones((4, 3)))
    with pytest.raises(ValueError, match="phase samples have 3 states and 1 inputs; the dictionary expects 2 and 1"):
        half_step(theta, samples, 0.5, np.ones(3), "generator")
    with pytest.raises(ValueError, match="phase samples have 3 states and 1 inputs; the dictionary expects 2 and 1"):
        generator_edmd(theta, samples, np.ones(3))


def test_an_output_is_of_states_that_are_there() -> None:
    known = model(np.diag([0.5, 0.9]))
    assert replace(known, outputs={"last": (1,)}).outputs == {"last": (1,)}
    with pytest.raises(ValueError, match=r"expected state indices from 0 to 1"):
        replace(known, outputs={"beyond": (2,)})


def test_a_read_out_does_not_depend_on_how_often_the_same_is_recorded() -> None:
    rng = np.random.default_rng(2)
    x = np.cumsum(rng.normal(size=(40, 1)), axis=0)
    twice = [ob.Expression(lambda x, u, k=k: ca.sin(x) + 1e-6 * k * ca.cos(x), name=f"s{k}") for k in range(2)]
    theta = Dictionary(*twice, n_states=1, n_inputs=1)  # all but collinear: the ridge of the read-out matters
    runs = [Episodes([x] * n, [np.zeros((39, 1))] * n, 0.1) for n in (1, 400)]
    once, often = (LinearEDMDc(theta, 1e-3).fit(data).lifted.C for data in runs)
    np.testing.assert_allclose(often, once, rtol=1e-6)


def test_a_fixed_point_is_found_where_states_drive_one_another_in_a_chain() -> None:
    a = np.array([[0.2, 0.0, 0.0], [3.0, 0.5, 0.0], [1.0, 40.0, 0.9]])
    known = model(a, c=np.array([0.1, 0.0, 0.3]))
    z = known.fixed_point([0.5])
    np.testing.assert_allclose(known.step(z, [0.5]), z, rtol=1e-12)


def test_states_that_are_multiples_of_columns_are_read_as_such() -> None:
    known = replace(model(np.diag([0.5, 0.9])), C=2.0 * np.eye(2))
    found = known.rollout([0.1, 0.2], np.zeros((3, 1)))
    np.testing.assert_allclose(found.x, 2.0 * found.z, rtol=1e-15)
