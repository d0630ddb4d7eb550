"""What is made of a scene can be copied, sent away, put back and shared by threads: the same numbers, always."""

import copy
import pickle
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from joblib import Parallel, delayed

from pisplit.models import rod
from pisplit.models.rod.dynamics.propagation import Propagation

STEEL = rod.Elastic(207e9, 207e9 / 2.6, 8000.0)
PULLS = 1e-3 * np.array([[1.0, 0.0], [2.0, -1.0], [1.0, 1.5], [-0.5, 2.0]])


def arm(strains: str = "planar", *damping: rod.KelvinVoigt) -> rod.Scene:
    """A thin rod with gravity, drag and two tendons."""
    return rod.Scene(
        rod.Rod(0.5, rod.Circle(1e-3), STEEL, strains),
        rod.Gravity((-9.81, 0.0, 0.0)),
        rod.QuadraticDrag(1e-3),
        rod.Tendons([[0.015, 0.0], [-0.015, 0.0]], rod.Displacement(1e-4)),
        *damping,
        nodes=3 if strains == "planar" else 2,
    )


DAMPED = rod.KelvinVoigt(bending=5e-4, torsion=5e-4)
BENT = rod.KelvinVoigt(bending=5e-4)
MOVERS: dict[str, Callable[[], Propagation]] = {
    "idas": lambda: arm("planar", BENT).simulator(0.02),
    "gauss": lambda: arm("planar", BENT).stepper(0.02, step=5e-3),
    "variational": lambda: arm("kirchhoff").stepper(0.02, step=1e-2),
}
CARRIERS: dict[str, Callable[[Any], Any]] = {"pickle": lambda x: pickle.loads(pickle.dumps(x)), "copy": copy.deepcopy}


@pytest.fixture(params=MOVERS)
def plant(request: pytest.FixtureRequest) -> Propagation:
    """A plant that has been stepped."""
    made = MOVERS[request.param]()
    made.reset([1e-3, 1e-3])
    assert made.step(PULLS[0]).ok
    return made


@pytest.mark.parametrize("carrier", CARRIERS)
def test_a_plant_in_use_goes_on_elsewhere_to_the_last_bit(plant: Propagation, carrier: str) -> None:
    twin = CARRIERS[carrier](plant)
    for pulls in PULLS[1:]:
        assert np.array_equal(twin.step(pulls).state, plant.step(pulls).state)
    assert np.array_equal(twin.state, plant.state)
    assert np.array_equal(twin.run(PULLS).x, plant.run(PULLS).x)


def test_a_plant_goes_back_to_its_snapshot_to_the_last_bit(plant: Propagation) -> None:
    mark = pickle.loads(pickle.dumps(plant.snapshot()))
    first = [plant.step(pulls).state for pulls in PULLS]
    plant.restore(mark)
    assert np.array_equal([plant.step(pulls).state for pulls in PULLS], first)
    fresh = copy.deepcopy(plant)
    fresh.reset()
    fresh.restore(mark)
    assert np.array_equal([fresh.step(pulls).state for pulls in PULLS], first)


def test_a_snapshot_before_the_first_state_is_one_too() -> None:
    plant = MOVERS["gauss"]()
    mark = plant.snapshot()
    plant.reset()
    plant.restore(mark)
    with pytest.raises(RuntimeError, match=r"reset\(\)"):
        plant.step(PULLS[0])


def test_snapshots_of_other_plants_are_refused() -> None:
    plant, other = MOVERS["gauss"](), MOVERS["idas"]()
    other.reset()
    for wrong in (
        other.snapshot(),
        MOVERS["variational"]().snapshot().__class__("Gauss", other.input_names, (1.0,)),
        3,
    ):
        with pytest.raises(ValueError, match="snapshot") as caught:
            plant.restore(wrong)  # type: ignore[arg-type]
        assert "\n" not in str(caught.value)


def test_a_plant_goes_to_any_state(plant: Propagation) -> None:
    """The fields measured are those of the state, and the next step is that of a trajectory from it."""
    x0 = plant.state
    x0[: plant.scene.n_strains] *= 1.1
    assert np.array_equal(plant.reset(x0=x0), plant.scene.fields(x0).ravel())
    assert plant.step(PULLS[0]).ok
    assert np.array_equal(plant.state, plant.run(PULLS[:1], x0).x[-1])
    with pytest.raises(ValueError, match="both are given"):
        plant.reset([0.0, 0.0], x0=x0)
    with pytest.raises(ValueError, match="x0"):
        plant.reset(x0=x0[:-1])


def test_a_plant_names_what_it_measures_and_takes(plant: Propagation) -> None:
    assert len(plant.state_names) == len(plant.state_units) == plant.n_states
    assert plant.state_names[:1] == ("p_x[1]",) and plant.state_units[0] == "m" and plant.state_units[-1] == "rad/s"
    assert plant.input_names == ("tendons[0]", "tendons[1]") and plant.input_units == ("m", "m")


def test_inputs_have_the_units_of_what_reads_them() -> None:
    body = rod.Rod(0.5, rod.Circle(1e-3), STEEL)
    scene = rod.Scene(
        body,
        rod.Gravity(rod.Input("g", 3)),
        rod.TipWrench(rod.Input("f", 3), rod.Input("m", 3)),
        rod.DistributedWrench(force=rod.Input("q", 3)),
        rod.Tendons([[0.01, 0.0]], rod.Tension()),
        rod.Chambers.parallel(area=1e-5, offset=5e-3, angles_deg=(0,)),
        rod.Base(spin=rod.Input("spin", 3)),
    )
    units = dict(zip(scene.input_names, scene.input_units, strict=True))
    found = {name.split("[")[0]: unit for name, unit in units.items()}
    assert [found[k] for k in ("g", "f", "m", "q", "tendons", "spin")] == ["m/s^2", "N", "N m", "N/m", "N", "rad/s"]
    assert "Pa" in found.values()


@pytest.mark.parametrize("carrier", CARRIERS)
def test_everything_a_user_holds_travels_after_use(carrier: str) -> None:
    carry, scene = CARRIERS[carrier], arm("kirchhoff", DAMPED)
    statics = scene.statics()
    eq, target = statics.solve(PULLS[0]), [0.0, 0.1, np.nan]
    start = [1e-3, 1e-3]
    assert np.array_equal(carry(statics).solve(PULLS[1]).state, statics.solve(PULLS[1]).state)
    assert np.array_equal(carry(statics).solve_many(PULLS).states, statics.solve_many(PULLS).states)
    assert np.array_equal(carry(eq).tip, eq.tip)
    assert np.array_equal(carry(statics.sensitivity(eq.state)).jacobian, statics.sensitivity(eq.state).jacobian)
    assert carry(statics.stability(eq.state)).margin == statics.stability(eq.state).margin
    found = statics.inverse(target, start=start)
    assert np.array_equal(carry(found).equilibrium.tip, found.equilibrium.tip)
    tip = eq.tip + np.array([1e-3, 0.0, -1e-3])
    assert np.array_equal(carry(statics.pin_tip(tip)).force, carry(statics).pin_tip(tip).force)
    fields = scene.field_map(4)
    assert np.array_equal(carry(fields).evaluate(eq.state), fields.evaluate(eq.state))
    assert np.array_equal(carry(scene.linearise(eq.state)).A, scene.linearise(eq.state).A)
    modes = scene.modes(eq.state, 2)
    assert np.array_equal(carry(modes).displacements(3), modes.displacements(3))
    coordinates = scene.coordinates(4)
    y = fields.evaluate(eq.state).ravel()
    assert np.array_equal(np.asarray(carry(coordinates).function(y)), np.asarray(coordinates.function(y)))
    run = scene.stepper(0.02, step=1e-2).run(PULLS[:2], eq.state, energy=True, check=False)
    assert np.array_equal(carry(run).fields(3), run.fields(3))
    assert np.array_equal(carry(run.energy()).imbalance, run.energy().imbalance)
    assert np.array_equal(carry(run).energy().dissipated, run.energy().dissipated)


def test_statics_go_to_workers_after_use() -> None:
    statics = arm().statics()
    here = [statics.solve(pulls).state for pulls in PULLS]
    there = Parallel(2)(delayed(statics.solve)(pulls) for pulls in PULLS)
    assert np.array_equal([found.state for found in there], here)


def test_the_order_of_questions_does_not_matter() -> None:
    """KINSOL keeps a residual from one call to the next, the integrators a step: to the last bit, none shows."""
    statics = arm("kirchhoff", DAMPED).statics()
    rng = np.random.default_rng(0)
    inputs = rng.uniform(-4e-3, 6e-3, (40, 2))
    here = [statics.solve(u).state for u in inputs]
    for _ in range(3):
        for k in rng.permutation(len(inputs)):
            assert np.array_equal(statics.solve(inputs[k]).state, here[k])
    moving = MOVERS["idas"]()
    x0 = moving.scene.statics().solve([1e-3, 1e-3]).state
    ends = [moving.run(u[None, :], x0).x[-1] for u in PULLS]
    for k in (2, 0, 3, 1):
        assert np.array_equal(moving.run(PULLS[k : k + 1], x0).x[-1], ends[k])


@pytest.fixture
def restless() -> Iterator[None]:
    """Threads that give way to one another as often as they can."""
    usual = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(usual)


def test_threads_that_share_a_scene_get_the_numbers_of_one(restless: None) -> None:
    """Rootfinders and integrators of CasADi write into memory of their own; unguarded this ends the process."""
    scene = arm("planar", BENT)
    statics, idas, gauss = scene.statics(), scene.simulator(0.02), scene.stepper(0.02, step=5e-3)
    x0 = statics.solve([1e-3, 1e-3]).state
    inputs = np.random.default_rng(0).uniform(-2e-3, 4e-3, (24, 2))
    asked: list[Callable[[np.ndarray], np.ndarray]] = [
        lambda u: statics.solve(u).state,
        lambda u: statics.solve_many([u, 0.5 * u]).states,
        lambda u: statics.sweep([u, 0.9 * u]).states,
        lambda u: statics.sensitivity(x0).jacobian,
        lambda u: scene.linearise(np.concatenate([x0[:-2], u])).A,
        lambda u: scene.fields(x0 + u[0]),
        lambda u: idas.run([u], x0).x,
        lambda u: gauss.run([u], x0).x,
        lambda u: gauss.sensitivity(x0, u).d_input,
    ]
    jobs = [(question, u) for u in inputs for question in asked]
    alone = [question(u) for question, u in jobs]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda job: job[0](job[1]), jobs))
    assert all(np.array_equal(a, b) for a, b in zip(alone, together, strict=True))


def test_a_plant_takes_the_steps_of_several_threads_one_by_one(restless: None) -> None:
    """Sixteen equal commands, whoever gives them, are sixteen steps."""
    plants = [MOVERS["gauss"]() for _ in range(2)]
    for plant in plants:
        plant.reset()
    for _ in range(16):
        plants[0].step(PULLS[0])
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda _: plants[1].step(PULLS[0]), range(16)))
    assert np.array_equal(plants[0].state, plants[1].state)


def test_arrays_handed_out_and_taken_in_are_nobody_elses(plant: Propagation) -> None:
    before = plant.state
    plant.state[:] = 0.0
    assert np.array_equal(plant.state, before)
    x0, u = before.copy(), PULLS.copy()
    plant.reset(x0=x0)
    run = plant.run(u, x0)
    kept = run.x.copy()
    x0[:], u[:] = 0.0, 0.0
    assert np.array_equal(plant.state, before) and np.array_equal(run.x, kept) and np.array_equal(run.u, PULLS)
    last = plant.step(PULLS[0])
    measured = last.state.copy()
    last.state[:] = 0.0
    assert np.array_equal(plant.scene.fields(plant.state).ravel(), measured)


def test_results_share_no_arrays() -> None:
    scene = arm("planar", BENT)
    found = scene.inverse([0.05, np.nan, np.nan], start=[1e-3, 1e-3])
    u = found.u.copy()
    found.equilibrium.state[:] = 0.0
    assert np.array_equal(found.u, u)
    run = scene.stepper(0.02, step=5e-3).run(PULLS, energy=True, check=False)
    energy = run.energy()
    energy.t[:] = 0.0
    energy.work["Tendons"][:] = 0.0
    assert run.t[-1] > 0.0 and run.work is not None and run.work[-1].any()
    state = np.zeros(scene.n_states)
    modes = scene.modes(state, 1)
    shapes = modes.displacements(2)
    state[:] = 1.0
    assert np.array_equal(modes.displacements(2), shapes)
    for kept in (scene.rule.nodes, scene.rule.weights, scene.rule.integration, scene.nominal_strains):
        with pytest.raises(ValueError, match="read-only"):
            kept[0] = 0.0


@pytest.mark.parametrize("size", [1e160, 1e300])
def test_states_beyond_any_rod_are_refused_in_one_line(size: float) -> None:
    """Where numbers overflow there is no answer: never NaN, never the value before."""
    scene = arm("planar", BENT)
    n = scene.n_strains
    state = np.concatenate([np.full(2 * n, size), np.zeros(2)])
    for question in (
        lambda: scene.fields(state),
        lambda: scene.energies(state[None, :]),
        lambda: scene.linearise(state),
        lambda: scene.modes(state),
        lambda: scene.statics().sensitivity(state),
        lambda: scene.stepper(0.02).reset(x0=state),
    ):
        with pytest.raises(ValueError, match="overflow") as caught:
            question()
        assert "\n" not in str(caught.value)
    plant = scene.stepper(0.02)
    with pytest.raises(RuntimeError, match="reset"):
        plant.step([0.0, 0.0])
    for moving in (plant, scene.simulator(0.02)):
        failed = moving.run(np.zeros((1, 2)), state)
        assert not failed.success and failed.message and "\n" not in failed.message


def test_an_equilibrium_that_buckles_has_no_derivatives() -> None:
    """At the Euler load of a column the tangent stiffness is singular: said, or a compliance beyond all measure."""
    body = rod.Rod(0.4, rod.Circle(1e-3), STEEL, "planar")
    scene = rod.Scene(body, rod.TipWrench(force=rod.Input("f", 3)), nodes=2)
    state = np.zeros(scene.n_states)
    low, high = 0.5, 2.0
    euler = np.pi**2 * body.stiffness[1] / (4.0 * body.length**2)
    for _ in range(60):  # the buckling load of this grid
        load = 0.5 * (low + high)
        state[-1] = -load * euler
        low, high = (low, load) if scene.statics().stability(state).margin < 0.0 else (load, high)
    try:
        assert np.abs(scene.statics().sensitivity(state).compliance).max() > 1e9 * body.length**3 / body.stiffness[1]
    except ValueError as error:
        assert "singular" in str(error) and "\n" not in str(error)
