"""Derivatives of the balance through small rotations of the frames are those of the graph, in fewer operations."""

import casadi as ca
import numpy as np
import pytest

from pisplit.models import rod
from pisplit.models.arm import TendonArm

STEEL = rod.Elastic(207e9, 207e9 / 2.6, 8000.0)
#: Loads that read frames, positions, velocities and points between the nodes.
TERMS = {
    "tendons": (rod.Tendons([[0.015, 0.0], [-0.01, 0.012]], rod.Displacement(1e-4)),),
    "follower": (rod.PointWrench(0.3, force=(0.1, 0.2, 0.3), follower=True), rod.TipWrench((0.1, 0.2, 0.3))),
    "masses": (rod.PointMass(0.02, 0.3, offset=(0.01, 0.0, 0.0)), rod.PointMass(0.05, 0.5)),
    "ball": (rod.Base(hinge="ball", slides="x"), rod.QuadraticDrag(0.1)),
}


def made(strains: str, terms: str, variational: bool = False) -> rod.Scene:
    scene = rod.Scene(rod.Rod(0.5, rod.Circle(1e-3), STEEL, strains), rod.Gravity((-9.81, 0.0, 0.0)), *TERMS[terms])
    return scene.variational() if variational else scene


def both(balance: rod.equations.balance.Balance, symbols: list[ca.SX]) -> tuple[ca.Function, ca.Function]:
    """The derivative by the graph, and through the rotations."""
    slopes = ca.jacobian(balance.residual, balance.strains), balance.slope
    return tuple(ca.Function("slope", symbols, [ca.densify(s)]) for s in slopes)  # type: ignore[return-value]


@pytest.mark.parametrize(
    ("strains", "terms", "variational"),
    [
        ("kirchhoff", "tendons", False),
        ("kirchhoff", "follower", False),
        ("kirchhoff", "masses", True),
        ("cosserat", "ball", False),
        ("extensible", "masses", False),
    ],
)
def test_slopes_are_those_of_the_graph(strains: str, terms: str, variational: bool) -> None:
    scene, rng = made(strains, terms, variational), np.random.default_rng(0)
    x = scene.rest_coordinates + scene.nominal_strains * rng.standard_normal(scene.n_strains)
    v, a = scene.nominal_strains * rng.standard_normal((2, scene.n_strains)) * [[5.0], [50.0]]
    u = 0.003 * rng.standard_normal(scene.n_inputs)
    xi, inputs, balance = scene.static_balance
    *symbols, moving = scene.dynamic_balance
    for functions, point in ((both(balance, [xi, inputs]), [x, u]), (both(moving, symbols), [x, v, a, u])):
        by_graph, by_turns = (np.asarray(f(*point)) for f in functions)
        np.testing.assert_allclose(by_turns, by_graph, atol=1e-10 * np.abs(by_graph).max())
        assert functions[1].n_instructions() < 0.95 * functions[0].n_instructions()


def test_a_planar_rod_turns_as_it_bends() -> None:
    scene = rod.Scene(rod.Rod(0.5, rod.Circle(1e-3), STEEL, "planar"), rod.Base(hinge=(0.0, 1.0, 0.0)), nodes=3)
    xi, inputs, balance = (scene + rod.TipWrench((0.1, 0.0, 0.2))).static_balance
    found = [np.asarray(f(np.array([1.0, 2.0, -3.0, 0.4]), [])) for f in both(balance, [xi, inputs])]
    np.testing.assert_allclose(found[1], found[0], atol=1e-12)


def test_only_drag_that_is_weak_is_left_out_of_the_iteration_matrix() -> None:
    """Over a step of 0.03 s it is a hundredth of the mass matrix; drag of water stays."""
    rng = np.random.default_rng(0)
    for coefficient, kept in ((1e-4, False), (10.0, True)):
        scene = TendonArm.paper(3).scene.replace(rod.QuadraticDrag(coefficient))
        x, v = rng.standard_normal((2, scene.n_strains)) * [[1.0], [20.0]]
        blocks = [
            [np.asarray(ca.densify(b)) for b in scene.motion_residual.jacobian()(x, rate, 0.0 * x, [0.0] * 3, 0.0 * x)]
            for rate in (v, 0.0 * v)
        ]
        (moving, mass), (still, _) = ((found[1], found[2]) for found in blocks)
        assert bool(np.any(moving != still)) is kept
        xi, xi_t, _, u, _ = scene.dynamic_balance
        scaled = scene.balance(xi, xi_t, None, u).residual / ca.DM(scene.nominal_residual)
        whole = ca.Function("whole", [xi, xi_t, u], [ca.densify(ca.jacobian(scaled, xi_t))])
        left_out = np.abs(np.asarray(whole(x, v, [0.0] * 3)) - moving).max()
        if kept:
            assert left_out <= 1e-12 * np.abs(moving).max()
        else:
            assert 0.0 < 0.03 * left_out < 0.01 * np.abs(mass).max()


@pytest.mark.parametrize("share", [0.3, 0.8])
def test_large_steps_are_as_many_without_the_derivative_of_a_weak_drag(share: float) -> None:
    """Up to half of the inertia at the first bending rate; nothing is left out above that."""
    body = rod.Rod(0.4, rod.Circle(1e-2), rod.Elastic(1e6, 3e5, 1e3))
    drag = rod.LinearDrag(share * body.bending_rate * body.mass_per_length)
    assert drag.weak(body) is (share < 0.5)
    scene = rod.Scene(
        body, drag, rod.KelvinVoigt(bending=1e-3, torsion=1e-3), rod.TipWrench(rod.Input("f", 3)), nodes=4
    )
    dt = 0.1 / body.bending_rate
    u = 0.1 * np.sin(np.arange(1, 25)[:, None] * [0.06, 0.11, 0.0])
    found = scene.fast_stepper(dt).run(u, np.zeros(scene.n_states), check=False)
    exact = scene.simulator(dt, rtol=1e-7).run(u, np.zeros(scene.n_states), check=False)
    assert found.stats["halved"] == 0
    n = scene.n_strains
    assert np.abs(found.x - exact.x)[:, :n].max() < 2e-3 * np.abs(exact.x[:, :n]).max()
