"""Power balance: what the inputs do is stored, dissipated, or moves the rod."""

from typing import Any

import casadi as ca
import numpy as np
import pytest

from pisplit.models import rod
from pisplit.models.rod.analysis.energy import stored

GRAVITY = np.array([-9.81, 0.0, 1.5])


def scene(strains: str, nodes: int) -> rod.Scene:
    """A soft rod with gravity, both dampings and a tip force as input."""
    return rod.Scene(
        rod.Rod(0.5, rod.Circle(4e-3), rod.Elastic(2e7, 7e6, 1100.0), strains),
        rod.Gravity(GRAVITY),
        rod.KelvinVoigt(bending=1e-4, torsion=1e-4),
        rod.QuadraticDrag(5e-2),
        rod.TipWrench(force=rod.Input("f", 3)),
        nodes=nodes,
    )


def powers(scene: rod.Scene) -> ca.Function:
    """``(xi, xi_t, xi_tt, u) -> energy, its rate, power of the input, dissipation`` by Gauss quadrature."""
    xi, xi_t, xi_tt, u, balance = scene.dynamic_balance
    motion, body, b = balance.motion, scene.rod, ca.DM(scene.rule.weights)

    def total(density: ca.SX) -> ca.SX:
        return ca.dot(ca.vec(density), b)

    omega = motion.to_body(motion.spin)
    inertia = ca.repmat(ca.DM(list(body.inertia_per_length)), 1, scene.nodes)
    stiffness = ca.repmat(ca.DM(list(body.stiffness[:3])), 1, scene.nodes)
    speed2 = ca.sum1(motion.velocity**2)
    kinetic = total(0.5 * body.mass_per_length * speed2 + 0.5 * ca.sum1(inertia * omega**2))
    elastic = total(0.5 * ca.sum1(stiffness * motion.w**2))
    weight = -body.mass_per_length * total(ca.DM(GRAVITY).T @ motion.position)
    energy = kinetic + elastic + weight
    rate = ca.jtimes(energy, ca.vertcat(xi, xi_t), ca.vertcat(xi_t, xi_tt))
    dissipated = total(1e-4 * ca.sum1(motion.w_t**2) + 5e-2 * speed2**1.5)
    work = ca.dot(u, motion.tip_velocity)
    return ca.Function("powers", [xi, xi_t, xi_tt, u], [energy, rate, work, dissipated])


def smooth_states(scene: rod.Scene, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Strains and rates that are smooth along the rod, so that nodes resolve them."""
    rng = np.random.default_rng(seed)
    s = scene.rule.nodes / scene.rod.length
    shapes = np.stack([np.ones_like(s), s, np.cos(2.0 * s)])
    n = scene.rod.strain_set.n_fields
    xi, xi_t = (shapes.T @ (size * rng.standard_normal((3, n))) for size in (2.0, 10.0))
    return xi.ravel(), xi_t.ravel()


def imbalance(scene: rod.Scene, seed: int) -> float:
    """|rate of energy + dissipation - work| in parts of their sizes, at one smooth state."""
    xi, xi_t = smooth_states(scene, seed)
    u = np.array([0.3, 0.0, -0.2])
    xi_tt = scene.acceleration(xi, xi_t, u)
    _, rate, work, dissipated = (float(v) for v in powers(scene)(xi, xi_t, xi_tt, u))
    return abs(rate + dissipated - work) / (abs(rate) + abs(dissipated) + abs(work))


def test_power_of_a_plane_rod_balances_exactly() -> None:
    """Integrating loads from the tip is the exact adjoint of integrating motion from the base, at any resolution."""
    for nodes in (2, 5):
        for seed in range(3):
            assert imbalance(scene("planar", nodes), seed) < 1e-7


def test_power_of_a_spatial_rod_balances_as_the_nodes_grow() -> None:
    coarse, fine = (max(imbalance(scene("kirchhoff", k), seed) for seed in range(3)) for k in (4, 10))
    assert fine < 1e-4
    assert fine < coarse / 10.0


OFFSET = (0.05, 0.03, 0.02)


@pytest.mark.parametrize(
    ("strains", "nodes", "terms"),
    [
        ("kirchhoff", 5, [rod.PointMass(0.3, 0.05, (1e-4, 2e-4, 3e-4), OFFSET), rod.Gravity((1.0, 2.0, -9.81))]),
        ("kirchhoff", (3, 3), [rod.PointMass(0.3, 0.05, (1e-4, 2e-4, 3e-4), OFFSET)]),
        ("kirchhoff", 4, [rod.PointMass(0.5, 0.05, (1e-4, 2e-4, 3e-4), OFFSET), rod.Base(hinge="ball")]),
        ("cosserat", 3, [rod.PointMass(0.3, 0.05, offset=OFFSET), rod.Base(hinge="ball", slides="xyz")]),
    ],
)
def test_bodies_off_the_axis_give_and_take_no_energy(strains: str, nodes: Any, terms: list[Any]) -> None:
    """Wherever a body is fixed, the variational balance is Lagrange's equation: M symmetric, T + V constant."""
    elements = (0.3, 0.2) if isinstance(nodes, tuple) else ()
    body = rod.Rod(0.5, rod.Circle(1e-2), rod.Elastic(1e7, 3.4e6, 1000.0), strains, elements=elements)
    scene = rod.Scene(body, *terms, nodes=nodes).variational()
    xi, xi_t, xi_tt, u, balance = scene.dynamic_balance
    residual = ca.DM(scene.weights) * balance.residual
    kinetic, elastic, gravity = stored(scene)(xi, xi_t, ca.SX(0, 1))
    state, rate = ca.vertcat(xi, xi_t), ca.vertcat(xi_t, xi_tt)
    gain = [ca.jtimes(energy, state, rate) for energy in (kinetic, kinetic + elastic + gravity)]
    read = ca.Function("read", [xi, xi_t, xi_tt, u], [-ca.jacobian(residual, xi_tt), residual, *gain])
    size, rng = np.asarray(scene.nominal_strains), np.random.default_rng(0)
    q, v = 1.5 * size * rng.standard_normal((2, scene.n_strains))
    mass, force = (np.array(m) for m in read(q, v, 0.0, [])[:2])
    assert np.abs(mass - mass.T).max() < 1e-12 * np.abs(mass).max()
    *_, moved, lost = read(q, v, np.linalg.solve(mass, force), [])
    assert abs(float(lost)) < 1e-9 * abs(float(moved))


@pytest.mark.parametrize(("strains", "nodes", "tolerance"), [("planar", 4, 1e-4), ("kirchhoff", 6, 1e-3)])
def test_energy_of_a_trajectory_is_the_work_done_on_it(strains: str, nodes: int, tolerance: float) -> None:
    """Gain of energy + dissipated energy = work of the tip force, integrated in time by Simpson's rule."""
    arm = scene(strains, nodes)
    dt, steps = 2.5e-3, 200
    t = dt * np.arange(1, steps + 1)
    side = 0.0 if strains == "planar" else 0.03
    forces = np.stack([0.08 * np.sin(9.0 * t), side * np.sin(5.0 * t), -0.02 * t], axis=1)
    trajectory = arm.simulator(dt, rtol=1e-7).run(forces, check=False)
    assert trajectory.success
    n = arm.n_strains
    xi, xi_t, u = trajectory.x[:, :n].T, trajectory.x[:, n : 2 * n].T, trajectory.x[:, 2 * n :].T
    energy, _, work, dissipated = (
        np.asarray(v).ravel() for v in powers(arm).map(steps + 1)(xi, xi_t, np.zeros_like(xi), u)
    )
    simpson = dt / 3.0 * np.r_[1.0, np.tile([4.0, 2.0], steps // 2)[:-1], 1.0]
    gain = energy[-1] - energy[0]
    assert abs(gain) + simpson @ np.abs(work) > 1e-3
    assert abs(gain + simpson @ dissipated - simpson @ work) < tolerance * (simpson @ np.abs(work))
