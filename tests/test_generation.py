"""Training data of the arm: inputs, seeds, resumption, static shapes, derivatives, files."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import h5py
import numpy as np
import pytest

from pisplit import Episodes, PhaseSamples
from pisplit.data.actuator import Actuator, ActuatorState
from pisplit.models import rod
from pisplit.models.arm import phase_samples, recording
from pisplit.models.arm.phase_samples import deviations_from_equilibrium, make_phase_samples, strain_rates
from pisplit.models.arm.recording import make_episodes, random_differential, random_displacements
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.rod.equations.prestressed import prestressed_acceleration

STATIONS, STEPS, DT = 3, 24, 0.03
SMALL = {"stations": STATIONS, "seed": 1, "workers": 1, "progress": False}
SCRIPTS = Path(__file__).parent.parent / "scripts"


@pytest.fixture(scope="module")
def arm() -> TendonArm:
    return TendonArm.paper(nodes=3)


@pytest.fixture(scope="module")
def episodes(arm: TendonArm, tmp_path_factory: pytest.TempPathFactory) -> Episodes:
    return make_episodes(arm, tmp_path_factory.mktemp("d1") / "d1.h5", 3, STEPS, DT, **SMALL)


@pytest.fixture(scope="module")
def moves(arm: TendonArm, episodes: Episodes) -> tuple[np.ndarray, np.ndarray]:
    return deviations_from_equilibrium(arm, episodes)


@pytest.fixture(scope="module")
def load_or_make() -> Callable[..., tuple[Episodes, PhaseSamples]]:
    sys.path.insert(0, str(SCRIPTS))
    try:
        spec = importlib.util.spec_from_file_location("generate_data", SCRIPTS / "generate_data.py")
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(SCRIPTS))
    found: Callable[..., tuple[Episodes, PhaseSamples]] = module.load_or_make
    return found


# Inputs ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("steps", [1, 15, 16, 17, 200])
def test_displacements_are_pretension_plus_a_smooth_zero_sum_part(arm: TendonArm, steps: int) -> None:
    u = random_displacements(arm, steps, np.random.default_rng(0))
    assert u.shape == (steps, 3)
    np.testing.assert_allclose(u.sum(axis=1), 3 * arm.pretension, rtol=1e-12)
    assert np.abs(u - arm.pretension).max() <= arm.amplitude
    # From rest: the first step of a raised cosine over 16 steps is 1 % of its height, the largest 10 %.
    padded = np.vstack([arm.rest_inputs, u])
    assert np.abs(padded[1] - padded[0]).max() <= 0.01 * arm.amplitude
    assert np.abs(np.diff(padded, axis=0)).max() <= 0.1 * 2 * arm.amplitude


def test_displacements_reach_their_targets_at_the_knots(arm: TendonArm) -> None:
    u = random_displacements(arm, 64, np.random.default_rng(4))
    rng = np.random.default_rng(4)
    targets = arm.rest_inputs + random_differential(arm, 5, rng)
    np.testing.assert_allclose(u[15::16], targets[1:], atol=1e-15)


def test_amplitudes_fill_the_disc_evenly(arm: TendonArm) -> None:
    moves = random_differential(arm, 20_000, np.random.default_rng(0)) @ arm.differential_basis
    radius = np.linalg.norm(moves, axis=1) / (arm.amplitude * np.sqrt(1.5))
    assert radius.max() <= 1.0 + 1e-12
    assert np.mean(radius < 0.5) == pytest.approx(0.25, abs=0.01)
    np.testing.assert_allclose(np.cov(moves.T), 0.375 * arm.amplitude**2 * np.eye(2), atol=0.02 * arm.amplitude**2)


# Episodes -------------------------------------------------------------------------------------------------------------


def test_episodes_start_from_rest_and_carry_the_states_of_the_simulator(arm: TendonArm, episodes: Episodes) -> None:
    n = arm.scene.n_strains
    assert episodes.extra is not None
    rest = arm.scene.statics().solve(arm.rest_inputs).state
    for x, u, state in zip(episodes.xs, episodes.us, episodes.extra["state"], strict=True):
        assert x.shape == (STEPS + 1, 24 * STATIONS) and u.shape == (STEPS, 3)
        np.testing.assert_allclose(state[0], rest, atol=1e-9)
        assert np.abs(state[0, n : 2 * n]).max() == 0.0
        np.testing.assert_array_equal(state[1:, 2 * n :], u)
        np.testing.assert_array_equal(arm.scene.fields(state, STATIONS).reshape(len(x), -1), x)
    assert np.ptp(episodes.xs[0][:, -24:-21], axis=0).max() > 0.01  # it moves by more than a centimetre


def test_rates_of_strains_are_those_of_a_fine_run(arm: TendonArm, episodes: Episodes) -> None:
    """Step by step, to 5e-4 of their spread: what is calibrated from pairs feels them."""
    assert episodes.extra is not None
    n, fine = arm.scene.n_strains, arm.scene.simulator(dt=DT, rtol=1e-8)
    state, u = episodes.extra["state"][0], episodes.us[0]
    missed = [fine.run(u[k : k + 1], state[k], check=False).x[-1] - state[k + 1] for k in range(0, STEPS, 4)]
    assert np.sqrt(np.mean(np.square(missed)[:, n : 2 * n])) < 5e-4 * state[:, n : 2 * n].std()


def test_the_seed_decides_the_data_and_the_number_of_workers_does_not(
    arm: TendonArm, episodes: Episodes, tmp_path: Path
) -> None:
    two = make_episodes(arm, tmp_path / "two.h5", 3, STEPS, DT, **{**SMALL, "workers": 2})
    for a, b in zip((*episodes.xs, *episodes.us), (*two.xs, *two.us), strict=True):
        assert a.tobytes() == b.tobytes()
    other = make_episodes(arm, tmp_path / "other.h5", 1, STEPS, DT, **{**SMALL, "seed": 2})
    assert np.abs(other.us[0] - episodes.us[0]).max() > 1e-3
    assert np.abs(episodes.us[0] - episodes.us[1]).max() > 1e-3


def test_an_episode_depends_on_its_number_only(arm: TendonArm, episodes: Episodes, tmp_path: Path) -> None:
    one = make_episodes(arm, tmp_path / "one.h5", 1, STEPS, DT, **SMALL)
    assert one.xs[0].tobytes() == episodes.xs[0].tobytes()


def test_episodes_survive_their_file(episodes: Episodes, arm: TendonArm, tmp_path: Path) -> None:
    path = tmp_path / "d1.h5"
    made = make_episodes(arm, path, 1, 3, DT, **SMALL)
    loaded = Episodes.load(path)
    np.testing.assert_array_equal(loaded.xs[0], made.xs[0])
    np.testing.assert_array_equal(loaded.us[0], made.us[0])
    assert loaded.extra is not None and made.extra is not None
    np.testing.assert_array_equal(loaded.extra["state"][0], made.extra["state"][0])
    for name in ("state_names", "input_names", "quantities", "units", "outputs", "dt", "provenance"):
        assert getattr(loaded, name) == getattr(made, name), name
    assert loaded.outputs is not None and loaded.outputs["tip"] == (48, 49, 50)
    assert loaded.quantities is not None and loaded.quantities[:4] == ("p", "p", "p", "R")
    assert not list(tmp_path.glob("*.parts"))


def test_a_broken_run_goes_on_where_it_stopped(
    arm: TendonArm, episodes: Episodes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = recording.EpisodeTask.__call__
    asked: list[int] = []

    def breaking(task: recording.EpisodeTask, k: int) -> Any:
        asked.append(k)
        if asked == [0, 1]:
            raise KeyboardInterrupt
        return whole(task, k)

    monkeypatch.setattr(recording.EpisodeTask, "__call__", breaking)
    with pytest.raises(KeyboardInterrupt):
        make_episodes(arm, tmp_path / "d1.h5", 3, STEPS, DT, **SMALL)
    assert not (tmp_path / "d1.h5").exists()
    found = make_episodes(arm, tmp_path / "d1.h5", 3, STEPS, DT, **SMALL)
    assert asked == [0, 1, 1, 2]
    for a, b in zip(found.xs, episodes.xs, strict=True):
        assert a.tobytes() == b.tobytes()


# Phase samples --------------------------------------------------------------------------------------------------------


def free_states(arm: TendonArm, samples: PhaseSamples) -> np.ndarray:
    coordinates = arm.scene.coordinates(STATIONS).function
    return np.asarray(coordinates.map(len(samples))(samples.x.T)).T


def test_shapes_without_deviations_are_equilibria(
    arm: TendonArm, moves: tuple[np.ndarray, np.ndarray], tmp_path: Path
) -> None:
    n = arm.scene.n_strains
    d2 = make_phase_samples(arm, tmp_path / "d2.h5", 40, moves[1], **SMALL)
    statics = arm.scene.statics()
    strains = free_states(arm, d2)[:, :n]
    residual = statics.residual_function.map(40)(strains.T / arm.scene.nominal_strains[:, None], d2.u.T)
    assert np.abs(np.asarray(residual)).max() < 1e-6
    prestressed = prestressed_acceleration(arm.passive)
    assert np.abs(np.asarray(prestressed(strains[0], np.zeros(n), strains[0]))).max() < 1e-6
    np.testing.assert_allclose(d2.u.sum(axis=1), 3 * arm.pretension, rtol=1e-9)


def test_rates_and_deviations_have_the_covariance_of_the_trajectories(
    arm: TendonArm, moves: tuple[np.ndarray, np.ndarray], tmp_path: Path
) -> None:
    deviations, rates = moves
    n = arm.scene.n_strains
    d2 = make_phase_samples(arm, tmp_path / "d2.h5", 1500, rates, deviations, **SMALL)
    states = free_states(arm, d2)
    rest = arm.scene.statics().solve_many(d2.u).states[:, :n]
    for found, wanted in ((states[:, n:], rates), (states[:, :n] - rest, deviations)):
        c, w = np.cov(found.T), np.cov(wanted.T)
        assert np.linalg.norm(c - w) < 0.1 * np.linalg.norm(w)
        assert np.abs(found.mean(axis=0)).max() < 0.15 * np.sqrt(np.diag(w).max())


@pytest.mark.parametrize("spread", [False, True])
def test_xdot_is_the_passive_motion_of_the_fields(
    arm: TendonArm, moves: tuple[np.ndarray, np.ndarray], tmp_path: Path, spread: bool
) -> None:
    deviations, rates = moves
    d2 = make_phase_samples(arm, tmp_path / "d2.h5", 4, rates, deviations if spread else None, **SMALL)
    # A backbone that is let go of its tendons has modes of 1e8 1/s: the difference is taken over a time below them,
    # along the motion that starts with the acceleration of the balance of forces.
    xi, xi_t = np.split(free_states(arm, d2), 2, axis=1)
    tau = 1e-11
    for k in range(4):
        a = np.asarray(arm.passive.acceleration(xi[k], xi_t[k], np.empty(0))).ravel()
        ends = []
        for t in (-tau, tau):
            state = np.concatenate([xi[k] + t * xi_t[k], xi_t[k] + t * a, d2.u[k]])
            ends.append(arm.scene.fields(state, STATIONS).ravel())
        slope = (ends[1] - ends[0]) / (2 * tau)
        for quantity in ("q", "omega"):
            rows = [i for i, q in enumerate(arm.scene.field_map(STATIONS).quantities) if q == quantity]
            assert np.abs(d2.xdot[k] - slope)[rows].max() < 1e-3 * np.abs(slope[rows]).max()


def test_xdot_is_how_the_simulated_passive_arm_begins_to_move(tmp_path: Path) -> None:
    # Without stiff damping the passive arm is slow enough (torsion: 3e4 1/s) for differences of a simulation.
    paper = TendonArm.paper(nodes=3)
    arm = replace(paper, scene=paper.scene.replace(rod.KelvinVoigt(bending=1e-7, torsion=1e-7)))
    rates = 0.05 * np.random.default_rng(0).normal(size=(50, 9)) * np.tile([1.0, 1.0, 0.01], 3)
    d2 = make_phase_samples(arm, tmp_path / "d2.h5", 3, rates, **SMALL)
    states = free_states(arm, d2)
    step = 1e-7
    simulator = arm.passive.simulator(dt=step, rtol=1e-10, balance="direct")  # the equations that xdot is of
    found = simulator.scene.field_map(STATIONS)
    same = [i for i, q in enumerate(found.quantities) if q != "v"]  # v follows from forces: tendons are in x, not here
    for k in range(3):
        x = simulator.run(np.empty((4, 0)), states[k], check=False).x
        y = found.evaluate(x).reshape(5, -1)
        slope = (-25 * y[0] + 48 * y[1] - 36 * y[2] + 16 * y[3] - 3 * y[4]) / (12 * step)
        for quantity in ("p", "R", "w", "q", "omega"):
            rows = [i for i in same if found.quantities[i] == quantity]
            scale = np.abs(d2.xdot[k][rows]).max()
            assert np.abs(d2.xdot[k] - slope)[rows].max() < 2e-5 * scale, quantity


def test_flows_of_the_known_part_are_the_same_by_large_steps_and_by_idas(
    arm: TendonArm, moves: tuple[np.ndarray, np.ndarray], tmp_path: Path
) -> None:
    made = [
        make_phase_samples(arm, tmp_path / f"{method}.h5", 6, moves[1], moves[0], dt=0.03, method=method, **SMALL)
        for method in ("fast", "idas")
    ]
    fast, idas = (np.asarray(d2.x_half) for d2 in made)
    np.testing.assert_array_equal(made[0].x, made[1].x)
    kinds = np.array(arm.scene.field_map(STATIONS).quantities)
    for kind in "pRwq":
        rows = kinds == kind
        assert np.abs(fast - idas)[:, rows].max() < 2e-3 * np.abs(idas - made[1].x)[:, rows].max(), kind
    assert made[0].provenance != made[1].provenance


def test_phase_samples_depend_on_their_seed_only_and_survive_their_file(
    arm: TendonArm, moves: tuple[np.ndarray, np.ndarray], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(phase_samples, "SAMPLES_PER_BLOCK", 15)
    one = make_phase_samples(arm, tmp_path / "one.h5", 40, moves[1], moves[0], **SMALL)
    two = make_phase_samples(arm, tmp_path / "two.h5", 40, moves[1], moves[0], **{**SMALL, "workers": 2})
    more = make_phase_samples(arm, tmp_path / "more.h5", 50, moves[1], moves[0], **SMALL)
    other = make_phase_samples(arm, tmp_path / "other.h5", 40, moves[1], moves[0], **{**SMALL, "seed": 5})
    assert len(one) == 40
    for name in ("x", "u", "xdot"):
        assert getattr(one, name).tobytes() == getattr(two, name).tobytes()
        np.testing.assert_array_equal(getattr(more, name)[:40], getattr(one, name))
        assert np.abs(getattr(one, name) - getattr(other, name)).max() > 0
        np.testing.assert_array_equal(getattr(PhaseSamples.load(tmp_path / "one.h5"), name), getattr(one, name))
    assert len(np.unique(one.u, axis=0)) == 40  # no block repeats another
    assert PhaseSamples.load(tmp_path / "one.h5").provenance == one.provenance


# Stored data ----------------------------------------------------------------------------------------------------------


def test_stored_data_are_used_again_and_bad_files_are_refused_in_one_line(
    arm: TendonArm, tmp_path: Path, load_or_make: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    def load(of: TendonArm = arm, **options: Any) -> tuple[Episodes, PhaseSamples]:
        given = {"episodes": 2, "samples": 20, "seed": 0, "steps": 4, "workers": 1, **options}
        found: tuple[Episodes, PhaseSamples] = load_or_make(of, tmp_path, **given)
        return found

    def refused(match: str, of: TendonArm = arm, **options: Any) -> None:
        with pytest.raises(ValueError, match=match) as error:
            load(of, **options)
        assert "\n" not in str(error.value)

    d1, d2 = load()
    first, second = sorted(tmp_path.glob("*.h5"))
    before = first.stat().st_mtime_ns, second.stat().st_mtime_ns
    again = load()
    np.testing.assert_array_equal(again[0].xs[1], d1.xs[1])
    np.testing.assert_array_equal(again[1].xdot, d2.xdot)
    assert (first.stat().st_mtime_ns, second.stat().st_mtime_ns) == before

    refused("dt = 0.03, not 0.02", dt=0.02)
    refused("another arm", of=replace(arm, scene=arm.scene.replace(rod.Gravity((0.0, 0.0, -9.81)))))
    stiff = replace(arm.scene.rod, material=replace(arm.scene.rod.material, shear=1e9))  # not in the printed scene
    refused("another arm", of=replace(arm, scene=rod.Scene(stiff, *arm.scene.terms, nodes=3)))
    refused("pretension", of=replace(arm, pretension=2e-3))
    refused("amplitude", of=replace(arm, amplitude=5e-3))

    whole = first.read_bytes(), second.read_bytes()
    second.write_bytes(whole[1][:-100])
    refused(second.name)
    second.write_bytes(whole[0])
    refused("phase-samples")
    second.write_bytes(whole[1])
    first.write_bytes(whole[1])
    refused("episodes")
    first.write_bytes(b"no data")
    refused(first.name)

    first.unlink()  # D1 of another time step beside an old D2
    refused("rates", dt=0.02)
    assert len(load(seed=1)[0]) == 2
    with h5py.File(first, "r+") as file:
        del file["x"]
    refused("changed since it was written", dt=0.02)


def test_episodes_of_other_sources_have_no_simulator_states(arm: TendonArm) -> None:
    foreign = Episodes([np.zeros((3, 2))], [np.zeros((2, 3))], dt=0.1)
    for function in (strain_rates, deviations_from_equilibrium):
        with pytest.raises(ValueError, match="make_episodes"):
            function(arm, foreign)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"episodes": 0}, "episodes"),
        ({"steps": 0}, "steps"),
        ({"dt": -0.1}, "dt"),
        ({"dt": np.nan}, "dt"),
        ({"rtol": 0.0}, "rtol"),
        ({"stations": 0}, "stations"),
        ({"seed": -1}, "seed"),
        ({"seed": 0.5}, "seed"),
    ],
)
def test_bad_episodes_are_refused_in_one_line_before_anything_is_written(
    arm: TendonArm, tmp_path: Path, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message) as error:
        make_episodes(arm, tmp_path / "d1.h5", **{"episodes": 1, "steps": 2, **SMALL, **options})
    assert "\n" not in str(error.value) and not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"samples": 0}, "samples"),
        ({"rates": np.zeros((10, 4))}, "rates"),
        ({"rates": np.zeros((1, 9))}, "at least two"),
        ({"rates": np.full((10, 9), np.nan)}, "NaN"),
        ({"deviations": np.zeros((10, 3))}, "deviations"),
        ({"seed": "x"}, "seed"),
        ({"method": "euler"}, "method"),
    ],
)
def test_bad_phase_samples_are_refused_in_one_line_before_anything_is_written(
    arm: TendonArm, tmp_path: Path, options: dict[str, Any], message: str
) -> None:
    given = {"samples": 5, "rates": np.ones((10, 9)) * np.arange(10)[:, None], **SMALL, **options}
    with pytest.raises(ValueError, match=message) as error:
        make_phase_samples(arm, tmp_path / "d2.h5", **given)
    assert "\n" not in str(error.value) and not list(tmp_path.iterdir())


# Coordinates ----------------------------------------------------------------------------------------------------------


def test_rod_coordinates_are_exact_on_simulated_fields(arm: TendonArm, episodes: Episodes) -> None:
    assert episodes.extra is not None
    n, nominal = arm.scene.n_strains, arm.scene.nominal_strains
    scale = np.concatenate([nominal, nominal * arm.scene.rod.bending_rate])
    for stations in (3, 6, [0.2, 0.4, 0.5, 0.7]):
        coordinates = arm.scene.coordinates(stations)
        states = np.concatenate(list(episodes.extra["state"]))
        fields = arm.scene.fields(states, stations).reshape(len(states), -1)
        found = np.asarray(coordinates.function.map(len(states))(fields.T)).T
        assert np.abs((found - states[:, : 2 * n]) / scale).max() < 1e-8
        assert len(coordinates.names) == len(set(coordinates.names)) == len(coordinates.quantities) == 2 * n


def test_rod_coordinates_are_differentiable_through_casadi(arm: TendonArm, episodes: Episodes) -> None:
    function = arm.scene.coordinates(STATIONS).function
    y = ca.MX.sym("y", function.numel_in(0))
    slope = ca.Function("slope", [y], [ca.jacobian(function(y), y)])
    at, direction = episodes.xs[0][5], np.random.default_rng(0).normal(size=function.numel_in(0))
    by_difference = np.asarray(function(at + 1e-6 * direction) - function(at - 1e-6 * direction)).ravel() / 2e-6
    np.testing.assert_allclose(np.asarray(slope(at)) @ direction, by_difference, rtol=1e-5, atol=1e-5)


def test_rod_coordinates_refuse_what_they_cannot_tell(arm: TendonArm) -> None:
    body = replace(arm.scene.rod, strains="cosserat")
    for scene, stations, message in ((arm.scene, 2, "2 stations"), (rod.Scene(body, nodes=3), 6, "cosserat")):
        with pytest.raises(ValueError, match=message) as error:
            scene.coordinates(stations)
        assert "\n" not in str(error.value)


def test_episodes_with_backlash_record_commands_and_move_by_what_is_left(arm: TendonArm, tmp_path: Path) -> None:
    late = make_episodes(arm, tmp_path / "late.h5", 1, STEPS, DT, **SMALL, actuator=Actuator(play=1e-3))
    told = make_episodes(arm, tmp_path / "told.h5", 1, STEPS, DT, **SMALL)
    np.testing.assert_array_equal(late.us[0], told.us[0])
    servo = late.extra["state"][0][1:, -3:]
    moved, _ = Actuator(play=1e-3).simulate(told.us[0], DT, ActuatorState.at(arm.rest_inputs))
    np.testing.assert_allclose(servo, moved, atol=1e-12)
    assert np.abs(late.xs[0] - told.xs[0]).max() > 1e-3
    origin = recording.episodes_origin(arm, STEPS, DT, stations=STATIONS, seed=1)
    with pytest.raises(ValueError, match=r"actuator = \[0\.0, 0\.001, None\], not \[0\.0, 0\.0, None\]"):
        recording.check_origin(tmp_path / "late.h5", late.provenance, origin)


def test_recordings_of_older_versions_are_taken_for_what_they_are(arm: TendonArm, tmp_path: Path) -> None:
    """Their servos had play alone, told in metres."""
    origin = recording.episodes_origin(arm, STEPS, DT, stations=STATIONS, seed=1)
    old = {name: value for name, value in origin.items() if name != "actuator"}
    recording.check_origin(tmp_path, {**old, "backlash": 0.0}, origin)
    with pytest.raises(ValueError, match="actuator"):
        recording.check_origin(tmp_path, {**old, "backlash": 1e-3}, origin)
    played = recording.episodes_origin(arm, STEPS, DT, stations=STATIONS, seed=1, actuator=Actuator(play=1e-3))
    recording.check_origin(tmp_path, {**old, "backlash": 1e-3}, played)


def test_what_is_no_actuator_is_refused(arm: TendonArm, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"actuator is a float; expected an Actuator\(lag=, play=, rate=\)"):
        make_episodes(arm, tmp_path / "d1.h5", 1, STEPS, DT, **SMALL, actuator=1e-3)
