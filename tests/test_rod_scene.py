"""Scenes: what they contain is in their equations, and nothing else."""

import numpy as np
import pytest

from pisplit.models import rod
from pisplit.models.arm.tendon_arm import TendonArm

STEEL = rod.Elastic(207e9, 207e9 / 2.6, 8000.0)
DRAG = rod.QuadraticDrag(1e-3)
DAMPING = rod.KelvinVoigt(bending=5e-4, torsion=5e-4)
GRAVITY = rod.Gravity((-9.81, 0.0, 0.0))


def body(strains: str = "kirchhoff") -> rod.Rod:
    return rod.Rod(0.5, rod.Circle(1e-3), STEEL, strains)


def pair(offset: float = 0.015) -> rod.Tendons:
    """Two tendons in the plane of bending."""
    return rod.Tendons([[offset, 0.0], [-offset, 0.0]], rod.Displacement(1e-4))


def instructions(scene: rod.Scene) -> int:
    """Size of the graph of the dynamic residual."""
    return int(scene.motion_residual.n_instructions())


def static_instructions(scene: rod.Scene) -> int:
    return int(scene.statics().residual_function.n_instructions())


@pytest.mark.parametrize("term", [DRAG, DAMPING, GRAVITY, pair()])
def test_a_term_taken_out_leaves_the_scene_that_never_had_it(term: rod.QuadraticDrag) -> None:
    every = (GRAVITY, DAMPING, DRAG, pair())
    whole = rod.Scene(body(), *every)
    without, never = whole - term, rod.Scene(body(), *[t for t in every if t != term])
    assert instructions(without) == instructions(never) < instructions(whole)
    assert static_instructions(without) == static_instructions(never) <= static_instructions(whole)
    xi = 3.0 * np.random.default_rng(0).standard_normal(whole.n_strains)
    u = np.zeros(never.n_inputs)
    assert np.array_equal(np.asarray(without.acceleration(xi, -xi, u)), np.asarray(never.acceleration(xi, -xi, u)))
    assert without.n_inputs == never.n_inputs


def test_graphs_shrink_with_the_strains_that_are_free() -> None:
    sizes = [instructions(rod.Scene(body(s), GRAVITY, DAMPING)) for s in ("planar", "kirchhoff", "cosserat")]
    assert sizes[0] < sizes[1] / 4.0 and sizes[1] < sizes[2]


def test_statics_holds_nothing_of_the_motion() -> None:
    bare = rod.Scene(body(), GRAVITY, pair())
    assert static_instructions(bare) == static_instructions(bare + DRAG + DAMPING)
    assert static_instructions(bare) < instructions(bare) / 2.0


def test_tensions_of_a_passive_rod_are_not_there() -> None:
    passive = TendonArm.paper().passive
    assert passive.n_inputs == 0
    assert passive.statics().solve().tensions.shape == (0,)
    assert passive.n_states == 2 * passive.n_strains


def test_a_plane_scene_is_the_spatial_one_in_its_plane() -> None:
    """Four nodes: strains are cubic and the Magnus steps integrate them exactly."""
    terms = (GRAVITY, DAMPING, DRAG, pair())
    plane, space = (rod.Scene(body(s), *terms, nodes=4) for s in ("planar", "kirchhoff"))
    pulls = [0.006, -0.002]
    tips = [s.statics().solve(pulls).tip for s in (plane, space)]
    assert tips[0] == pytest.approx(tips[1], abs=1e-9)
    xi, rate = np.array([1.0, -2.0, 0.5, 1.5]), np.array([10.0, 5.0, -20.0, 8.0])
    embedded = [np.stack([0.0 * v, v, 0.0 * v], axis=1).ravel() for v in (xi, rate)]
    acceleration = np.asarray(plane.acceleration(xi, rate, pulls)).ravel()
    spatial = np.asarray(space.acceleration(*embedded, pulls)).reshape(4, 3)
    assert spatial[:, 1] == pytest.approx(acceleration, rel=1e-7, abs=1e-7 * np.abs(acceleration).max())
    assert np.abs(spatial[:, [0, 2]]).max() <= 1e-7 * np.abs(acceleration).max()
    ends = [
        s.simulator(0.03, rtol=1e-8).run(np.linspace([0.0, 0.0], pulls, 5), check=False).fields([0.5])[-1]
        for s in (plane, space)
    ]
    assert ends[0] == pytest.approx(ends[1], abs=1e-5)


def test_turning_gravity_and_tendons_turns_the_answer() -> None:
    """By 120 degrees about the rod: a circular section has no preferred axis."""
    c, s = np.cos(2.0 * np.pi / 3.0), np.sin(2.0 * np.pi / 3.0)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    pulls = np.linspace([1e-3] * 3, [0.008, -0.003, -0.002], 6)

    def end(angle: float, gravity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        tendons = rod.Tendons.parallel(0.015, (angle, angle + 100, angle + 230), rod.Displacement(1e-4))
        scene = rod.Scene(body(), rod.Gravity(gravity), DAMPING, DRAG, tendons)
        static = scene.statics().solve(pulls[-1])
        moving = scene.simulator(0.03, rtol=1e-7).run(pulls, scene.statics().solve(pulls[0]).state, check=False)
        return static.tip, moving.fields([0.5])[-1, 0, :3]

    first = end(10.0, np.array([-9.81, 2.0, 1.0]))
    second = end(130.0, turn @ [-9.81, 2.0, 1.0])
    assert second[0] == pytest.approx(turn @ first[0], abs=1e-9)
    assert second[1] == pytest.approx(turn @ first[1], abs=1e-5)


def test_scenes_are_composed_without_being_changed() -> None:
    scene = rod.Scene(body(), GRAVITY)
    longer = scene + DRAG
    assert scene.terms == (GRAVITY,) and longer.terms == (GRAVITY, DRAG)
    assert longer.replace(rod.QuadraticDrag(2e-3)).terms[1].coefficient == 2e-3
    assert longer.without(rod.Gravity).terms == (DRAG,)
    assert scene.with_nodes(7).n_strains == 21


def test_inputs_stack_in_the_order_of_the_terms() -> None:
    wrench = rod.TipWrench(force=rod.Input("f", 3), moment=rod.Input("m", 3))
    scene = rod.Scene(body(), wrench, pair(), rod.Gravity(rod.Input("g", 3)))
    assert scene.n_inputs == 11
    assert scene.input_names[:4] == ("f[0]", "f[1]", "f[2]", "m[0]")
    assert scene.input_names[6:9] == ("tendons[0]", "tendons[1]", "g[0]")
    tip = scene.statics().solve([0, 0, 0, 0, 0.01, 0, 1e-3, 1e-3, 0, 0, 0]).tip
    assert tip[0] > 0.0 and abs(tip[1]) < 1e-12


def test_the_same_input_may_load_two_terms() -> None:
    """Gravity is felt by the rod and, here, by its base acceleration: one input, read twice."""
    g = rod.Input("g", 3)
    once = rod.Scene(body(), rod.Gravity(g)).statics().solve([2.0, 0.0, 0.0])
    twice = rod.Scene(body(), rod.Gravity(g), rod.Gravity(g)).statics().solve([1.0, 0.0, 0.0])
    assert twice.tip == pytest.approx(once.tip, abs=1e-12)


def test_the_table_of_a_scene_names_what_it_contains() -> None:
    text = str(TendonArm.paper().scene)
    for part in ("kirchhoff", "0.7144 m", "gravity", "Kelvin-Voigt", "quadratic drag", "3 parallel tendons", "33"):
        assert part in text
