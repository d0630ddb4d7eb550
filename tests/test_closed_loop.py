"""Controllers closed on small simulators: masses on springs, pulled by inputs that may saturate."""

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm

from pisplit.checks import Array
from pisplit.controllers import MPC, ClosedLoop, FeedForward, LoopLog, PlantStep, references
from pisplit.lifted.model import LiftedModel

DT = 0.03
STIFFNESS, DAMPING = 90.0, 1.5  # a lightly damped point of 1.5 Hz, like the tip of an arm
GAIN = 900.0  # 1 cm of pull moves the point by 10 cm


class PointOnSprings:
    """p'' = -k p - d p' + g h(u) + load in three coordinates, RK4; state (p, p'), or p alone."""

    def __init__(
        self,
        force: Callable[[Array], Array] = lambda u: u,
        load: float = 0.0,
        stiffness: float = STIFFNESS,
        positions_only: bool = False,
        fails_at: int | None = None,
    ) -> None:
        self.dt, self.n_inputs, self.n_states = DT, 3, 3 if positions_only else 6
        self._force, self._load, self._stiffness, self._fails_at = force, load, stiffness, fails_at
        self.reset()

    def reset(self, u0: Array | None = None) -> Array:
        u = np.zeros(3) if u0 is None else u0
        self._x = np.concatenate([(GAIN * self._force(u) + self._load) / self._stiffness, np.zeros(3)])
        self._steps = 0
        return self._x[: self.n_states].copy()

    def step(self, u: Array) -> PlantStep:
        def rate(x: Array) -> Array:
            pull = GAIN * self._force(u) + self._load
            return np.concatenate([x[3:], pull - self._stiffness * x[:3] - DAMPING * x[3:]])

        h, x = DT / 10, self._x
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(10):
                k1 = rate(x)
                k2 = rate(x + h / 2 * k1)
                k3 = rate(x + h / 2 * k2)
                k4 = rate(x + h * k3)
                x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        self._x, self._steps = x, self._steps + 1
        if self._steps == self._fails_at:
            return PlantStep(x[: self.n_states].copy(), ok=False, message="integrator failed")
        return PlantStep(x[: self.n_states].copy())


def discrete() -> tuple[Array, Array]:
    """Exact A (6, 6), B (6, 3) of the point under forces held over a step."""
    eye, zero = np.eye(3), np.zeros((3, 3))
    generator = np.block([[zero, eye, zero], [-STIFFNESS * eye, -DAMPING * eye, GAIN * eye], [zero, zero, zero]])
    joined = expm(DT * generator)
    return joined[:6, :6], joined[:6, 6:]


def lifted(A: Array, B: Array, n: int, phi: Callable[[ca.SX], ca.SX], delays: int = 0) -> LiftedModel:
    """LiftedModel of states (n,), with earlier states and inputs after them in z where there are delays."""
    x, v, u = ca.SX.sym("x", n, delays + 1), ca.SX.sym("v", 3, delays), ca.SX.sym("u", 3)
    z = ca.vertcat(*[x[:, delays - i] for i in range(delays + 1)], *[v[:, delays - 1 - i] for i in range(delays)])
    return LiftedModel(
        A=A,
        B=B,
        c=np.zeros(len(A)),
        C=np.eye(n, len(A)),
        d=np.zeros(n),
        dt=DT,
        lift_function=ca.Function("lift", [x, v], [z]),
        input_function=ca.Function("phi", [u], [phi(u)]),
        n_delays=delays,
        state_names=tuple(f"x{i}" for i in range(n)),
        input_names=("u1", "u2", "u3"),
        column_names=tuple(f"z{i}" for i in range(len(A))),
        feature_names=tuple(f"f{i}" for i in range(B.shape[1])),
        input_offset=np.zeros(3),
        input_basis=np.eye(3),
        state_range=np.full(n, 0.3),
        outputs={"tip": (0, 1, 2)},
    )


def point_model(phi: Callable[[ca.SX], ca.SX] = lambda u: u) -> LiftedModel:
    A, B = discrete()
    return lifted(A, B, 6, phi)


def position_model() -> LiftedModel:
    """The same point from positions and inputs of this and the last step: p+ = a1 p + a2 p- + b1 u + b2 u-."""
    A, B = discrete()
    a, b = A[::3, ::3], B[::3, 0]  # one coordinate
    # Cayley-Hamilton: p+ - tr(a) p + det(a) p- = b_p u + (a b - tr(a) b)_p u-
    a1, a2, b1, b2 = np.trace(a), -np.linalg.det(a), b[0], (a @ b - np.trace(a) * b)[0]
    eye, zero = np.eye(3), np.zeros((3, 3))
    step = np.block([[a1 * eye, a2 * eye, b2 * eye], [eye, zero, zero], [zero, zero, zero]])
    return lifted(step, np.vstack([b1 * eye, zero, eye]), 3, lambda u: u, delays=1)


def controller(model: LiftedModel, **options: object) -> MPC:
    arguments: dict[str, object] = {"rate_weight": 1e-3} | options
    return MPC(model, 20, -0.02, 0.02, 0.005, **arguments)  # type: ignore[arg-type]


def run(plant: PointOnSprings, mpc: MPC | FeedForward, reference: references.Reference, steps: int = 300) -> LoopLog:
    return ClosedLoop(plant=plant, controller=mpc).run(reference, steps=steps, progress=False)


def test_a_circle_is_tracked_from_rest() -> None:
    log = run(PointOnSprings(), controller(point_model()), references.circle(radius=0.05, period=6.0), 400)
    assert not log.stopped and log.fallbacks == 0 and log.limit_violations == 0
    assert log.x.shape == (401, 6) and log.y.shape == log.reference.shape == (401, 3) and log.u.shape == (400, 3)
    assert len(log.statuses) == len(log.solve_time) == len(log.plant_time) == 400
    np.testing.assert_allclose(log.t[-1], 12.0)
    assert log.rms_error(after=3.0) < 2e-4
    assert "400 steps" in log.summary() and "0 fallbacks" in log.summary()


@pytest.mark.parametrize("model", [point_model(), position_model()], ids=["full state", "delays"])
def test_a_constant_load_leaves_no_offset(model: LiftedModel) -> None:
    plant = PointOnSprings(load=2.0, positions_only=model.n_states == 3)  # sags by 22 mm
    target = references.constant([0.05, -0.03, 0.02])
    with_estimate = run(plant, controller(model), target)
    without = run(plant, controller(model, estimator_gain=0.0), target)
    assert with_estimate.error[-1] < 1e-5
    assert without.error[-1] > 1e-3
    assert with_estimate.fallbacks == 0


def test_a_wrong_stiffness_leaves_no_offset() -> None:
    log = run(
        PointOnSprings(stiffness=0.8 * STIFFNESS), controller(point_model()), references.constant([0.05, 0.0, -0.06])
    )
    assert log.error[-1] < 1e-5


def saturated(u: Array) -> Array:
    return 0.008 * np.tanh(u / 0.008)


def test_input_features_reach_the_set_point_of_a_saturating_plant() -> None:
    aware = point_model(lambda u: 0.008 * ca.tanh(u / 0.008))
    assert not aware.linear_in_u
    target = references.constant([0.06, -0.07, 0.02])  # 70 mm of 80 mm that the saturated pull can reach
    known = run(PointOnSprings(saturated), controller(aware, estimator_gain=0.0), target)
    ignored = run(PointOnSprings(saturated), controller(point_model(), estimator_gain=0.0), target)
    assert known.error[-1] < 1e-4
    assert ignored.error[-1] > 50 * known.error[-1]
    circle = references.circle(radius=0.07, period=2.0, center=(0.0, 0.0))
    known = run(PointOnSprings(saturated), controller(aware), circle)
    ignored = run(PointOnSprings(saturated), controller(point_model()), circle)
    assert known.rms_error(after=2.0) < 0.5 * ignored.rms_error(after=2.0)
    assert known.limit_violations == ignored.limit_violations == 0


def test_preview_acts_before_a_jump() -> None:
    jump = references.setpoint([[0.0, 0.0, 0.0], [0.05, 0.0, 0.0]], times=[0.0, 1.5])
    log = run(PointOnSprings(), controller(point_model()), jump, 100)
    k = round(1.5 / DT)
    assert np.abs(log.u[k - 5 : k]).max() > 1e-4 and np.abs(log.u[: k - 20]).max() < 1e-6


def test_soft_output_limits_hold_where_they_can() -> None:
    circle = references.circle(radius=0.06, period=4.0, center=(0.0, 0.0))
    free = run(PointOnSprings(), controller(point_model()), circle)
    bounded = run(PointOnSprings(), controller(point_model(), y_max=[0.04, np.inf, np.inf]), circle)
    assert free.y[:, 0].max() > 0.059 and bounded.y[:, 0].max() < 0.0405
    assert bounded.y[:, 1].max() > 0.055 and bounded.fallbacks == 0


def test_tracking_some_axes_or_some_states() -> None:
    xy = references.circle(radius=0.05, period=6.0)
    log = run(PointOnSprings(), controller(point_model(), axes=(0, 1)), xy, 250)
    assert log.y.shape == (251, 2) and log.rms_error(after=3.0) < 2e-4
    log = run(PointOnSprings(), controller(point_model(), track=(2,)), references.constant([0.03]), 200)
    assert log.error[-1] < 1e-5


def test_feed_forward_settles_where_the_statics_say() -> None:
    inverse = lambda y: np.nan_to_num(y) * STIFFNESS / GAIN  # noqa: E731
    forward = FeedForward(inverse, point_model(), -0.02, 0.02, 0.005)
    target = references.constant([0.05, 0.03, np.nan])
    assert run(PointOnSprings(), forward, target, 500).error[-1] < 1e-5
    loaded = run(PointOnSprings(load=2.0), forward, target, 500)
    assert loaded.error[-1] > 0.02 and loaded.limit_violations == 0
    lost = run(
        PointOnSprings(), FeedForward(lambda y: np.full(3, np.nan), point_model(), -0.02, 0.02, 0.005), target, 5
    )
    assert lost.fallbacks == 5 and not lost.u.any()


def test_feed_forward_moves_no_faster_than_it_may() -> None:
    forward = FeedForward(lambda y: y * STIFFNESS / GAIN, point_model(), -0.02, 0.02, [0.001, 0.002, 0.004])
    jump = references.setpoint([[0.0, 0.0, 0.0], [0.08, -0.08, 0.08], [0.5, 0.5, 0.5]], [0.0, 0.3, 0.9])
    log = run(PointOnSprings(), forward, jump, 60)
    first = round(0.3 / DT)  # the step that ends at 0.3 s is the first that heads for the point
    expected = [np.clip(rate * np.arange(1, 9), 0.0, 0.008) for rate in (0.001, 0.002, 0.004)]
    np.testing.assert_allclose(log.u[first - 1 : first + 7], np.transpose(expected) * [1, -1, 1], atol=1e-15)
    assert not log.u[: first - 1].any() and log.limit_violations == 0
    np.testing.assert_allclose(log.u[-1], 0.02)  # 0.05 would be needed


def test_a_run_starts_from_the_given_input() -> None:
    start = np.array([0.01, -0.01, 0.005])
    log = ClosedLoop(PointOnSprings(), controller(point_model())).run(
        references.constant(), 60, u0=start, progress=False
    )
    np.testing.assert_allclose(log.y[0], start * GAIN / STIFFNESS)
    np.testing.assert_allclose(log.u, np.tile(start, (60, 1)), atol=1e-5)
    assert log.limit_violations == 0
    with pytest.raises(ValueError, match=r"u0 = .* outside u_min"):
        ClosedLoop(PointOnSprings(), controller(point_model())).run(references.constant(), 5, u0=[1.0, 0.0, 0.0])


def test_a_plant_that_diverges_stops_the_loop() -> None:
    unstable = PointOnSprings(force=lambda u: 0.01 * u, stiffness=-400.0)
    log = run(unstable, controller(point_model()), references.constant([0.01, 0.0, 0.0]), 400)
    assert log.stopped and "diverged: x" in log.message and "1e3 times the training range" in log.message
    assert 5 < len(log.u) < 100 and len(log.x) == len(log.t) == len(log.reference) == len(log.u) + 1
    assert np.isfinite(log.x).all() and log.limit_violations == 0
    assert log.message in log.summary()


def test_a_plant_that_fails_stops_the_loop() -> None:
    log = run(PointOnSprings(fails_at=7), controller(point_model()), references.constant([0.01, 0.0, 0.0]), 20)
    assert log.stopped and log.message.endswith("the plant failed: integrator failed")
    assert "step 7 of 20" in log.message and len(log.u) == 6 and len(log.x) == 7
    first = run(PointOnSprings(fails_at=1), controller(point_model()), references.constant([0.01, 0.0, 0.0]), 20)
    assert first.stopped and len(first.u) == 0 and np.isnan(first.rms_error()) and "stopped" in first.summary()
    overflowing = PointOnSprings(force=lambda u: 1e300 * u, load=0.0)
    log = run(overflowing, controller(point_model()), references.constant([0.01, 0.0, 0.0]), 20)
    assert log.stopped and ("not finite" in log.message or "diverged" in log.message)


def test_a_model_of_another_arm_is_refused() -> None:
    with pytest.raises(ValueError, match="the plant has 3 states, the model 6: a model fitted for another arm"):
        ClosedLoop(PointOnSprings(positions_only=True), controller(point_model()))
    plant = PointOnSprings()
    plant.dt = 0.02
    with pytest.raises(ValueError, match=r"the plant has dt = 0.02 s, the model 0.03 s"):
        ClosedLoop(plant, controller(point_model()))
    plant = PointOnSprings()
    plant.n_inputs = 2
    with pytest.raises(ValueError, match="the plant has 2 inputs, the model 3"):
        ClosedLoop(plant, controller(point_model()))


def test_references_that_do_not_fit_are_refused() -> None:
    loop = ClosedLoop(PointOnSprings(), controller(point_model()))
    with pytest.raises(ValueError, match="the reference has 2 coordinates, the controller tracks 3"):
        loop.run(references.constant([0.0, 0.0]), 5, progress=False)
    with pytest.raises(ValueError, match="the reference is for 'shape', the controller tracks 'tip'"):
        loop.run(references.constant([0.0, 0.0, 0.0], track="shape"), 5, progress=False)
    with pytest.raises(ValueError, match="steps = 0"):
        loop.run(references.constant(), 0, progress=False)
