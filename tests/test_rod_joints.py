"""A base that turns or slides freely: beams with such ends, pendulums, rods in space, reactions."""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ellipk

from pisplit.models import rod
from pisplit.models.rod.dynamics.propagation import MOST_TURN
from pisplit.models.rod.output.codegen import board_step

L, E = 0.5, 4e6
SECTION, MATERIAL = rod.Circle(2e-3), rod.Elastic(E, E / 2.8, 1100.0)
EI, RA = E * np.pi * 2e-3**4 / 4.0, 1100.0 * np.pi * 2e-3**2
STIFF = rod.Stiffness((10.0, 10.0), 10.0, (1e6, 1e6), 1e6, 1100.0)
NONE = np.zeros(0)


def body(strains: str = "planar", material: object = MATERIAL) -> rod.Rod:
    return rod.Rod(length=L, section=SECTION, material=material, strains=strains)


def beta(cosine: str, lower: float, upper: float) -> float:
    """Root between two numbers of a frequency equation of Euler and Bernoulli's beam."""
    equations = {
        "hinged": lambda x: np.sin(x) * np.cosh(x) - np.cos(x) * np.sinh(x),
        "free": lambda x: np.cos(x) * np.cosh(x) - 1.0,
        "guided": lambda x: np.sin(x) * np.cosh(x) + np.cos(x) * np.sinh(x),
    }
    return float(brentq(equations[cosine], lower, upper))


@pytest.mark.parametrize(
    ("base", "strains", "rigid", "wanted"),
    [
        (rod.Base(hinge=(0, 2, 0)), "planar", 1, [("hinged", 3.5, 4.5), ("hinged", 6.5, 7.5)]),
        (rod.Base(slides="x"), "planar", 1, [("guided", 2.0, 3.0), ("guided", 5.0, 6.0)]),
        (rod.Base(hinge=(0, 1, 0), slides="xz"), "planar", 3, [("free", 4.5, 5.0), ("free", 7.5, 8.0)]),
        (rod.Base(hinge="ball", slides="xyz"), "kirchhoff", 6, [("free", 4.5, 5.0)] * 2),
    ],
)
def test_beams_with_free_ends_vibrate_as_they_should(base, strains, rigid, wanted):
    """Hinged-free, guided-free and free-free bending and torsion; rigid motions have no frequency."""
    scene = rod.Scene(body(strains), base, nodes=8 if strains == "planar" else 6)
    values = np.abs(scene.linearise(np.zeros(scene.n_states)).eigenvalues)
    slow, others = values[: 2 * rigid], values[2 * rigid :: 2]
    assert slow.max() < 1e-3 * others[0]
    found = np.sqrt(others[: len(wanted)] / np.sqrt(EI / RA)) * L
    assert np.abs(found / [beta(*w) for w in wanted] - 1.0).max() < 3e-4
    twist = np.pi / L * np.sqrt(MATERIAL.shear / MATERIAL.density)
    if strains == "kirchhoff":
        assert np.abs(others / twist - 1.0).min() < 1e-6


def test_a_rigid_rod_is_a_pendulum():
    """Period at an amplitude of 2 rad by the elliptic integral; over the top, the angle goes on; energy stays."""
    scene = rod.Scene(body(material=STIFF), rod.Base(hinge=(0, 1, 0)), rod.Gravity((0, 0, 9.81)), nodes=2)
    start = scene.at_rest(np.array([0.0, 0.0, 2.0]), NONE)
    inertia = 1.0 + 1.5 * (2e-3 / L) ** 2 / 2.0  # of rotary inertia, in parts of m L^2 / 3
    period = 4.0 * np.sqrt(2.0 * L * inertia / (3.0 * 9.81)) * ellipk(np.sin(1.0) ** 2)
    run = scene.stepper(period / 40, step=period / 400).run(np.empty((40, 0)), start, energy=True, check=False)
    angle = run.x[:, scene.layout.joint].ravel()
    assert abs(angle[20] + 2.0) < 1e-3 and abs(angle[40] - 2.0) < 1e-3 and abs(angle[10]) < 1e-3
    assert np.abs(run.energy().imbalance).max() < 1e-6 * np.ptp(run.energy().stored.gravity)
    fast = scene.state([0.0, 0.0, 0.0], [0.0, 0.0, 20.0], NONE)
    over = scene.stepper(0.05, step=0.002).run(np.empty((30, 0)), fast, energy=True, check=False)
    assert over.x[-1, 2] > 4.0 * np.pi
    assert np.abs(over.energy().imbalance).max() < 1e-5 * over.energy().stored.total.max()


def momenta(scene: rod.Scene, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centre of mass, momentum and angular momentum (about the origin) by the quadrature of the nodes."""
    y = scene.fields(x, scene.rule.nodes)
    p, frames, q, omega = y[..., :3], y[..., 3:12].reshape(*y.shape[:2], 3, 3), y[..., 18:21], y[..., 21:]
    velocity = np.einsum("tkij,tkj->tki", frames, q)
    inertia = RA * 2e-3**2 / 4.0 * np.array([1.0, 1.0, 2.0])
    turning = np.einsum("tkij,tkj->tki", frames, inertia * omega)
    b = scene.rule.weights[:, None]
    return (p * b).sum(1) / L, RA * (velocity * b).sum(1), ((RA * np.cross(p, velocity) + turning) * b).sum(1)


def test_a_rod_in_space_keeps_its_momentum():
    """Thrown, turning and bent: momentum, angular momentum and energy stay, its centre of mass flies on straight."""
    scene = rod.Scene(body("kirchhoff"), rod.Base(hinge="ball", slides="xyz"), nodes=3)
    rng = np.random.default_rng(0)
    strains = np.concatenate([0.5 * rng.standard_normal(9), [0.1, 0.2, 0.3], [0.4, -0.2, 0.1]])
    rates = np.concatenate([rng.standard_normal(9), [0.5, -0.2, 0.1], [1.0, -2.0, 0.5]])
    run = scene.stepper(0.03, step=0.003).run(np.empty((5, 0)), scene.state(strains, rates, NONE), True, False)
    centre, momentum, angular = momenta(run.scene, run.x)
    assert np.abs(momentum - momentum[0]).max() < 1e-4 * np.linalg.norm(momentum[0])
    assert np.abs(angular - angular[0]).max() < 1e-4 * np.linalg.norm(angular[0])
    straight = centre[0] + run.t[:, None] * momentum[0] / (RA * L)
    assert np.abs(centre - straight).max() < 1e-5 * L
    assert np.abs(run.energy().imbalance).max() < 1e-4 * run.energy().stored.total[0]
    assert np.abs(run.scene.base_reactions(run.x)).max() < 1e-9


def test_supports_hold_what_joints_do_not_let_go():
    """Weight and its moment at a clamp; nothing along what is free; the reaction of a pendulum swinging through."""
    clamped = rod.Scene(body("kirchhoff"), rod.Gravity((-9.81, 0.0, 0.0)), nodes=4)
    rest = clamped.statics().solve()
    weight = 9.81 * RA * L
    wrench = clamped.base_reactions(rest.state)
    centre = momenta(clamped, rest.state[None])[0][0]
    assert np.allclose(wrench, [weight, 0, 0, *np.cross(centre, [weight, 0, 0])], rtol=1e-6, atol=1e-8)
    scene = rod.Scene(body("kirchhoff"), rod.Base(hinge=(0, 1, 0), slides="x"), rod.Gravity((0, 0, 9.81)), nodes=3)
    x = np.random.default_rng(1).standard_normal((4, scene.n_states))
    wrenches = scene.base_reactions(x)
    assert np.abs(wrenches[:, [0, 4]]).max() < 1e-9 * np.abs(wrenches).max()
    pendulum = rod.Scene(body(material=STIFF), rod.Base(hinge=(0, 1, 0)), rod.Gravity((0, 0, 9.81)), nodes=2)
    swinging = pendulum.state(np.zeros(3), [0.0, 0.0, 3.0], NONE)
    assert np.allclose(pendulum.base_reactions(swinging)[:3], [0, 0, -weight - RA * L * 9.0 * L / 2], rtol=1e-3)


def test_a_support_that_moves_carries_the_joint():
    """On a support that accelerates a hinged rod feels another gravity; IDAS, Gauss and Radau steps agree."""
    given = {"position": rod.Input("p", 3), "velocity": rod.Input("v", 3), "acceleration": rod.Input("a", 3)}
    hinge = rod.Base(hinge=(0, 1, 0))
    damping = rod.Retardation(5e-3)
    still = rod.Scene(body(), hinge, rod.Gravity((3.0, 0, 9.81)), damping, nodes=3)
    moved = rod.Scene(body(), rod.Base(hinge=(0, 1, 0), **given), rod.Gravity((0, 0, 9.81)), damping, nodes=3)
    start, steps, dt = np.array([0.5, 0.2, 0.0, 1.0]), 10, 0.03
    a, b, c = (
        getattr(still, mover)(dt, **options).run(np.empty((steps, 0)), still.at_rest(start, NONE), check=False)
        for mover, options in (("simulator", {"rtol": 1e-7}), ("stepper", {"step": 0.003}), ("fast_stepper", {}))
    )
    assert np.abs(a.x - b.x)[:, :4].max() < 3e-4 and np.abs(c.x - b.x)[:, :4].max() < 5e-3
    t = dt * np.arange(steps + 1)[:, None]
    pull = np.array([-3.0, 0.0, 0.0])
    rows = np.hstack([0.5 * t**2 * pull, t * pull, pull + 0.0 * t])
    carried = moved.simulator(dt, rtol=1e-7).run(rows[1:], moved.at_rest(start, rows[0]), check=False)
    assert np.abs(carried.x[:, :4] - a.x[:, :4]).max() < 1e-4


def test_motions_on_joints_are_checked():
    """The first run of a swinging rod estimates its error, which that on a finer grid confirms."""
    scene = rod.Scene(body(), rod.Base(hinge=(0, 1, 0)), rod.Gravity((0, 0, 9.81)), rod.Retardation(5e-3), nodes=4)
    start = scene.at_rest(np.array([0.5, 0.2, 0.0, 0.1, 1.0]), NONE)
    errors = []
    for check in (None, True):
        with pytest.warns(rod.Unresolved, match="more nodes than 4"):
            errors.append(scene.with_nodes(4).simulator(0.03).run(np.empty((6, 0)), start, check=check).error.largest)
    assert 0.2 < errors[0] / errors[1] < 5.0


def test_work_on_a_base_that_is_turned():
    """A dead force at the tip of a rod that starts along x: what it does is what is stored."""
    push = rod.TipWrench(force=(0.0, 0.0, 0.01))
    scene = rod.Scene(body("kirchhoff"), rod.Base(rotation=(0.0, np.pi / 2, 0.0)), push, nodes=3)
    run = scene.stepper(0.03, step=0.005).run(np.empty((8, 0)), scene.at_rest(np.zeros(9), NONE), True, False)
    account = run.energy()
    assert np.abs(account.imbalance).max() < 1e-3 * np.abs(account.work["TipWrench"]).max()


def test_joints_that_make_no_sense_are_refused_in_one_line():
    """Axes, planes, rotations twice told, statics; a ball joint ends before it has turned once."""
    for wrong in ({"hinge": (0, 0, 0)}, {"hinge": "y"}, {"slides": "xx"}, {"slides": "a"}, {"hinge": (np.nan, 0, 1)}):
        with pytest.raises(ValueError, match=r"Base (hinge|slides)"):
            rod.Base(**wrong)
    with pytest.raises(ValueError, match="turns by itself"):
        rod.Base(hinge="ball", spin=(0.0, 0.0, 1.0))
    for out in ({"hinge": "ball"}, {"slides": "y"}, {"hinge": (1, 0, 0)}):
        with pytest.raises(ValueError, match="out of its plane"):
            rod.Scene(body(), rod.Base(**out))
    scene = rod.Scene(body("kirchhoff"), rod.Base(hinge="ball"), nodes=2)
    start = scene.state(np.zeros(9), [*np.zeros(6), 0.0, 0.0, 8.0], NONE)
    statics = scene.statics()
    for ask in (statics.sensitivity, statics.stability, lambda x: statics.pin_tip([0.1, 0.0, 0.4])):
        with pytest.raises(ValueError, match="needs a base that is clamped"):
            ask(start)
    with pytest.raises(ValueError, match="base that is clamped"):
        scene.coordinates()
    run = scene.stepper(0.1, step=0.01).run(np.empty((10, 0)), start, check=False)
    assert not run.success and "makes a turn" in run.message
    assert np.linalg.norm(run.x[-1, 6:9]) <= MOST_TURN and len(run.u) >= 5
    assert "18 = 2 x 9 strains (3 of the joint) and rates" in str(scene) and "turns about any axis" in str(scene)


def test_joints_and_branches_go_together():
    """A viscoelastic rod on a hinge: derivatives of a step, the step of a board, modes and stored energy."""
    scene = rod.Scene(
        body(),
        rod.Base(hinge=(0, 1, 0)),
        rod.Gravity((0, 0, 9.81)),
        rod.Maxwell(0.5, 0.1),
        rod.Retardation(0.02),
        nodes=2,
    )
    assert scene.layout.n_overstress == 2 and scene.n_states == 8
    start = scene.state([0.5, 0.2, 0.4], [1.0, -2.0, 0.5], NONE, [0.3, -0.1])
    stepper = scene.stepper(0.03, step=0.01, tolerance=1e-13)
    found, d = stepper.sensitivity(start, NONE), 1e-5
    ends = [
        [stepper.run(np.empty((1, 0)), start + side * d * e, check=False).x[-1] for e in np.eye(8)] for side in (1, -1)
    ]
    by_state = (np.array(ends[0]) - np.array(ends[1])).T / (2 * d)
    assert np.abs(found.d_state - by_state).max() < 1e-6 * np.abs(by_state).max()
    fine = scene.stepper(0.03, step=0.001).run(np.empty((1, 0)), start, energy=True, check=False)
    errors = [np.abs(np.asarray(board_step(scene, 0.03, k)(start, NONE)[0]).ravel() - fine.x[-1]) for k in (8, 16)]
    assert errors[1].max() < 0.35 * errors[0].max() and errors[1][:3].max() < 2e-3
    assert np.abs(fine.energy().imbalance).max() < 1e-6 * np.ptp(fine.energy().stored.total)
    modes = scene.modes(scene.statics().solve().state)
    assert np.sum(modes.eigenvalues.imag == 0.0) >= 2 and np.isfinite(modes.strains).all()
    assert np.abs(modes.strains).max(axis=1).min() > 0.0
    checked = scene.simulator(0.03).run(np.empty((3, 0)), start, check=True)
    assert checked.error is not None and np.isfinite(checked.error.distance).all()


def test_a_pendulum_on_a_torsion_spring():
    """Upright: falls below k = m g L / 2, else I w^2 = k - m g L / 2; a moment on the hinge turns it by M / k."""
    mass, inertia = RA * L, RA * L**3 / 3.0 * (1.0 + 1.5 * (2e-3 / L) ** 2 / 2.0)
    fall = mass * 9.81 * L / 2.0
    moment = rod.PointWrench(0.0, moment=rod.Input("moment", 3))
    for part in (0.8, 3.0):
        hinge, weight = rod.Base(hinge=(0, 1, 0), stiffness=part * fall), rod.Gravity((0, 0, -9.81))
        scene = rod.Scene(body(material=STIFF), hinge, weight, moment, nodes=2)
        rest = scene.statics().solve()
        assert rest.success and (abs(rest.state[2]) < 1e-9) == (part > 1.0)
        if part < 1.0:  # leans to where the spring holds it: k q = m g L / 2 sin q
            assert np.sin(abs(rest.state[2])) == pytest.approx(part * abs(rest.state[2]), rel=1e-4)
            continue
        rate = 2.0 * np.pi * scene.modes(rest.state).frequency[0]
        assert rate == pytest.approx(np.sqrt((part - 1.0) * fall / inertia), rel=1e-3)
        assert scene.statics().margin(rest.state) == pytest.approx((part - 1.0) * fall / (10.0 / L), rel=1e-3)
    level = rod.Scene(body(material=STIFF), rod.Base(hinge=(0, 1, 0), stiffness=0.2), moment, nodes=2)
    turned = level.statics().solve([0.0, 0.3, 0.0]).state
    assert turned[2] == pytest.approx(1.5, rel=1e-6) and level.energies(turned[None]).elastic[0] == pytest.approx(0.225)
    assert level.base_reactions(turned)[4] == pytest.approx(-0.3)
    run = level.replace(rod.PointWrench(0.0)).stepper(0.02, step=0.002)
    swing = run.run(np.empty((5, 0)), run.scene.at_rest(turned[:3], NONE), energy=True, check=False)
    assert np.abs(swing.energy().imbalance).max() < 1e-6 and np.ptp(swing.energy().stored.elastic) > 0.1


def test_springs_slide_and_turn_in_every_direction():
    """A force on the slides of a rod in space, each against its own spring; what makes no sense is refused."""
    load = rod.PointWrench(0.0, force=(0.02, 0.0, -0.03))
    scene = rod.Scene(body("kirchhoff"), rod.Base(slides="xz", stiffness=(2.0, 3.0)), load, nodes=2)
    assert scene.statics().solve().state[6:8] == pytest.approx([0.01, -0.01], rel=1e-9)
    for wrong in ({"stiffness": 1.0}, {"slides": "xz", "stiffness": (1.0,)}, {"slides": "x", "stiffness": -1.0}):
        with pytest.raises(ValueError, match="Base stiffness"):
            rod.Base(**wrong)
    with pytest.raises(ValueError, match="Base stiffness"):
        rod.Base(hinge="ball", slides="x", stiffness=1.0)


@pytest.mark.parametrize(
    ("strains", "hinge", "slides", "rigid"), [("planar", (0, 1, 0), "xz", 3), ("kirchhoff", "ball", "xyz", 6)]
)
def test_a_free_rod_has_every_rigid_motion_once(strains: str, hinge: object, slides: str, rigid: int) -> None:
    """beta L = 4.730, 7.853 (both planes in space); drag makes all but the spin about its axis a mode of its own."""
    beam = rod.Rod(1.0, rod.Circle(2e-3), rod.Elastic(1e7, 4e6, 1000.0), strains)
    scene = rod.Scene(beam, rod.Base(hinge=hinge, slides=slides), nodes=6)
    unit, planes = np.sqrt(beam.stiffness[1] / beam.mass_per_length), 1 if strains == "planar" else 2
    modes = scene.modes(np.zeros(scene.n_states), rigid + 2 * planes)
    assert modes.frequency[:rigid].tolist() == [0.0] * rigid
    found = np.sqrt(2.0 * np.pi * modes.frequency[rigid:] / unit)
    assert found == pytest.approx(np.repeat([4.730, 7.853], planes), rel=3e-3)
    dragged = (scene + rod.LinearDrag(1e-3)).modes(np.zeros(scene.n_states))
    assert np.count_nonzero(dragged.frequency == 0.0) == rigid
    slow = dragged.eigenvalues[(dragged.frequency > 0.0) & (np.abs(dragged.eigenvalues) < 0.5 * beam.bending_rate)]
    resisted = rigid - (planes == 2)
    assert slow.real == pytest.approx(np.full(resisted, -1e-3 / beam.mass_per_length), rel=1e-2)
