"""A tip that is held in motion: frequencies, reactions, energy, no drift, and paths along which it is driven."""

from __future__ import annotations

import warnings

import casadi as ca
import numpy as np
import pytest

from pisplit.models import rod

LENGTH = 0.3
PUSH = rod.Input("push", 3)


def body(strains: str = "planar", radius: float = 5e-3) -> rod.Rod:
    return rod.Rod(LENGTH, rod.Circle(radius), rod.Elastic(2e6, 8e5, 1070.0), strains)


def bent(strains: str, *terms: object, nodes: int = 6, **held: object) -> rod.Scene:
    hold = rod.HeldTip(position=(0.05, 0.0, 0.27), **held)  # type: ignore[arg-type]
    return rod.Scene(body(strains), rod.PointWrench(0.15, PUSH), *terms, hold, nodes=nodes)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("held", "roots", "strains"),
    [
        ({"position": (0.0, 0.0, 0.0), "axes": "xy"}, (3.926602, 7.068583), "planar"),
        ({"position": (0.0, 0.0, 0.0), "axes": "xy", "rotation": (0.0, 0.0, 0.0)}, (4.730041, 7.853205), "planar"),
        ({"position": (0.0, 0.0, 0.0), "axes": "xy", "rotation": (0.0, 0.0, 0.0)}, (4.730041, 7.853205), "kirchhoff"),
        ({"rotation": (0.0, 0.0, 0.0)}, (2.365020, 5.497804), "planar"),
    ],
)
def test_frequencies_are_those_of_beams_with_two_ends_held(held: dict, roots: tuple, strains: str) -> None:
    """Clamped-pinned, clamped-clamped and clamped-guided (Blevins, *Formulas for Natural Frequency*, table 8-1).

    Of the spatial rod each of them is there twice, beside torsion.
    """
    thin = body(strains, 1e-3)  # slender: no rotary inertia
    scene = rod.Scene(thin, rod.HeldTip(**held), nodes=10 if strains == "planar" else 6)
    found = scene.modes(scene.statics().solve().state)
    rate = np.sqrt(thin.stiffness[0] / thin.mass_per_length) / LENGTH**2
    for root in roots if strains == "planar" else roots[:1]:
        off = np.abs(2.0 * np.pi * found.frequency / (root**2 * rate) - 1.0)
        assert np.sort(off)[: 1 if strains == "planar" else 2] == pytest.approx(0.0, abs=3e-4)
    assert np.abs(found.damping).max() < 1e-6  # nothing of what keeps the conditions is among the modes


def test_a_propped_beam_stands_on_three_eighths_of_its_weight() -> None:
    scene = rod.Scene(body(), rod.Gravity((-1e-4, 0.0, 0.0)), rod.HeldTip(position=(0.0, 0.0, 0.0), axes="x"), nodes=6)
    rest = scene.statics().solve()
    weight = 1e-4 * scene.rod.mass_per_length * LENGTH
    force = scene.reactions(rest.state)
    assert rest.success and rest.stable and force[0] == pytest.approx(0.375 * weight, rel=1e-4)
    assert np.abs(force[1:]).max() < 1e-9 * weight + 1e-18


@pytest.mark.parametrize(("strains", "turn"), [("planar", None), ("kirchhoff", (0.0, 0.4, 0.0))])
def test_equilibria_are_those_of_a_tip_that_is_moved_there(strains: str, turn: tuple | None) -> None:
    """The same shape and wrench as ``pin_tip`` and ``clamp_tip``, at rest in the equations of motion."""
    scene = bent(strains, rotation=turn)
    rest = scene.statics().solve()
    free = scene.without(rod.HeldTip).statics()
    if turn is None:
        moved = free.pin_tip((0.05, 0.0, 0.27))
    else:
        c, s = np.cos(turn[1]), np.sin(turn[1])
        moved = free.clamp_tip((0.05, 0.0, 0.27), [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    assert rest.success and rest.branch == moved.branch and rest.state == pytest.approx(moved.state, abs=1e-9)
    wrench = np.concatenate([moved.force, moved.moment])
    assert scene.reactions(rest.state) == pytest.approx(wrench, abs=1e-10)
    n = scene.n_strains
    assert np.abs(np.asarray(scene.acceleration(rest.state[:n], np.zeros(n), np.zeros(3)))).max() < 1e-5
    slope = (rest.margin, scene.statics().sensitivity(rest.state).jacobian)
    assert 0.0 < slope[0] < 1.0 and np.abs(slope[1][:3]).max() < 1e-9  # no push moves a held tip


@pytest.mark.parametrize(("turns", "nodes"), [(0.4, 4), (0.9, 4), (-1.2, 6)])
def test_a_tip_that_is_twisted_by_many_turns_stores_all_of_them(turns: float, nodes: int) -> None:
    """At rest a pulled rod carries the torque G J 2 pi turns / L, not that of the same frame reached the short way."""
    thin = body("kirchhoff")
    pull = rod.TipWrench(force=(0.0, 0.0, 200.0 * thin.stiffness[0] / LENGTH**2))
    slides = rod.HeldTip(position=(0.0, 0.0, 0.0), axes="xy", rotation=rod.Input("turn", 3))
    scene = rod.Scene(thin, pull, slides, nodes=nodes)
    rest = scene.statics().solve([0.0, 0.0, 2.0 * np.pi * turns])
    torque = thin.stiffness[2] * 2.0 * np.pi * turns / LENGTH
    assert rest.success and rest.branch == "followed"
    assert scene.reactions(rest.state) == pytest.approx([0.0, 0.0, 0.0, 0.0, 0.0, torque], abs=1e-7)


@pytest.mark.parametrize(("pull", "stands"), [(1.0, True), (200.0, False)])
def test_stability_of_a_twisted_rod_on_few_nodes_is_not_trusted(pull: float, stands: bool) -> None:
    """2.3 turns are a moment of 11.6 EI/L: too much for a pull of EI/L^2 (9.2), two fifths of what 200 of them bear.

    Four nodes say the opposite, and that more should be tried.
    """
    thin = body("kirchhoff")
    force = rod.TipWrench(force=(0.0, 0.0, pull * thin.stiffness[0] / LENGTH**2))
    slides = rod.HeldTip(position=(0.0, 0.0, 0.0), axes="xy", rotation=(0.0, 0.0, 4.6 * np.pi))
    scene = rod.Scene(thin, force, slides, nodes=4)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", rod.Unresolved)
        found = scene.statics().solve()
    assert found.success == stands
    told = "".join(str(w.message) for w in said) if stands else found.message
    assert "stability is that of the grid" in told and int(told.split("try nodes=")[1]) in range(8, 14)


def test_the_tip_stays_where_it_is_for_ten_seconds() -> None:
    """1e-10 L after 10 s and 500 steps of every scheme, with rates that do not move it either."""
    scene = bent("planar", rod.Retardation(0.02), nodes=8)
    start = scene.statics().solve().state
    push = np.zeros((500, 3))
    push[::50, 0] = 0.2
    n, ends = scene.n_strains, []
    for plant in (scene.simulator(0.02), scene.fast_stepper(0.02)):
        found = plant.run(push, start, check=False)
        fields = found.fields(1)[:, 0]
        assert found.success and np.abs(fields[:, [0, 2]] - (0.05, 0.27)).max() < 1e-10 * LENGTH
        assert np.abs(fields[:, 18:21]).max() < 1e-10 and np.ptp(found.fields(2)[:, 0, 0]) > 1e-3
        ends.append(found.x[-1, :n])
    assert ends[0] == pytest.approx(ends[1], abs=2e-3)


@pytest.mark.filterwarnings("ignore::pisplit.models.rod.Unresolved")
@pytest.mark.parametrize("strains", ["planar", "kirchhoff"])
def test_an_undamped_rod_keeps_its_energy_with_its_tip_held(strains: str) -> None:
    scene = bent(strains, nodes=4 if strains == "planar" else 5)
    rest = scene.statics().solve([0.1, 0.02, 0.0])
    assert rest.success
    at = rest.state
    at[2 * scene.n_strains :] = 0.0
    found = scene.stepper(0.01, step=1e-3).run(np.zeros((25, 3)), at, energy=True, check=False)
    energy = found.energy()
    swing = float(energy.stored.kinetic.max())
    assert found.success and swing > 0.0
    assert np.abs(energy.stored.total - energy.stored.total[0]).max() < 1e-5 * swing


def test_a_tip_driven_along_the_path_of_a_free_one_needs_no_force() -> None:
    """A rod that falls freely, and the same whose tip is led where that went: the same shapes, hardly a reaction.

    Inputs move linearly from row to row, so that the difference falls with the square of the interval.
    """
    free = rod.Scene(body(), rod.Gravity((-9.81, 0.0, 0.0)), rod.Retardation(0.02), nodes=5)
    led, n, off = free + rod.HeldTip.driven(), free.n_strains, []
    xi, xi_t, xi_tt, u, balance = free.dynamic_balance
    at = [balance.motion.tip, balance.motion.tip_velocity, balance.motion.acceleration_at([LENGTH])]
    tip = ca.Function("tip", [xi, xi_t, xi_tt, u], [ca.vertcat(*at)])
    for dt, late in ((0.008, 4), (0.004, 8)):  # a straight rod cannot be led along its axis: from 32 ms on
        fall = free.stepper(dt, step=1e-3).run(np.zeros((int(0.2 / dt), 0)), np.zeros(2 * n), check=False)
        bends = [free.acceleration(x[:n], x[n:], np.empty(0)) for x in fall.x]
        path = [tip(x[:n], x[n:], bend, np.empty(0)) for x, bend in zip(fall.x, bends, strict=True)]
        rows = np.array(path).reshape(-1, 9)[late:]
        found = led.stepper(dt, step=1e-3).run(rows[1:], np.concatenate([fall.x[late], rows[0]]), check=False)
        assert found.success
        off.append(np.abs(found.fields(3)[..., :3] - fall.fields(3)[late:, :, :3]).max() / LENGTH)
    assert off[1] < 2e-3 and off[0] / off[1] > 3.0
    weight = 9.81 * free.rod.mass_per_length * LENGTH
    assert np.median(np.abs(found.reactions()[:, [0, 2]])) < 0.02 * weight


def test_three_turns_twist_a_rod_that_is_driven_slowly() -> None:
    """M = G J theta / L for many turns of a tip that is clamped and driven (Love, section 270)."""
    thick = rod.Rod(LENGTH, rod.Circle(5e-3), rod.Elastic(2e6, 8e5, 1070.0), "extensible")
    scene = rod.Scene(thick, rod.Retardation(0.02), rod.HeldTip.driven(rotation=True), nodes=4)
    share = np.linspace(0.0, 1.0, 121)
    angle = 6.0 * np.pi * share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    rows = rod.tip_commands(0.025, np.tile([0.0, 0.0, 1.02 * LENGTH], (121, 1)), np.outer(angle, [0.0, 0.0, 1.0]))
    start = scene.statics().solve(rows[0])
    assert start.success
    commands = np.vstack([rows[1:], np.tile(rows[-1], (40, 1))])
    found = scene.fast_stepper(0.025).run(commands, start.state, check=False)
    assert found.success, found.message
    moment = thick.stiffness[2] * angle[-1] / LENGTH
    assert found.reactions()[-1, 5] == pytest.approx(moment, rel=1e-4)


def test_what_cannot_be_held_is_said() -> None:
    with pytest.raises(ValueError, match="holds nothing"):
        rod.HeldTip()
    with pytest.raises(ValueError, match="axes"):
        rod.HeldTip(position=(0, 0, 0), axes="xq")
    with pytest.raises(ValueError, match="out of the x-z plane"):
        rod.Scene(body(), rod.HeldTip(position=(0.0, 0.1, 0.2)))
    with pytest.raises(ValueError, match="base at rest"):
        rod.Scene(body(), rod.Base(spin=(0.0, 1.0, 0.0)), rod.HeldTip(position=(0.0, 0.0, 0.2)))
    with pytest.raises(ValueError, match="one HeldTip"):
        rod.Scene(body(), rod.HeldTip(rotation=(0, 0, 0)), rod.HeldTip(position=(0, 0, 0.2)))
    scene = bent("planar", rod.Retardation(0.02), nodes=4)
    with pytest.raises(ValueError, match="from where it is held"):
        scene.simulator(0.02).run(np.zeros((2, 3)), np.zeros(scene.n_states), check=False)
    with pytest.raises(ValueError, match="velocity is not"):
        rod.Scene(body(), rod.HeldTip(position=rod.Input("p", 3)), nodes=4).simulator(0.02)
    with pytest.raises(ValueError, match="two"):
        rod.tip_commands(0.1, np.zeros((1, 3)))
    with pytest.raises(ValueError, match="free"):
        scene.without(rod.HeldTip).reactions(np.zeros(scene.n_states))
    straight = rod.Scene(body(), rod.HeldTip(position=(0.0, 0.0, LENGTH)), nodes=4)
    with pytest.raises(ValueError, match="every direction"):
        straight.simulator(0.02).run(np.zeros((2, 0)), np.zeros(straight.n_states), check=False)
    driven = rod.Scene(body(), rod.HeldTip.driven(), nodes=4)
    with pytest.raises(ValueError, match="driven"):
        driven.energies(np.zeros((1, driven.n_states)))
    far = rod.Scene(body(), rod.HeldTip(position=(0.0, 0.0, 2.0 * LENGTH)), nodes=4).statics().solve()
    assert not far.success and "moved" in far.message


def test_a_held_scene_is_told_from_a_free_one_and_pickles() -> None:
    import pickle

    scene = bent("planar", nodes=8)
    assert scene.fingerprint() != scene.without(rod.HeldTip).fingerprint()
    again = pickle.loads(pickle.dumps(scene))
    assert again == scene and again.fingerprint() == scene.fingerprint() and "pinned tip" in str(scene)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert scene.statics().solve_many(np.zeros((2, 3))).success.all()
