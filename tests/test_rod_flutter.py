"""Equilibria under loads without an energy are not called stable where a vibration grows about them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pisplit.models import rod
from pisplit.models.rod.analysis.modes import natural_modes

#: EI = 1, L = 1, mass per length 1: loads are in EI/L^2, rates in those of the rod.
DRAG = rod.LinearDrag(0.02)


def body(strains: str = "planar") -> rod.Rod:
    stiffness = rod.Stiffness(bending=(1.0, 1.0), torsion=0.8, shear=(1e4, 1e4), stretch=1e4, density=1.0)
    return rod.Rod(1.0, rod.GeneralSection(1.0, (1e-8, 1e-8)), stiffness, strains)


def column(*terms: Any, strains: str = "planar", nodes: int = 6) -> rod.Scene:
    """A column whose tip is pressed by a force that turns with it."""
    force = rod.TipWrench(force=rod.Input("f", 3), follower=True)
    return rod.Scene(body(strains), force, *terms, nodes=nodes)


@pytest.mark.parametrize(
    ("damping", "critical"),
    [((), 20.051), ((DRAG,), 20.051), ((rod.Retardation(1e-3),), 10.94)],
    ids=["undamped", "drag", "little damping of the material"],
)
@pytest.mark.parametrize("strains", ["planar", "kirchhoff"])
def test_becks_column_flutters_at_its_load(strains: str, damping: tuple[Any, ...], critical: float) -> None:
    """M. Beck, ZAMP 3 (1952): 20.05 EI/L^2; with vanishing damping of the material 10.94 (Bolotin, 1963)."""
    statics = column(*damping, strains=strains).statics()
    below, above = (statics.solve([0.0, 0.0, -part * critical]) for part in (0.98, 1.3))
    assert below.success and below.stable and below.branch == "followed"
    assert not above.success and above.stable is False and above.branch == "flutters" and "flutter" in above.message
    assert above.margin > 0.5 and 1.3 * critical * above.load_factor == pytest.approx(critical, rel=2e-3)
    assert np.abs(above.tip - [0.0, 0.0, 1.0]).max() < 1e-9
    near = statics.solve([0.0, 0.0, -1.3 * critical], guess=np.zeros(statics.scene.n_strains))
    assert near.branch == "flutters" and not near.success


def test_leipholz_column_flutters_at_its_load() -> None:
    """H. Leipholz (1962): a tangential load along the column, 40.05 EI/L^3."""
    scene = rod.Scene(body(), rod.DistributedWrench(force=rod.Input("q", 3), follower=True), DRAG, nodes=8)
    found = scene.statics().solve([0.0, 0.0, -50.0])
    assert found.branch == "flutters" and 50.0 * found.load_factor == pytest.approx(40.05, rel=2e-3)


def test_a_round_rod_without_damping_whirls_under_any_axial_moment() -> None:
    """E. L. Nicolai (1928); damping lets it stand some."""
    twist = rod.TipWrench(moment=(0.0, 0.0, 0.1), follower=True)
    scene = rod.Scene(body("kirchhoff"), twist, nodes=5)
    assert scene.statics().solve().branch == "flutters"
    assert (scene + rod.Retardation(0.1)).statics().solve().success


def test_rows_that_flutter_are_flagged() -> None:
    statics = column(DRAG).statics()
    rows = np.outer([5.0, 15.0, 19.0, 21.0, 30.0], [0.0, 0.0, -1.0])
    for batch in (statics.solve_many(rows), statics.sweep(rows)):
        assert batch.success.tolist() == [True] * 3 + [False] * 2
        assert batch.branch.tolist() == ["followed"] * 3 + ["flutters"] * 2
    with pytest.raises(RuntimeError, match="flutter"):
        statics.scene.simulator(0.1).reset(rows[-1])


@pytest.mark.parametrize("load", [2.0, 8.0])
def test_a_bent_rod_beside_its_motion(load: float) -> None:
    """Under a force across that turns with the tip of a spatial rod it leaves its plane, or does not."""
    scene = column(rod.Retardation(0.02), strains="kirchhoff", nodes=4)
    u = np.array([load, 0.0, 0.0])
    found = scene.statics().solve(u)
    start = found.state.copy()
    start[: scene.n_strains] += 1e-4 * np.tile([1.0, 0.0, 0.0], 4)
    motion = scene.stepper(0.1, step=0.1).run(np.tile(u, (60, 1)), start, check=False)
    across = np.abs(motion.fields([1.0])[:, 0, 1])
    assert found.success == (across[-15:].max() < across[:15].max())
    stability = scene.statics().stability(found.state)
    assert stability.stable == found.success and stability.margin > 0.0
    values = scene.linearise(found.state).eigenvalues
    assert stability.growth == pytest.approx(max(0.0, values.real.max()), rel=1e-3, abs=1e-12)


@pytest.mark.parametrize("load", [15.0, 19.0])
def test_joints_are_judged_with_their_rod(load: float) -> None:
    """A column on a hinge with a spring flutters below the load of the clamped one."""
    hinge = rod.Base(hinge=(0, 1, 0), stiffness=5.0)
    scene = column(DRAG, hinge, nodes=5)
    found = scene.statics().solve([0.0, 0.0, -load])
    values = scene.linearise(found.state).eigenvalues
    assert found.success == bool((values.real < 1e-6).all()) == (load < 16.0)
    assert found.stable == found.success and (found.success or "flutters" in found.message)


@pytest.mark.parametrize("load", [30.0, 50.0])
def test_held_tips_are_judged_on_what_they_leave(load: float) -> None:
    """The tip slides without turning, a force in the middle turns with the rod."""
    push = rod.PointWrench(0.5, force=(0.0, 0.0, -load), follower=True)
    free = rod.Scene(body(), push, DRAG, nodes=5)
    guided = free + rod.HeldTip(rotation=(0.0, 0.0, 0.0))
    found = guided.statics().solve()
    values = natural_modes(guided, found.state).eigenvalues
    assert found.success == bool((values.real < 0.0).all()) == (load < 40.0)
    clamped = free.statics().clamp_tip((0.0, 0.0, 0.99), np.eye(3))
    held = free + rod.HeldTip((0.0, 0.0, 0.99), (0.0, 0.0, 0.0))
    assert clamped.stable == bool((natural_modes(held, clamped.state).eigenvalues.real < 0.0).all())
