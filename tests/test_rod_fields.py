"""The 24 fields of a station: consistent with one another, with their time derivatives and with the internal force."""

import numpy as np
import pytest

from pisplit.models import rod
from pisplit.models.arm.tendon_arm import TendonArm

P, R, V, W, Q, OMEGA = (slice(0, 3), slice(3, 12), slice(12, 15), slice(15, 18), slice(18, 21), slice(21, 24))


@pytest.fixture(scope="module")
def arm() -> rod.Scene:
    return TendonArm.paper(nodes=8).scene


@pytest.fixture(scope="module")
def swinging(arm: rod.Scene) -> np.ndarray:
    """States [xi, xi_t, u] (4, n) of a fast motion."""
    t = np.arange(1, 7)[:, None]
    commands = 1e-3 + 0.01 * np.sin(0.4 * t + np.array([0.0, 2.1, 4.2]))
    trajectory = arm.simulator(0.03).run(commands, arm.statics().solve([1e-3] * 3).state, check=False)
    assert trajectory.success
    states: np.ndarray = trajectory.x[-4:]
    return states


def test_position_is_the_integral_of_the_rotated_strain(arm: rod.Scene, swinging: np.ndarray) -> None:
    """p(L) = int R e3 ds for a rod that does not stretch, by Gauss quadrature over the stations' own frames."""
    x, b = np.polynomial.legendre.leggauss(20)
    length = arm.rod.length
    frames = arm.fields(swinging[0], 0.5 * length * (x + 1.0))[:, R].reshape(-1, 3, 3)
    integral = 0.5 * length * b @ frames[:, :, 2]
    assert arm.fields(swinging[0], [length])[0, P] == pytest.approx(integral, abs=5e-5 * length)


def test_the_last_station_is_the_tip(arm: rod.Scene) -> None:
    equilibrium = arm.statics().solve([0.01, 0.0, -0.004])
    fields = arm.fields(equilibrium.state, stations=6)
    assert fields[-1, P] == pytest.approx(equilibrium.tip, abs=1e-15)
    assert fields[2, P] == pytest.approx(equilibrium.pose(arm.rod.length / 2.0)[0], abs=1e-15)
    assert fields[2, R].reshape(3, 3) == pytest.approx(equilibrium.pose(arm.rod.length / 2.0)[1], abs=1e-15)


def test_a_station_does_not_depend_on_the_others(arm: rod.Scene, swinging: np.ndarray) -> None:
    length = arm.rod.length
    many = arm.fields(swinging, 30)
    assert arm.fields(swinging, [0.4 * length, length]) == pytest.approx(many[:, [11, 29]], abs=1e-12)


def test_rotations_are_orthogonal(arm: rod.Scene, swinging: np.ndarray) -> None:
    frames = arm.fields(swinging, 7)[..., R].reshape(-1, 3, 3)
    assert frames @ frames.transpose(0, 2, 1) == pytest.approx(np.broadcast_to(np.eye(3), frames.shape), abs=1e-11)
    assert np.linalg.det(frames) == pytest.approx(1.0)


def test_body_velocities_are_the_rates_of_position_and_frame(arm: rod.Scene, swinging: np.ndarray) -> None:
    """q = R^T p_t and hat(omega) = R^T R_t by central differences along the motion of the strains."""
    n, h = arm.n_strains, 1e-6
    state = swinging[-1]
    moved = np.stack([state, state])
    moved[:, :n] += h * np.array([[-1.0], [1.0]]) * state[n : 2 * n]
    before, after = arm.fields(moved, 6)
    rate = (after - before) / (2.0 * h)
    fields = arm.fields(state, 6)
    frames = fields[:, R].reshape(-1, 3, 3)
    q = np.einsum("sji,sj->si", frames, rate[:, P])
    hat = np.einsum("sji,sjk->sik", frames, rate[:, R].reshape(-1, 3, 3))
    omega = np.stack([hat[:, 2, 1], hat[:, 0, 2], hat[:, 1, 0]], axis=1)
    assert np.abs(fields[:, Q]).max() > 0.5
    assert fields[:, Q] == pytest.approx(q, abs=1e-3 * np.abs(q).max())
    assert fields[:, OMEGA] == pytest.approx(omega, abs=1e-3 * np.abs(omega).max())


def test_velocities_converge_to_the_rates_of_the_frames_with_the_nodes(arm: rod.Scene) -> None:
    """Frames take Magnus steps, velocities integrate R w_t: they meet as the nodes grow."""

    def gap(nodes: int) -> float:
        scene, h = arm.with_nodes(nodes), 1e-6
        s = scene.rule.nodes / scene.rod.length
        xi = np.stack([4.0 * np.cos(2.0 * s), 5.0 * np.sin(3.0 * s), s], axis=1).ravel()
        rates = np.stack([60.0 * np.sin(2.0 * s), -40.0 * s, 5.0 * np.cos(s)], axis=1).ravel()
        states = [scene.state(xi + t * rates, rates, np.zeros(3)) for t in (-h, 0.0, h)]
        before, now, after = scene.fields(np.stack(states), [scene.rod.length])[:, 0]
        p_t = (after[P] - before[P]) / (2.0 * h)
        return float(np.abs(now[R].reshape(3, 3).T @ p_t - now[Q]).max() / np.abs(now[Q]).max())

    gaps = [gap(k) for k in (4, 8, 12)]
    assert gaps[1] < gaps[0] / 8.0 and gaps[2] < gaps[1] / 4.0
    assert gaps[2] < 1e-4


def test_curvature_is_the_derivative_of_the_frame(arm: rod.Scene) -> None:
    """hat(w) = R^T R_s: Magnus steps and interpolated strains agree to their order."""
    state = arm.statics().solve([0.008, -0.002, -0.003]).state
    s, h = 0.41, 1e-3
    fields = arm.fields(state, [s - h, s, s + h])
    frames = fields[:, R].reshape(3, 3, 3)
    hat = frames[1].T @ (frames[2] - frames[0]) / (2.0 * h)
    assert fields[1, W] == pytest.approx([hat[2, 1], hat[0, 2], hat[1, 0]], abs=5e-4)


def test_shear_and_stretch_of_an_inextensible_rod_come_from_the_force_it_carries() -> None:
    """A Cosserat rod of the same arm has them as unknowns; both agree, at rest and while it swings."""
    arm = TendonArm.paper().scene
    tendons = rod.Tendons.parallel(15.06e-3, (0, 120, 240), rod.Tension())
    scene = arm.without(rod.Tendons) + tendons
    full = rod.Scene(
        rod.Rod(scene.rod.length, scene.rod.section, scene.rod.material, "cosserat"), *scene.terms, nodes=scene.nodes
    )
    pulls = [5.0, 2.0, 3.0]
    v = [s.fields(s.statics().solve(pulls).state, 5)[:, V] - [0.0, 0.0, 1.0] for s in (scene, full)]
    scale = 10.0 / scene.rod.stiffness[5]
    assert np.abs(v[1]).max() > 0.5 * scale
    assert v[0] == pytest.approx(v[1], abs=1e-3 * scale)


def test_names_quantities_and_groups_follow_the_layout(arm: rod.Scene) -> None:
    fields = arm.field_map(6)
    assert len(fields.names) == len(fields.quantities) == 144
    assert fields.names[0] == "p_x[1]" and fields.names[120:123] == ("p_x[6]", "p_y[6]", "p_z[6]")
    assert fields.names[18] == "q_x[1]" and fields.quantities[18] == "q" and fields.quantities[11] == "R"
    assert fields.outputs["tip"] == (120, 121, 122)
    assert fields.outputs["tip_velocity"] == (138, 139, 140)
    assert len(fields.outputs["shape"]) == 18


def test_the_clamp_does_not_move(arm: rod.Scene, swinging: np.ndarray) -> None:
    clamp = arm.fields(swinging, [0.0, 0.1])[:, 0]
    assert not clamp[:, P].any() and not clamp[:, Q].any() and not clamp[:, OMEGA].any()
    assert clamp[:, R] == pytest.approx(np.tile(np.eye(3).ravel(), (len(swinging), 1)))
