"""A tip that is held on a base with joints: Euler's columns, beams with such ends, and the buckled strut."""

import warnings

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk

from pisplit.models import rod

LENGTH = 0.3
HINGE, GUIDE = rod.Base(hinge=(0, 1, 0)), rod.Base(slides="x")
PINNED = rod.HeldTip(position=(0.0, 0.0, 0.0), axes="x")
CLAMPED = rod.HeldTip(position=(0.0, 0.0, 0.0), axes="x", rotation=(0.0, 0.0, 0.0))
GUIDED = rod.HeldTip(rotation=(0.0, 0.0, 0.0))


def body(strains: str = "planar") -> rod.Rod:
    return rod.Rod(LENGTH, rod.Circle(1e-3), rod.Elastic(2e6, 8e5, 1070.0), strains)


@pytest.mark.parametrize(
    ("base", "tip", "critical", "root"),
    [
        (HINGE, PINNED, np.pi**2, np.pi),
        (HINGE, CLAMPED, 20.190729, 3.926602),
        (rod.Base(), PINNED, 20.190729, 3.926602),
        (rod.Base(), CLAMPED, 4.0 * np.pi**2, 4.730041),
        (GUIDE, PINNED, np.pi**2 / 4.0, np.pi / 2.0),
        (GUIDE, CLAMPED, np.pi**2, 2.365020),
        (HINGE, GUIDED, np.pi**2 / 4.0, np.pi / 2.0),
    ],
)
def test_columns_buckle_and_beams_vibrate_as_euler_says(base, tip, critical, root):
    """The margin of the straight column goes through zero; below it is straight, above it buckles and says so.

    Frequencies: Blevins, *Formulas for Natural Frequency*, table 8-1.
    """
    scene = rod.Scene(body(), base, tip, rod.TipWrench(force=rod.Input("f", 3)), nodes=8)
    unit, statics = scene.rod.stiffness[1] / LENGTH**2, scene.statics()

    def margin(load: float) -> float:
        return statics.margin(scene.at_rest(np.zeros(scene.n_strains), [0.0, 0.0, -load * unit]))

    assert brentq(margin, 0.8 * critical, 1.2 * critical, xtol=1e-6) == pytest.approx(critical, rel=1e-5)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rod.Unresolved)
        below, above = (statics.solve([0.0, 0.0, -part * critical * unit]) for part in (0.9, 1.1))
    assert below.success and below.branch == "followed" and np.abs(below.strains).max() * LENGTH < 1e-6
    assert above.success and above.stable and above.branch == "snapped"
    assert above.load_factor == pytest.approx(1.0 / 1.1, abs=3e-3) and np.abs(above.strains).max() * LENGTH > 1.0
    found = scene.modes(scene.at_rest(np.zeros(scene.n_strains), np.zeros(3))).frequency[0]
    rate = np.sqrt(scene.rod.stiffness[1] / scene.rod.mass_per_length) / LENGTH**2
    assert 2.0 * np.pi * found == pytest.approx(root**2 * rate, rel=3e-4)


BALL = rod.Base(hinge="ball")


@pytest.mark.parametrize(("strains", "base"), [("planar", HINGE), ("kirchhoff", BALL), ("cosserat", BALL)])
def test_a_strut_between_two_pins_is_the_elastica(strains, base):
    """At 0.8 L: force 4 K^2 EI/L^2 with 2 E/K - 1 = 0.8 (Love, *Elasticity*, section 263)."""
    nodes, rel = (10, 1e-6) if strains == "planar" else (7, 1e-3)
    scene = rod.Scene(body(strains), base, rod.HeldTip(position=(0.0, 0.0, 0.8 * LENGTH)), nodes=nodes)
    found = scene.statics().solve()
    square = brentq(lambda m: 2.0 * ellipe(m) / ellipk(m) - 1.8, 0.01, 0.8)
    force = scene.reactions(found.state) / (scene.rod.stiffness[1] / LENGTH**2)
    assert found.success and found.stable and found.branch == "snapped" and found.error < 10.0 * rel
    assert force[2] == pytest.approx(-4.0 * ellipk(square) ** 2, rel=rel)
    assert np.abs(force[[0, 1, 3, 4, 5]]).max() < 1e-6


def test_the_base_turns_while_the_tip_is_moved():
    """Loads, a hinge, a tip far off the way of the clamped rod: no moment at the hinge, the same by another way."""
    terms = HINGE, rod.Gravity((0.3, 0.0, 0.5)), rod.TipWrench(moment=(0.0, 1e-5, 0.0))
    scene = rod.Scene(body(), *terms, rod.HeldTip(position=rod.Input("tip", 3)), nodes=8)
    statics, wanted = scene.statics(), np.array([0.25, 0.0, -0.05])
    found = statics.solve(wanted)
    assert found.success and found.stable and found.branch == "settled" and found.tip == pytest.approx(wanted, abs=1e-9)
    support = scene.base_reactions(found.state)
    weight = scene.rod.mass_per_length * LENGTH * np.array([0.3, 0.0, 0.5])
    assert abs(support[4]) < 1e-10
    assert support[:3] + scene.reactions(found.state)[:3] == pytest.approx(-weight, abs=1e-9)
    path = statics.sweep(np.linspace([0.1, 0.0, 0.25], wanted, 6))
    assert path.success.all() and path.states[-1] == pytest.approx(found.state, abs=1e-7)


def test_motion_between_two_joints_keeps_its_energy_and_does_not_drift():
    """A hinged strut whose tip slides along z, let go bent: 200 Gauss steps without damping."""
    scene = rod.Scene(body(), HINGE, PINNED, rod.Gravity((1.0, 0.0, 0.0)), nodes=4)
    with pytest.warns(rod.Unresolved):
        bent = scene.statics().solve().state
    free = scene.replace(rod.Gravity((0.0, 0.0, 0.0)))
    run = free.stepper(0.02, step=0.002).run(np.empty((20, 0)), bent, energy=True, check=False)
    assert run.success and np.abs(free.fields(run.x, 2)[:, -1, 0]).max() < 1e-11
    assert np.ptp(free.fields(run.x, 3)[:, 1, 0]) > 0.05 * LENGTH
    assert np.abs(run.energy().imbalance).max() < 1e-6 * run.energy().stored.total[0]
