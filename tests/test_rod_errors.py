"""Bad input raises early: one line that names what was given."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from pisplit.data.actuator import Actuator
from pisplit.models import rod
from pisplit.models.arm import disk_robot
from pisplit.models.arm.tendon_arm import TendonArm

TWO = ((0.2, (0.0, 0.1, 0.0)), (0.2, (0.0, 0.2, 0.0)))
STEEL = rod.Elastic(207e9, 8e10, 8000.0)
BODY = rod.Rod(0.5, rod.Circle(1e-3), STEEL)
ARM = TendonArm.paper(nodes=3).scene
TENDONS = rod.Tendons.parallel(0.01, (0, 120, 240), rod.Displacement(1e-4))


def refused(call: Callable[[], Any], *named: str) -> None:
    """``call`` raises a ValueError of one line that contains every one of ``named``."""
    with pytest.raises(ValueError) as caught:
        call()
    message = str(caught.value)
    assert "\n" not in message
    for part in named:
        assert part in message, message


@pytest.mark.parametrize(
    ("build", "named"),
    [
        (lambda: rod.Base(slides=["x"]), ("slides", "'xyz'")),  # type: ignore[arg-type]
        (lambda: rod.Base(slides=None), ("slides", "None")),  # type: ignore[arg-type]
        (lambda: rod.HeldTip((0.0, 0.0, 0.5), axes=("x", "y")), ("axes", "'xyz'")),  # type: ignore[arg-type]
        (lambda: rod.Rod(0.5, rod.Circle(1e-3), STEEL, elements=(0.2, 0.3), kinks=TWO), ("two at s = 0.2 m", "one")),
        (lambda: rod.Scene(BODY, nodes=2).fast_stepper(0.03, stages=1), ("stages = 1", "2 or 3")),
        (lambda: Actuator(lag=0.1).simulate(np.zeros((2, 1)), 0.1, np.zeros(1)), ("ndarray", "ActuatorState")),
        (lambda: disk_robot(True), ("preset = True", "1, 2, 3, 4")),
    ],
)
def test_joints_holders_kinks_and_servos(build: Callable[[], Any], named: tuple[str, ...]) -> None:
    refused(build, *named)


def test_a_plant_whose_tip_is_held_takes_no_snapshot_of_one_whose_tip_is_elsewhere() -> None:
    body = rod.Rod(0.3, rod.Circle(5e-3), rod.Elastic(2e6, 8e5, 1070.0), "planar")
    free = rod.Scene(body, rod.Retardation(0.02), nodes=3)
    plants = [(free + rod.HeldTip((x, 0.0, 0.25))).stepper(0.03) for x in (0.05, 0.08)]
    for plant in plants:
        plant.reset()
    mark = plants[0].snapshot()
    plants[0].restore(mark)
    before = plants[1].state
    refused(lambda: plants[1].restore(mark), "the snapshot", "held")
    assert np.array_equal(plants[1].state, before)


@pytest.mark.parametrize("bad", [-0.4, 0.0, np.nan, np.inf, "long"])
def test_length(bad: Any) -> None:
    refused(lambda: rod.Rod(bad, rod.Circle(1e-3), STEEL), "length", str(bad) if bad != 0.0 else "0")


@pytest.mark.parametrize(
    ("build", "named"),
    [
        (lambda: rod.Circle(-1e-3), ("radius", "-0.001")),
        (lambda: rod.Elastic(-1.0, 1.0, 1.0), ("young", "-1")),
        (lambda: rod.Elastic(1.0, np.nan, 1.0), ("shear", "nan")),
        (lambda: rod.Elastic(1.0, 1.0, 0.0), ("density", "0")),
        (lambda: rod.Gravity((0.0, np.nan, 0.0)), ("Gravity", "NaN")),
        (lambda: rod.Gravity((0.0, 1.0)), ("Gravity", "(2,)", "(3,)")),
        (lambda: rod.Gravity(rod.Input("g", 2)), ("size 2", "size 3")),
        (lambda: rod.KelvinVoigt(bending=-1.0), ("bending", "-1")),
        (lambda: rod.QuadraticDrag(-2.0), ("QuadraticDrag", "-2")),
        (lambda: rod.LinearDrag(np.inf), ("LinearDrag", "inf")),
        (lambda: rod.TipWrench(force=(1.0, np.nan, 0.0)), ("force", "NaN")),
        (lambda: rod.TipWrench(moment=(1.0,)), ("moment", "(1,)")),
        (lambda: rod.Displacement(compliance=0.0), ("compliance", "0")),
        (lambda: rod.Tendons.parallel(-0.01, (0,), rod.Tension()), ("offset", "-0.01")),
        (lambda: rod.Tendons([], rod.Tension()), ("offsets",)),
        (lambda: rod.Tendons([[0.01, 0.0, 0.0]], rod.Tension()), ("offsets", "(1, 3)")),
        (lambda: rod.Input("", 3), ("name",)),
        (lambda: rod.Input("f", 0), ("size", "0")),
        (lambda: rod.Rod(0.4, rod.Circle(1e-3), STEEL, elements=None), ("elements", "None", "lengths")),  # type: ignore[arg-type]
        (lambda: rod.Rod(0.4, rod.Circle(1e-3), STEEL, kinks=0.2), ("kinks", "0.2", "pairs")),  # type: ignore[arg-type]
    ],
)
def test_terms(build: Callable[[], Any], named: tuple[str, ...]) -> None:
    refused(build, *named)


def test_strains() -> None:
    refused(lambda: rod.Rod(0.5, rod.Circle(1e-3), STEEL, strains="timoshenko"), "timoshenko", "kirchhoff")


def test_scene() -> None:
    refused(lambda: rod.Scene(rod.Gravity((0, 0, -9.81))), "Rod", "Gravity")  # type: ignore[arg-type]
    refused(lambda: rod.Scene(BODY, 9.81), "9.81")  # type: ignore[arg-type]
    refused(lambda: rod.Scene(BODY, nodes=1), "nodes", "1")
    refused(lambda: rod.Scene(BODY, TENDONS) - rod.QuadraticDrag(1.0), "QuadraticDrag")
    refused(lambda: rod.Scene(BODY, TENDONS).replace(rod.QuadraticDrag(1.0)), "QuadraticDrag", "0 terms")


def test_tendons_out_of_the_plane_of_a_planar_rod() -> None:
    flat = rod.Rod(0.5, rod.Circle(1e-3), STEEL, "planar")
    refused(lambda: rod.Scene(flat, TENDONS), "planar", "y")


def test_two_terms_that_would_share_an_input_by_accident() -> None:
    refused(lambda: rod.Scene(BODY, TENDONS, TENDONS), "tendons", "name")
    force, gravity = rod.TipWrench(force=rod.Input("f", 3)), rod.Tendons([[0.01, 0.0]], rod.Tension(), name="f")
    refused(lambda: rod.Scene(BODY, force, gravity), "'f'", "3", "1")


def test_number_of_inputs() -> None:
    refused(lambda: ARM.statics().solve([0.0, 0.0]), "(2,)", "(3,)")
    refused(lambda: ARM.statics().solve_many(np.zeros((4, 2))), "(4, 2)", "(any, 3)")
    refused(lambda: ARM.simulator(0.03).run(np.zeros((4, 4)), check=False), "(4, 4)", "(any, 3)")
    refused(lambda: ARM.simulator(0.03).run(np.zeros((0, 3)), check=False), "no rows")
    plant = ARM.simulator(0.03)
    plant.reset()
    refused(lambda: plant.step(np.zeros(2)), "(2,)", "(3,)")


def test_inputs_that_nothing_reads() -> None:
    passive = rod.Scene(BODY)
    refused(lambda: passive.statics().solve([1e-3, 0.0, 0.0]), "(3,)", "(0,)")
    refused(lambda: passive.simulator(0.03).run(np.zeros((4, 3)), check=False), "(4, 3)", "(any, 0)")


@pytest.mark.parametrize("pull", [0.7144, 10.0])
def test_displacements_beyond_the_length_of_the_tendon(pull: float) -> None:
    refused(lambda: ARM.statics().solve([pull, 0.0, 0.0]), f"{pull:g} m", "0.7144", "metres")
    refused(lambda: ARM.simulator(0.03).run([[pull, 0.0, 0.0]], check=False), f"{pull:g} m")
    plant = ARM.simulator(0.03)
    plant.reset()
    refused(lambda: plant.step([0.0, pull, 0.0]), f"{pull:g} m")


def test_not_a_number() -> None:
    nan = float("nan")
    refused(lambda: ARM.statics().solve([nan, 0.0, 0.0]), "NaN")
    refused(lambda: ARM.statics().solve([0.0] * 3, guess=np.full(ARM.n_strains, nan)), "guess", "NaN")
    refused(lambda: ARM.simulator(0.03).run([[nan, 0.0, 0.0]], check=False), "NaN")
    refused(lambda: ARM.simulator(0.03).run(np.zeros((1, 3)), x0=np.full(ARM.n_states, nan), check=False), "x0", "NaN")
    refused(lambda: ARM.fields(np.full(ARM.n_states, nan)), "states", "NaN")
    refused(lambda: ARM.linearise(np.full(ARM.n_states, nan)), "state", "NaN")


def test_states_of_another_scene() -> None:
    refused(lambda: ARM.fields(np.zeros(5)), "(5,)", str(ARM.n_states))
    refused(lambda: ARM.simulator(0.03).run(np.zeros((1, 3)), x0=np.zeros(5), check=False), "x0", "(5,)")
    refused(lambda: ARM.statics().solve(guess=np.zeros(5)), "guess", "5")


@pytest.mark.parametrize("stations", [[0.8], [-0.1, 0.2], [0.3, 0.2], [0.2, 0.2], []])
def test_stations(stations: list[float]) -> None:
    state = np.zeros(ARM.n_states)
    refused(lambda: ARM.fields(state, stations), "stations")
    refused(lambda: ARM.fields(state, 0), "stations", "0")


def test_pose_off_the_rod() -> None:
    refused(lambda: ARM.statics().solve().pose(0.9), "0.9", "0.7144")


def test_settings_of_the_simulator() -> None:
    refused(lambda: ARM.simulator(0.0), "dt", "0")
    refused(lambda: ARM.simulator(0.03, rtol=1.0), "rtol", "1")
    refused(lambda: ARM.simulator(0.03, inputs="first"), "first", "ramp", "step")
    with pytest.raises(TypeError, match="order"):
        ARM.simulator(0.03, order=4)


def test_a_plant_without_a_state() -> None:
    with pytest.raises(RuntimeError, match=r"reset\(\)"):
        ARM.simulator(0.03).step(np.zeros(3))
