"""The whole chain once, at small size; every link against an independent computation.

A planar arm with two tendons: symbolic rod -> IDAS recordings -> Jacobians of the observables -> gEDMD -> K_f ->
LASSO by cvxpy -> Strang splitting -> OSQP loop on the rod.
"""

from __future__ import annotations

from types import SimpleNamespace

import casadi as ca
import cvxpy as cp
import numpy as np
import pytest
import scipy.linalg
from scipy.integrate import solve_ivp

from pisplit import Dictionary, Episodes, PhaseSamples, PIEDMDc, generator_edmd, half_step
from pisplit import observables as ob
from pisplit.controllers import MPC, ClosedLoop, PlantStep, references
from pisplit.models import rod
from pisplit.models.rod_system import rod_system

DT, STEPS, ALPHA = 0.02, 60, 0.05
TENSION = 0.15  # N: the tip goes some centimetres


@pytest.fixture(scope="module")
def chain() -> SimpleNamespace:
    """Everything that is made on the way, by the package."""
    scene = rod.Scene(
        rod.Rod(0.3, rod.Circle(4e-3), rod.Elastic(young=1e6, shear=4e5, density=1100.0), strains="planar"),
        rod.Gravity((0.0, 0.0, 9.81)),
        rod.KelvinVoigt(bending=5e-6, torsion=5e-6),
        rod.Tendons.parallel(offset=6e-3, angles_deg=(0, 180), drive=rod.Tension()),
        nodes=2,
    )
    system, n = rod_system(scene), scene.n_strains
    rng = np.random.default_rng(0)
    rest = scene.statics().solve(np.zeros(2)).state
    pulls = [np.repeat(TENSION * rng.uniform(0.0, 1.0, (STEPS // 5, 2)), 5, axis=0) for _ in range(8)]
    simulator = scene.simulator(dt=DT, rtol=1e-7, inputs="step")
    runs = [simulator.run(u, np.concatenate([rest[: 2 * n], u[0]]), check=False) for u in pulls]
    assert all(run.success for run in runs)
    labels = {"state_names": system.state_names, "input_names": system.input_names}
    d1 = Episodes([run.x[:, : 2 * n] for run in runs], pulls, DT, quantities=["w"] * n + ["w_t"] * n, **labels)
    spread = d1.stacked_states().std(axis=0)
    x2 = rest[: 2 * n] + spread * rng.standard_normal((400, 2 * n))
    d2 = PhaseSamples.from_system(system, x2, np.zeros((400, 2)))
    theta = Dictionary(ob.Identity(), n_states=2 * n, n_inputs=2).named_after(d1)
    model = PIEDMDc(
        theta,
        alpha=ALPHA,
        penalty="lasso",
        solver="cvxpy",
        toward="identity",
        half_step="generator",
        scale=None,
        relative=False,
    ).fit(d1, d2)
    return SimpleNamespace(**{k: v for k, v in locals().items() if k not in ("rng", "labels")})


def test_recordings_are_solutions_of_the_rod(chain: SimpleNamespace) -> None:
    """IDAS on the implicit balance against scipy's Radau on the explicit accelerations."""
    acceleration, n = chain.scene.acceleration, chain.n
    x, size = chain.d1.xs[0][0], np.abs(chain.d1.xs[0]).max(axis=0)
    for k in range(10):

        def rate(t: float, y: np.ndarray, u: np.ndarray = chain.pulls[0][k]) -> np.ndarray:
            return np.concatenate([y[n:], np.asarray(acceleration(y[:n], y[n:], u)).ravel()])

        x = solve_ivp(rate, (0.0, DT), x, method="Radau", rtol=1e-8, atol=1e-10).y[:, -1]
        np.testing.assert_allclose(chain.d1.xs[0][k + 1] / size, x / size, atol=2e-4)


def test_velocities_of_the_known_part_are_those_of_the_arm_without_tendons(chain: SimpleNamespace) -> None:
    passive = chain.scene.without(rod.Tendons)
    x = chain.d2.x[3]
    expected = np.asarray(passive.acceleration(x[: chain.n], x[chain.n :], [])).ravel()
    np.testing.assert_allclose(chain.d2.xdot[3], [*x[chain.n :], *expected], rtol=1e-9)


def test_jacobians_of_the_observables_are_difference_quotients(chain: SimpleNamespace) -> None:
    """Eq. jacob_solve with a dictionary that is not linear."""
    theta = Dictionary(
        ob.Constant(),
        ob.Identity(),
        ob.Expression(lambda x, u: ca.sin(x[0]) * x[3] ** 2, name="product"),
        n_states=4,
        n_inputs=2,
    )
    x, u, f = chain.d2.x[:5], chain.d2.u[:5], chain.d2.xdot[:5]
    h = 1e-6 / np.abs(f).max()
    quotient = (theta.evaluate_static(x + h * f, u) - theta.evaluate_static(x - h * f, u)) / (2.0 * h)
    exact = theta.lie_derivative(x, u, f)
    np.testing.assert_allclose(exact, quotient, atol=1e-6 * np.abs(exact).max())


def test_the_generator_is_the_least_squares_answer(chain: SimpleNamespace) -> None:
    """Eq. cont_koopman_solve by numpy on the plain data matrices."""
    theta, d2 = chain.theta, chain.d2
    found = generator_edmd(theta, d2, np.ones(theta.n_columns))
    columns, target = d2.x, d2.xdot  # inputs do not act on f
    expected = np.linalg.lstsq(columns, target, rcond=None)[0].T
    np.testing.assert_allclose(found[:4, :4], expected, rtol=1e-6, atol=1e-8 * np.abs(expected).max())
    assert not found[4:].any()


def test_the_half_step_is_the_exponential_of_the_generator(chain: SimpleNamespace) -> None:
    """Eq. matrix_exp: by eigenvectors here, by scaling and squaring there."""
    theta = chain.theta
    generator = generator_edmd(theta, chain.d2, np.ones(theta.n_columns))
    half = half_step(theta, chain.d2, DT, np.ones(theta.n_columns), "generator")
    values, vectors = np.linalg.eig(generator[:4, :4])
    expected = (vectors * np.exp(0.5 * DT * values)) @ np.linalg.inv(vectors)
    np.testing.assert_allclose(half.K[:4, :4], expected.real, atol=1e-7 * np.abs(expected).max())


def test_k_h_is_the_lasso_answer_of_the_printed_problem(chain: SimpleNamespace) -> None:
    """Eq. full_kth with |K_h - I|_1: zero lies in the subdifferential, entry by entry."""
    theta, d1, d2 = chain.theta, chain.d1, chain.d2
    generator = generator_edmd(theta, d2, np.ones(6))
    half = scipy.linalg.expm(0.5 * DT * generator)
    x = np.concatenate([x[:-1] for x in d1.xs])
    y = np.concatenate([x[1:] for x in d1.xs])
    columns = np.hstack([x, np.concatenate(d1.us)])
    k = np.vstack([chain.model.K_, np.eye(6)[4:]])
    k_h = np.linalg.solve(half, k) @ np.linalg.inv(half)
    regressors = columns @ half.T
    target = np.linalg.solve(half, np.hstack([y, np.concatenate(d1.us)]).T).T[:, :4]
    slope = 2.0 * (regressors @ k_h[:4].T - target).T @ regressors  # of the squared residual
    change = k_h[:4] - np.eye(6)[:4]
    moved = np.abs(change) > 1e-7
    assert 0 < moved.sum() < moved.size  # sparse, and not without effect
    np.testing.assert_allclose(slope[moved], -ALPHA * np.sign(change[moved]), rtol=2e-3, atol=2e-3 * ALPHA)
    assert np.abs(slope[~moved]).max() <= ALPHA * (1.0 + 1e-3)


def test_the_model_is_the_strang_product(chain: SimpleNamespace) -> None:
    """Eq. koopman_strang_splitting: A and B of the lifted model are blocks of K_f K_h K_f."""
    lifted = chain.model.lifted
    np.testing.assert_allclose(np.hstack([lifted.A, lifted.B]), chain.model.K_, atol=1e-12)
    x = chain.d1.xs[0]
    rolled = lifted.predict(x[0], None, chain.d1.us[0])
    z = x[0]
    for k, u in enumerate(chain.d1.us[0]):
        z = chain.model.K_ @ np.concatenate([z, u])
        np.testing.assert_allclose(rolled.x[k + 1], z, rtol=1e-9, atol=1e-9)


class Plant:
    """The simulated rod, of which the controller sees strains and rates."""

    dt, n_inputs, n_states = DT, 2, 4

    def __init__(self, scene: rod.Scene) -> None:
        self.simulator = scene.simulator(dt=DT, inputs="step")
        self.scene = scene

    def reset(self, u0: np.ndarray | None = None) -> np.ndarray:
        self.state = self.simulator.scene.statics().solve(np.zeros(2) if u0 is None else u0).state
        return self.state[:4]

    def step(self, u: np.ndarray) -> PlantStep:
        run = self.simulator.run(np.atleast_2d(u), np.concatenate([self.state[:4], u]))
        self.state = run.x[-1]
        return PlantStep(self.state[:4], ok=run.success)


def test_moves_of_the_loop_are_exact_solutions_of_the_qp_and_steer_the_rod(chain: SimpleNamespace) -> None:
    lifted, horizon, rate = chain.model.lifted, 15, 0.05
    limits = {"u_min": 0.0, "u_max": TENSION, "du_max": 0.02}
    mpc = MPC(lifted, horizon, **limits, track=[1], rate_weight=rate, output_scale=0.5, estimator_gain=0.3)
    plant = Plant(chain.scene)
    start = plant.reset(np.zeros(2))
    goal = 0.4 * chain.d1.stacked_states()[:, 1].max()
    # The first move by cvxpy, from A, B, C alone.
    u, z, cost = cp.Variable((horizon, 2)), lifted.lift(start), 0.0
    previous, rules = np.zeros(2), [u >= 0.0, u <= TENSION]
    for j in range(horizon):
        z = lifted.A @ z + lifted.B @ u[j] + lifted.c
        cost += cp.sum_squares((lifted.C[1] @ z + lifted.d[1] - goal) / 0.5)
        cost += rate * cp.sum_squares((u[j] - previous) / (0.5 * TENSION))
        rules.append(cp.abs(u[j] - previous) <= 0.02)
        previous = u[j]
    cp.Problem(cp.Minimize(cost), rules).solve(solver=cp.CLARABEL)
    mpc.reset(np.zeros(2))
    move = mpc.step(start, np.full((horizon, 1), goal))
    np.testing.assert_allclose(move.u, u.value[0], atol=5e-3 * TENSION)

    log = ClosedLoop(plant, mpc).run(references.from_array(np.full((101, 1), goal), DT), 100, progress=False)
    assert not log.stopped and log.limit_violations == 0
    error = np.abs(log.x[:, 1] - goal)
    assert error[-20:].max() <= 0.02 * error[0]
