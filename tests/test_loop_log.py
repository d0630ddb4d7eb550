"""A log says what happened in the outputs' own units, and survives whatever ends the run."""

import warnings
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from pisplit.checks import Array
from pisplit.controllers import MPC, ClosedLoop, LoopLog, Move, PlantStep, QPSettings, references
from pisplit.lifted.model import LiftedModel


def log(units: tuple[str, ...], y: Array, reference: Array, **changes: object) -> LoopLog:
    """A log of two steps of 0.1 s whose outputs are y (3, p), with one state that is not tracked before them."""
    n = len(units)
    made = LoopLog(
        dt=0.1,
        t=0.1 * np.arange(3),
        x=np.column_stack([np.full(3, 7.0), y]),
        reference=reference,
        u=np.zeros((2, 1)),
        u0=np.zeros(1),
        tracked=tuple(range(1, n + 1)),
        state_names=("other", *(f"y{i + 1}" for i in range(n))),
        input_names=("u",),
        state_units=("N", *units),
        input_units=("",),
        statuses=("solved", "maximum iterations reached"),
        actions=("", ""),
        iterations=np.array([10, 100]),
        fallback=np.array([False, False]),
        solve_time=np.array([0.002, 0.004]),
        cpu_time=np.array([0.002, 0.004]),
        plant_time=np.array([0.0051, 0.0051]),
        jitter=np.full(2, np.nan),
        missing=np.zeros(2, dtype=int),
        rejected=np.zeros(2, dtype=int),
        stuck=np.zeros(2, dtype=int),
        limit_violations=0,
    )
    return replace(made, **changes)  # type: ignore[arg-type]


ZERO, TWO = np.zeros((3, 2)), np.array([[9.0, 9.0], [0.003, 0.004], [0.003, 0.004]])  # 3-4-5 after the start


@pytest.mark.parametrize(
    ("units", "text"),
    [
        (("m", "m"), "RMS error 5 mm"),
        (("rad", "rad"), "RMS error 0.005 rad"),
        (("mm", "mm"), "RMS error 0.005 mm"),
        (("", ""), "RMS error 0.005"),
        (("1", "1"), "RMS error 0.005"),
        (("m", "rad"), "RMS error 3 mm, 0.004 rad"),
        (("m/s", ""), "RMS error 3 mm/s, 0.004"),
    ],
)
def test_errors_are_printed_in_the_outputs_own_unit(units: tuple[str, ...], text: str) -> None:
    assert log(units, TWO, ZERO).summary().splitlines()[0] == f"2 steps, 0.20 s; {text}"


def test_times_are_printed_in_milliseconds() -> None:
    second = log(("m", "m"), TWO, ZERO).summary().splitlines()[1]
    assert second == (
        "controller: median 3.00 ms, p99 3.98 ms, maximum 4.00 ms, 0 deadline misses; plant: median 5.10 ms"
    )
    late = log(("m", "m"), TWO, ZERO, solve_time=np.array([0.05, 0.11]))
    assert late.deadline_misses == 1 and "1 deadline misses" in late.summary()


def test_the_error_is_that_of_the_tracked_outputs_that_the_reference_specifies() -> None:
    free = ZERO.copy()
    free[:, 1] = np.nan
    made = log(("m", "m"), TWO, free)
    np.testing.assert_allclose(made.error, [9.0, 0.003, 0.003])
    assert made.output_names == ("y1", "y2") and made.output_units == ("m", "m")
    np.testing.assert_array_equal(made.y, TWO)
    assert made.rms_error() == pytest.approx(0.003)  # without the start
    rising = log(("m", "m"), np.array([[9.0, 0.0], [0.1, 0.0], [0.2, 0.0]]), ZERO)
    assert rising.rms_error() == pytest.approx(np.sqrt(0.025))
    assert rising.rms_error(after=0.1) == pytest.approx(0.2)
    assert rising.rms_error(before=0.1) == pytest.approx(0.1)
    assert np.isnan(rising.rms_error(after=5.0)) and np.isnan(rising.rms_errors(after=5.0)["m"])


def test_outputs_of_several_units_have_no_distance() -> None:
    mixed = log(("m", "rad"), TWO, ZERO)
    for use in (lambda: mixed.error, mixed.rms_error):
        with pytest.raises(ValueError, match=r"outputs in \['m', 'rad'\] have no distance; use rms_errors"):
            use()
    assert mixed.rms_errors() == pytest.approx({"m": 0.003, "rad": 0.004})


def test_steps_not_solved_to_tolerance_are_counted_apart_from_fallbacks() -> None:
    made = log(("m", "m"), TWO, ZERO)
    assert (made.unsolved, made.fallbacks) == (1, 0)
    assert "1 x solved, 1 x maximum iterations reached; 1 not to tolerance, 0 fallbacks" in made.summary()
    failed = replace(made, fallback=np.array([False, True]))
    assert (failed.unsolved, failed.fallbacks) == (0, 1)


def integrator(units: tuple[str, str] | None = None) -> LiftedModel:
    """x+ = x + u of two states and inputs."""
    x, v, u = ca.SX.sym("x", 2), ca.SX.sym("v", 2, 0), ca.SX.sym("u", 2)
    return LiftedModel(
        A=np.eye(2),
        B=np.eye(2),
        c=np.zeros(2),
        C=np.eye(2),
        d=np.zeros(2),
        dt=0.1,
        lift_function=ca.Function("lift", [x, v], [x]),
        input_function=ca.Function("phi", [u], [u]),
        n_delays=0,
        state_names=("x1", "x2"),
        input_names=("u1", "u2"),
        column_names=("z1", "z2"),
        feature_names=("u1", "u2"),
        input_offset=np.zeros(2),
        input_basis=np.eye(2),
        state_range=np.ones(2),
        outputs={"tip": (0, 1)},
        state_units=units,
    )


class Cart:
    """x+ = x + u; raises or stops where it is told."""

    dt, n_states, n_inputs = 0.1, 2, 2

    def __init__(self, raises: BaseException | None = None, at: int = 0, answer: object = None) -> None:
        self.raises, self.at, self.answer = raises, at, answer

    def reset(self, u0: Array | None = None) -> Array:
        self.x, self.k = np.zeros(2), 0
        return self.x

    def step(self, u: Array) -> PlantStep:
        self.k += 1
        if self.k == self.at:
            if self.raises is not None:
                raise self.raises
            return self.answer  # type: ignore[return-value]
        self.x = self.x + u
        return PlantStep(self.x)


def run(plant: Cart, units: tuple[str, str] | None = None, steps: int = 9) -> tuple[ClosedLoop, LoopLog]:
    loop = ClosedLoop(plant, MPC(integrator(units), 4, -1.0, 1.0, 1.0))
    return loop, loop.run(references.constant([0.5, -0.5]), steps, progress=False)


@pytest.mark.parametrize(
    ("raises", "message"),
    [
        (RuntimeError("motor\noff"), "step 5 of 9 (t = 0.500 s): the plant raised RuntimeError: motor off"),
        (KeyError("x"), "step 5 of 9 (t = 0.500 s): the plant raised KeyError: 'x'"),
    ],
)
def test_a_plant_that_raises_leaves_the_log_of_what_was_run(raises: Exception, message: str) -> None:
    with pytest.warns(UserWarning, match="the plant raised"):
        loop, log = run(Cart(raises, at=5))
    assert log.stopped and log.message == message and not log.interrupted
    assert len(log.u) == len(log.statuses) == len(log.plant_time) == 4 and len(log.x) == len(log.t) == 5
    np.testing.assert_allclose(log.x[1:] - log.x[:-1], log.u, atol=1e-12)
    assert loop.log.message == message and message in log.summary()


def test_the_keyboard_ends_a_run_and_returns_its_log() -> None:
    _, log = run(Cart(KeyboardInterrupt(), at=3))
    assert log.interrupted and log.message == "step 3 of 9 (t = 0.300 s): interrupted by the keyboard"
    assert len(log.u) == 2


def test_the_end_of_the_program_is_not_swallowed_but_the_log_is_kept() -> None:
    loop = ClosedLoop(Cart(SystemExit(), at=3), MPC(integrator(), 4, -1.0, 1.0, 1.0))
    with pytest.raises(SystemExit):
        loop.run(references.constant([0.5, -0.5]), 9, progress=False)
    assert len(loop.log.u) == 2 and "SystemExit" in loop.log.message


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (np.zeros(2), r"step\(\) returned ndarray; expected PlantStep"),
        (PlantStep(np.zeros(3)), r"shape \(3,\); expected \(2,\)"),
        (PlantStep(np.zeros(2) + 1j), "complex"),
        (PlantStep(np.full(2, np.inf)), "measured 2 states that are infinite"),
    ],
)
def test_a_plant_that_measures_nonsense_ends_the_run(answer: object, message: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        _, log = run(Cart(at=2, answer=answer))
    assert log.stopped and len(log.u) == 1
    with pytest.raises(AssertionError, match=message):
        raise AssertionError(log.message)


def test_a_controller_that_raises_leaves_the_log() -> None:
    class Stubborn(MPC):
        def step(self, x_measured: object, reference_window: object) -> Move:
            raise ArithmeticError("no")

    loop = ClosedLoop(Cart(), Stubborn(integrator(), 4, -1.0, 1.0, 1.0))
    with pytest.warns(UserWarning, match="the controller raised"):
        log = loop.run(references.constant([0.5, -0.5]), 9, progress=False)
    assert log.message == "step 1 of 9 (t = 0.100 s): the controller raised ArithmeticError: no"
    assert log.x.shape == (1, 2) and log.u.shape == (0, 2) and "stopped" in log.summary()


def test_the_log_can_be_read_while_the_run_goes_on() -> None:
    seen = []

    class Watched(Cart):
        def step(self, u: Array) -> PlantStep:
            seen.append(len(loop.log.u))
            return super().step(u)

    loop = ClosedLoop(Watched(), MPC(integrator(), 4, -1.0, 1.0, 1.0))
    loop.run(references.constant([0.5, -0.5]), 4, progress=False)
    assert seen == [0, 1, 2, 3]


def test_units_travel_from_the_model_to_the_summary() -> None:
    assert run(Cart(), ("rad", "rad"))[1].summary().splitlines()[0].endswith(" rad")
    assert run(Cart(), ("m", "m"))[1].summary().splitlines()[0].endswith(" mm")
    assert run(Cart())[1].summary().splitlines()[0].split()[-1].replace(".", "").isdigit()


def test_a_reference_in_another_unit_is_said() -> None:
    """50, in millimetres, where the training data in metres reached 1."""
    loop = ClosedLoop(Cart(), MPC(integrator(("m", "m")), 4, -1.0, 1.0, 1.0))
    with pytest.warns(UserWarning, match=r"the reference reaches 50 for x2, 50 times the range of the training data"):
        log = loop.run(references.constant([0.1, -50.0]), 3, progress=False)
    assert len(log.notes) == 1 and "(1 m): is it in another unit" in log.summary()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert loop.run(references.constant([np.nan, 2.5]), 3, progress=False).notes == ()


def test_a_loop_counts_what_was_not_solved_to_tolerance() -> None:
    model, settings = integrator(), QPSettings(eps=1e-12, max_iterations=30, first_max_iterations=30)
    loop = ClosedLoop(Cart(), MPC(model, 4, -1.0, 1.0, 1.0, qp=settings))
    log = loop.run(references.constant([0.5, -0.5]), 3, progress=False)
    assert log.unsolved == 3 - log.statuses.count("solved") - log.fallbacks > 0
    assert f"{log.unsolved} not to tolerance" in log.summary()
