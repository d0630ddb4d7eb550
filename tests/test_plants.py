"""Plants around a plant: noise, delay, losses, outliers, rounding, servos, and a plant in another process."""

from __future__ import annotations

import json
import pickle
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pisplit import Actuator
from pisplit.checks import Array
from pisplit.controllers import PlantStep, plants
from pisplit.models import rod

RNG = np.random.default_rng(0)
COMMANDS = RNG.normal(size=(60, 2))
FRAME = tuple(f"R_{a}{b}[1]" for a in "xyz" for b in "xyz")


class Drawer:
    """x+ = 0.9 x + u with a state for every input; tells names and units, and uses one buffer."""

    dt, n_inputs, n_states = 0.01, 2, 2
    state_names, state_units, input_names = ("left", "right"), ("m", "rad"), ("a", "b")

    def __init__(self) -> None:
        self.x = np.zeros(2)

    def reset(self, u0: Any = None) -> Array:
        self.x[:] = 10.0 * np.asarray(u0) if u0 is not None else 0.0
        return self.x

    def step(self, u: Array) -> PlantStep:
        if abs(u[0]) > 100.0:
            return PlantStep(self.x, False, "stuck")
        self.x *= 0.9
        self.x += u
        u[:] = np.nan  # what it is given is its own
        return PlantStep(self.x)

    def snapshot(self) -> Array:
        return self.x.copy()

    def restore(self, x: Array) -> None:
        self.x[:] = x


def run(plant: Any, commands: Array = COMMANDS, u0: Array | None = None) -> Array:
    """What is measured at rest and after every command."""
    return np.array([plant.reset(u0), *(plant.step(u.copy()).state for u in commands)])


def plain() -> plants.WrappedPlant:
    return plants.WrappedPlant(Drawer())


TRUE = run(plants.WrappedPlant(Drawer()))

DEVICES = {
    "noise": lambda p: plants.NoisyMeasurements(p, 0.1, seed=3),
    "delay of measurements": lambda p: plants.DelayedMeasurements(p, 2.4),
    "losses": lambda p: plants.LostMeasurements(p, 0.3, seed=3),
    "outliers": lambda p: plants.Outliers(p, 0.1, 5.0, [["left"], ["right"]], seed=3),
    "frozen": lambda p: plants.FrozenMeasurements(p, ["left"], 8, 20),
    "delay of commands": lambda p: plants.DelayedCommands(p, 1.5),
    "rounding": lambda p: plants.QuantisedCommands(p, 0.25),
    "servo": lambda p: plants.ActuatedPlant(p, Actuator(lag=0.02, play=0.1, rate=50.0)),
}


@pytest.mark.parametrize("kind", DEVICES)
def test_a_run_repeats_and_goes_on_from_a_snapshot_to_the_last_bit(kind: str) -> None:
    plant = DEVICES[kind](Drawer())
    first = run(plant)
    assert not np.array_equal(first, TRUE)
    np.testing.assert_array_equal(run(plant), first)
    again = DEVICES[kind](Drawer())
    run(again, COMMANDS[:20])
    kept = pickle.loads(pickle.dumps(again.snapshot()))
    run(again)  # elsewhere
    again.restore(kept)
    np.testing.assert_array_equal([again.step(u).state for u in COMMANDS[20:]], first[21:])
    assert plant.state_names == ("left", "right") and plant.dt == 0.01
    with pytest.raises(AttributeError, match="input_units"):
        _ = plant.input_units


@pytest.mark.parametrize("kind", DEVICES)
def test_a_step_that_fails_leaves_the_device_where_it_was(kind: str) -> None:
    plant, spared = DEVICES[kind](Drawer()), DEVICES[kind](Drawer())
    run(plant, COMMANDS[:5])
    run(spared, COMMANDS[:5])
    if kind not in ("delay of commands", "servo"):  # there the command has not arrived yet
        after = plant.step(np.array([1e3, 0.0]))
        assert (after.ok, after.message) == (False, "stuck")
    np.testing.assert_array_equal(plant.step(COMMANDS[5]).state, spared.step(COMMANDS[5]).state)


def test_devices_that_do_nothing_change_nothing() -> None:
    for plant in (
        plants.NoisyMeasurements(Drawer(), 0.0),
        plants.DelayedMeasurements(Drawer(), 0.0),
        plants.LostMeasurements(Drawer(), 0.0),
        plants.Outliers(Drawer(), 0.0, 1.0, [[0]]),
        plants.FrozenMeasurements(Drawer(), [0], 10**6),
        plants.DelayedCommands(Drawer(), 0),
        plants.QuantisedCommands(Drawer(), 0.0),
        plants.ActuatedPlant(Drawer(), Actuator()),
    ):
        np.testing.assert_array_equal(run(plant), TRUE)


def test_true_states_are_those_before_any_device() -> None:
    plant = plants.LostMeasurements(plants.NoisyMeasurements(Drawer(), 0.1), 0.5)
    measured = run(plant)
    np.testing.assert_array_equal(plant.true_states, TRUE)
    seen = np.isfinite(measured)
    assert 0.3 < seen.mean() < 0.7
    assert np.abs(measured - TRUE)[seen].std() < 0.2


def test_noise_has_the_deviation_that_is_asked_for() -> None:
    many = np.zeros((4000, 2))
    error = run(plants.NoisyMeasurements(Drawer(), {"m": 1e-3}, seed=1), many)
    assert error[:, 0].std() == pytest.approx(1e-3, rel=0.05) and not error[:, 1].any()
    with pytest.raises(ValueError, match="no state has the unit 'mm'"):
        plants.NoisyMeasurements(Drawer(), {"mm": 1.0})
    with pytest.raises(ValueError, match="angle has no effect"):
        plants.NoisyMeasurements(Drawer(), 0.0, angle=0.1)


def test_frames_stay_rotations_and_turn_by_the_angle() -> None:
    class Frame(Drawer):
        n_states, state_names = 9, FRAME[::-1]

        def reset(self, u0: Any = None) -> Array:
            return np.eye(3).ravel()[::-1]

        def step(self, u: Array) -> PlantStep:
            return PlantStep(self.reset())

    measured = run(plants.NoisyMeasurements(Frame(), 1.0, angle=0.02), np.zeros((2000, 2)))[:, ::-1].reshape(-1, 3, 3)
    np.testing.assert_allclose(
        measured @ measured.transpose(0, 2, 1), np.broadcast_to(np.eye(3), measured.shape), atol=1e-12
    )
    turn = measured[:, 0, 1]  # about z, to first order
    assert turn.std() == pytest.approx(0.02, rel=0.05)


def test_a_delay_is_a_shift_in_time() -> None:
    late = run(plants.DelayedMeasurements(Drawer(), 3))
    np.testing.assert_array_equal(late[3:], TRUE[:-3])
    np.testing.assert_array_equal(late[:3], np.broadcast_to(TRUE[0], (3, 2)))
    half = run(plants.DelayedMeasurements(Drawer(), 0.5))
    np.testing.assert_allclose(half[1:], 0.5 * (TRUE[1:] + TRUE[:-1]), rtol=1e-14)
    rest = np.array([0.3, -0.2])
    commands = run(plants.DelayedCommands(Drawer(), 2), u0=rest)
    np.testing.assert_allclose(commands, run(plain(), np.vstack([rest, rest, COMMANDS[:-2]]), rest), rtol=1e-14)


def test_commands_are_rounded_to_whole_multiples() -> None:
    rounded = np.round(COMMANDS / [0.25, 1.0]) * [0.25, 1.0]
    np.testing.assert_array_equal(run(plants.QuantisedCommands(Drawer(), [0.25, 1.0])), run(plain(), rounded))


def test_a_servo_before_a_plant_is_the_actuator_of_its_commands() -> None:
    actuator, rest = Actuator(lag=0.03, play=0.2), np.array([0.5, -0.5])
    start = actuator.simulate(np.zeros((0, 2)), 0.01)[1].at(rest)
    moves = actuator.simulate(COMMANDS, 0.01, start)[0]
    np.testing.assert_array_equal(run(plants.ActuatedPlant(Drawer(), actuator), u0=rest), run(plain(), moves, rest))


def test_outliers_jump_by_their_size() -> None:
    measured = run(plants.Outliers(Drawer(), 0.25, 0.5, [[0, 1]], seed=2))
    size = np.linalg.norm(measured - TRUE, axis=1)
    wrong = size > 1e-12
    np.testing.assert_allclose(size[wrong], 0.5, rtol=1e-12)
    assert 0.1 < wrong.mean() < 0.4


def test_markers_are_lost_one_by_one() -> None:
    measured = run(plants.LostMeasurements(Drawer(), 0.5, [["left"], ["right"]], seed=1))
    lost = np.isnan(measured)
    assert (lost[:, 0] != lost[:, 1]).any() and not lost[0].any()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: plants.LostMeasurements(Drawer(), 1.5), "a part of the samples"),
        (lambda: plants.LostMeasurements(Drawer(), 0.5, [["nose"]]), "no state named 'nose'"),
        (lambda: plants.Outliers(Drawer(), 0.5, 1.0, [[2]]), "expected states from 0 to 1"),
        (lambda: plants.DelayedMeasurements(Drawer(), -1.0), "delay of measurements = -1"),
        (lambda: plants.QuantisedCommands(Drawer(), [0.1]), "unit has shape"),
        (lambda: plants.ActuatedPlant(Drawer(), 0.1), "expected an Actuator"),  # type: ignore[arg-type]
        (lambda: plants.WrappedPlant(3), "int has no dt"),  # type: ignore[arg-type]
    ],
)
def test_devices_that_cannot_be_are_refused_in_one_line(make: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


# Another process ------------------------------------------------------------------------------------------------------


def served(plant: Any, realtime: bool = False) -> tuple[int, list[int], threading.Thread]:
    """Port of a server with ``plant`` for one connection, where it leaves its late steps, and its thread."""
    ports, late, ready = [], [], threading.Event()

    def attend() -> None:
        late.append(
            plants.serve(plant, realtime=realtime, connections=1, ready=lambda p: (ports.append(p), ready.set()))
        )

    thread = threading.Thread(target=attend, daemon=True)
    thread.start()
    assert ready.wait(10.0)
    return ports[0], late, thread


def test_a_plant_behind_a_socket_is_the_plant() -> None:
    port, _, thread = served(Drawer())
    with plants.SocketPlant(port) as plant:
        assert (plant.dt, plant.n_states, plant.state_units, plant.input_names) == (0.01, 2, ("m", "rad"), ("a", "b"))
        np.testing.assert_array_equal(run(plant), TRUE)  # every digit
        after = plant.step(np.array([1e3, 0.0]))
        assert (after.ok, after.message) == (False, "stuck")
    thread.join(10.0)
    assert not thread.is_alive()


def test_missing_values_pass_a_socket_and_errors_are_raised() -> None:
    class Broken(Drawer):
        def step(self, u: Array) -> PlantStep:
            if u[1] > 0.0:
                raise RuntimeError("cable\nbroken")
            return PlantStep(np.array([np.nan, 1.0]))

    port, _, _ = served(Broken())
    with plants.SocketPlant(port) as plant:
        plant.reset()
        np.testing.assert_array_equal(plant.step(np.zeros(2)).state, [np.nan, 1.0])
        with pytest.raises(RuntimeError, match="RuntimeError: cable broken"):
            plant.step(np.ones(2))
        np.testing.assert_array_equal(plant.step(np.zeros(2)).state, [np.nan, 1.0])  # the connection stands


def test_a_server_in_real_time_keeps_its_clock() -> None:
    port, late, thread = served(Drawer(), realtime=True)
    with plants.SocketPlant(port) as plant:
        plant.reset()
        begin = time.monotonic()
        for u in COMMANDS[:20]:
            plant.step(u)
        spent = time.monotonic() - begin
    thread.join(10.0)
    assert spent >= 20 * 0.01 - 0.01 and late[0] <= 20


def test_what_is_no_plant_is_said_in_one_line() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]

        def greet(text: bytes) -> None:
            connection, _ = server.accept()
            connection.sendall(text)
            connection.close()

        for text, message in (
            (b"220 mail ready\n", "is no plant: it sent b'220 mail"),
            (json.dumps({"dt": 0.1}).encode() + b"\n", "is no plant: it sent"),
            (b"", "closed the connection"),
        ):
            thread = threading.Thread(target=greet, args=(text,), daemon=True)
            thread.start()
            with pytest.raises(ConnectionError, match=message):
                plants.SocketPlant(port)
            thread.join(10.0)
    with pytest.raises(ConnectionError, match="start its server first"):
        plants.SocketPlant(port, timeout=1.0)


def test_an_arm_is_wrapped_with_its_names_and_units() -> None:
    scene = rod.Scene(
        rod.Rod(length=0.3, section=rod.Circle(1e-3), material=rod.Elastic(2e9, 8e8, 8e3)),
        rod.KelvinVoigt(bending=1e-4, torsion=1e-4),
        rod.Tendons.parallel(offset=5e-3, angles_deg=(0, 120, 240), drive=rod.Displacement(compliance=1e-3)),
        nodes=4,
    )
    plant = plants.NoisyMeasurements(scene.simulator(dt=0.02), {"m": 1e-3}, angle=np.deg2rad(1.0))
    x = plant.reset(np.full(3, 1e-4))
    names = list(plant.state_names)
    frame = x[[names.index(f"R_{a}{b}[2]") for a in "xyz" for b in "xyz"]].reshape(3, 3)
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    assert 0.0 < np.abs(x - plant.true_states[0])[[names.index(f"p_{a}[6]") for a in "xyz"]].max() < 6e-3
    assert plant.step(np.zeros(3)).ok


def test_the_arm_is_served_by_one_command(tmp_path: Path) -> None:
    script = Path(__file__).parent.parent / "scripts" / "serve_arm.py"
    command = [
        sys.executable,
        str(script),
        "--port",
        "0",
        "--connections",
        "1",
        "--arm",
        "prototype",
        "--noise",
        "1e-3",
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=tmp_path) as process:
        assert process.stdout is not None
        port = int(process.stdout.readline().split()[-1])
        with plants.SocketPlant(port, timeout=60.0) as plant:
            x = plant.reset()
            assert x.shape == (144,) and plant.state_units[0] == "m"  # type: ignore[attr-defined]
            assert plant.step(np.full(3, 1e-3)).ok
        assert "late steps" in process.stdout.read()
        assert process.wait(10.0) == 0
