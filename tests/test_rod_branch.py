"""Statics return the shape that slow loading reaches, or say that they do not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ellipk, ellipkinc

from pisplit.models import rod
from pisplit.models.arm import TendonArm
from pisplit.models.calibration.parametrised import CalibratedTendons
from pisplit.models.rod.statics.certificate import Certificate

EULER = np.pi**2 / 4.0


def body(strains: str = "planar") -> rod.Rod:
    """A rod of length, bending stiffness and mass per length 1."""
    stiffness = rod.Stiffness(bending=(1.0, 1.0), torsion=0.8, shear=(1e4, 1e4), stretch=1e4, density=1.0)
    return rod.Rod(1.0, rod.GeneralSection(1.0, (1e-8, 1e-8)), stiffness, strains)


def loaded(kind: str, strains: str, nodes: int) -> rod.Scene:
    load = rod.Gravity(rod.Input("f", 3)) if kind == "weight" else rod.TipWrench(force=rod.Input("f", 3))
    return rod.Scene(body(strains), load, nodes=nodes)


def directions(count: int, strains: str, seed: int = 1) -> np.ndarray:
    d = np.random.default_rng(seed).normal(size=(count, 3))
    if strains == "planar":
        d = np.stack([np.hypot(d[:, 0], d[:, 1]), 0.0 * d[:, 1], d[:, 2]], axis=1)
    return d / np.linalg.norm(d, axis=1)[:, None]


def slowly(scene: rod.Scene, u: np.ndarray, steps: int = 150) -> np.ndarray | None:
    """Positions along the rod loaded in small steps, each by Newton's method from the last; None if it fails."""
    search, x = scene.statics().search, np.zeros(scene.n_strains)
    for part in np.linspace(0.0, 1.0, steps + 1)[1:]:
        for _ in range(20):
            r = search.residual(x, part * u)
            if np.abs(r).max() < 1e-10:
                break
            x = x - np.linalg.solve(np.asarray(search.slopes(x, part * u)[0]), r)
        else:
            return None
    state = np.concatenate([search.strains(x), np.zeros(scene.n_strains), u])
    return scene.fields(state, 11)[:, :3] if scene.statics().margin(state) > 0.0 else None


@pytest.mark.parametrize("strains", ["planar", "kirchhoff"])
@pytest.mark.parametrize("kind", ["weight", "tip force"])
def test_shapes_are_those_of_slow_loading(kind: str, strains: str) -> None:
    scene, compared = loaded(kind, strains, 6), 0
    for d, size in zip(directions(6, strains), np.geomspace(2.0, 100.0, 6), strict=True):
        found, slow = scene.statics().solve(size * d), slowly(scene, size * d)
        if found.success and found.branch != "snapped" and slow is not None:
            compared += 1
            assert scene.fields(found.state, 11)[:, :3] == pytest.approx(slow, abs=1e-6)
        assert not found.success or (found.stable and found.margin > 0.0)
    assert compared >= 4


@pytest.mark.parametrize("ratio", [1.5, 4.0, 10.0])
def test_a_column_buckles_into_the_elastica(ratio: float) -> None:
    """P L^2 / EI = K(k)^2 with k = sin(alpha / 2); the tip moves by 2 k L / K to the side."""
    found = loaded("tip force", "planar", 24).statics().solve([0.0, 0.0, -ratio * EULER])
    k = brentq(lambda k: ellipk(k * k) ** 2 - ratio * EULER, 1e-6, 1.0 - 1e-12)
    assert found.success and found.branch == "snapped" and "buckling" in found.message
    assert found.load_factor == pytest.approx(1.0 / ratio, rel=2e-3)
    assert abs(found.tip[0]) == pytest.approx(2.0 * k / ellipk(k * k), abs=1e-6)
    assert ellipkinc(np.pi / 2.0, k * k) == pytest.approx(ellipk(k * k))


def test_a_straight_column_above_its_load_is_told_to_be_unstable() -> None:
    scene = loaded("tip force", "planar", 8)
    u = [0.0, 0.0, -1.5 * EULER]
    straight = scene.statics().solve(u, guess=np.zeros(8))
    assert not straight.success and not straight.stable and straight.margin == pytest.approx(-0.5, abs=1e-6)
    assert "unstable" in straight.message and "\n" not in straight.message


def test_the_bound_of_the_certificate_is_below_every_stiffness() -> None:
    rng = np.random.default_rng(0)
    for kind in ("weight", "tip force"):
        for strains in ("planar", "kirchhoff"):
            scene = loaded(kind, strains, 6)
            for d in directions(6, strains, 2):
                u = 2.0 * d
                bound = Certificate(scene).bound(u)
                for _ in range(10):
                    xi = rng.normal(size=scene.n_strains) * 3.0
                    margin = scene.statics().margin(np.concatenate([xi, np.zeros(scene.n_strains), u]))
                    assert margin >= bound - 1e-9


def calibrated(bending: float) -> rod.Scene:
    """A rod whose identified tendons say that its backbone is softer (or stiffer) than drawn."""
    m = 3
    values = np.zeros(6 * m + 6)
    values[: 2 * m] = [1.0, 0.0, -0.5, 0.8, -0.5, -0.8]
    values[4 * m + 1] = np.log(bending)
    none = rod.KelvinVoigt(bending=0.0, torsion=0.0)
    return rod.Scene(body("kirchhoff"), rod.Gravity((3.0, 0.0, 0.5)), CalibratedTendons(m, 0.02, tuple(values), none))


@pytest.mark.parametrize("bending", [0.15, 0.6, 2.0])
def test_a_backbone_that_was_found_softer_has_a_lower_bound(bending: float) -> None:
    scene, rng = calibrated(bending), np.random.default_rng(1)
    bound, drawn = (Certificate(s).bound(np.zeros(3)) for s in (scene, calibrated(1.0)))
    assert 1.0 - bound == pytest.approx((1.0 - drawn) / min(1.0, bending))
    for _ in range(20):
        state = np.concatenate([2.0 * rng.normal(size=scene.n_strains), np.zeros(scene.n_strains), np.zeros(3)])
        assert scene.statics().margin(state) >= min(1.0, bending) * bound - 1e-9


def test_weights_off_the_axis_are_not_certified() -> None:
    for offset, known in (((0.0, 0.0, 0.0), True), ((0.3, 0.0, 0.0), False)):
        mass = rod.PointMass(0.5, 0.1, offset=offset)
        found = Certificate(rod.Scene(body(), rod.Gravity((1.0, 0.0, 0.0)), mass)).bound(np.zeros(0))
        assert bool(np.isfinite(found)) is known


def test_the_arm_under_its_commands_is_certified() -> None:
    arm = TendonArm.paper()
    found = arm.scene.statics().solve(arm.rest_inputs + np.array([0.004, -0.002, -0.002]))
    assert found.branch == "unique" and found.success and found.margin > 0.0


def test_a_soft_arm_lying_sideways_has_one_shape_on_every_grid() -> None:
    """Its weight is 91 EI/L^3: Newton's method finds four unstable roots on four grids."""
    heights = []
    for nodes in (5, 6, 8):
        terms = [rod.Gravity((-9.81, 0, 0)), rod.Tendons.parallel(4e-3, (0, 120, 240), drive=rod.Tension())]
        soft = rod.Rod(0.3, rod.Circle(0.005), rod.Elastic(5e5, 5e5 / 2.9, 1070.0))
        found = rod.Scene(soft, *terms, nodes=nodes).statics().solve()
        assert found.success and found.stable
        heights.append(found.tip[0])
    assert np.ptp(heights) < 2e-3 * 0.3 and heights[-1] < -0.27


def test_rows_of_many_and_of_a_sweep_are_judged_one_by_one() -> None:
    scene = loaded("weight", "planar", 8)
    rows = np.linspace(5.0, 100.0, 25)[:, None] * np.array([1.0, 0.0, 0.2]) / np.hypot(1.0, 0.2)
    many, sweep = scene.statics().solve_many(rows), scene.statics().sweep(rows)
    for batch in (many, sweep):
        assert batch.success.all() and set(batch.branch) <= {"unique", "followed"}
    assert many.states == pytest.approx(sweep.states, abs=1e-6)


def test_rows_near_states_at_rest_are_moved_there_and_others_are_loaded_from_nothing() -> None:
    scene = loaded("tip force", "kirchhoff", 5)
    rows = np.array([[3.0, 1.0, -8.0], [5.0, 0.5, -4.0], [0.2, 0.1, 0.1]])
    base = scene.statics().solve_many(rows)
    moved = scene.statics().solve_many(1.05 * rows, near=base.states)
    fresh = scene.statics().solve_many(1.05 * rows)
    assert moved.success.all() and fresh.success.all()
    np.testing.assert_allclose(moved.states, fresh.states, atol=1e-7)
    nowhere = base.states + 0.1
    np.testing.assert_allclose(scene.statics().solve_many(1.05 * rows, near=nowhere).states, fresh.states, atol=1e-7)
    with pytest.raises(ValueError, match="near"):
        scene.statics().solve_many(rows, near=base.states[:2])
