"""Where a plant meets a controller: columns by name and unit, and no array that two of them hold."""

from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from pisplit.checks import Array
from pisplit.controllers import MPC, ClosedLoop, FeedForward, PlantStep, references
from pisplit.lifted.model import LiftedModel

A = np.array([[0.9, 0.2, 0.0], [0.0, 0.8, 0.3], [-0.1, 0.0, 0.7]])
B = np.array([[0.1, 0.0], [0.0, 0.5], [0.4, -0.2]])
STATES, INPUTS = ("tip_x", "tip_y", "speed"), ("left", "right")
UNITS = ("m", "m", "m/s")


def model(**changes: object) -> LiftedModel:
    x, v, u = ca.SX.sym("x", 3), ca.SX.sym("v", 2, 0), ca.SX.sym("u", 2)
    made = LiftedModel(
        A=A,
        B=B,
        c=np.zeros(3),
        C=np.eye(3),
        d=np.zeros(3),
        dt=0.1,
        lift_function=ca.Function("lift", [x, v], [x]),
        input_function=ca.Function("phi", [u], [u]),
        n_delays=0,
        state_names=STATES,
        input_names=INPUTS,
        column_names=("z1", "z2", "z3"),
        feature_names=INPUTS,
        input_offset=np.zeros(2),
        input_basis=np.eye(2),
        state_range=np.ones(3),
        outputs={"tip": (0, 1)},
        state_units=UNITS,
        input_units=("m", "m"),
    )
    return replace(made, **changes)  # type: ignore[arg-type]


class Tank:
    """The model's system with columns in any order and unit; tells names and units where it is given them."""

    dt = 0.1

    def __init__(
        self,
        order: tuple[int, ...] = (0, 1, 2),
        inputs: tuple[int, ...] = (0, 1),
        sizes: tuple[float, ...] = (1.0, 1.0, 1.0),
        **told: tuple[str, ...],
    ) -> None:
        self.order, self.inputs, self.sizes = list(order), list(inputs), np.array(sizes)
        self.n_states, self.n_inputs = len(order), len(inputs)
        for name, value in told.items():
            setattr(self, name, value)

    def reset(self, u0: Array | None = None) -> Array:
        self.x = np.zeros(3)
        return self.measured()

    def measured(self) -> Array:
        return (self.sizes * self.x)[[i % 3 for i in self.order]]

    def step(self, u: Array) -> PlantStep:
        command = np.empty(2)
        command[self.inputs] = u
        self.x = A @ self.x + B @ command
        return PlantStep(self.measured())


def inverse(y: Array) -> Array:
    return np.array([0.3 * y[0], 0.5 * y[1]])


def controller(kind: str, m: LiftedModel) -> MPC | FeedForward:
    return MPC(m, 6, -1.0, 1.0, 0.3) if kind == "mpc" else FeedForward(inverse, m, -1.0, 1.0, 0.3)


def run(plant: Tank, kind: str = "mpc", m: LiftedModel | None = None) -> tuple[Array, Array]:
    log = ClosedLoop(plant, controller(kind, m or model())).run(references.constant([0.3, 0.2]), 15, progress=False)
    assert not log.stopped, log.message
    return log.x, log.u


def named(names: tuple[str, ...], order: tuple[int, ...]) -> tuple[str, ...]:
    return tuple(names[i] for i in order)


@pytest.mark.parametrize("kind", ["mpc", "feed-forward"])
def test_columns_of_a_plant_are_matched_by_name(kind: str) -> None:
    expected = run(Tank(), kind)
    order, inputs = (2, 0, 1), (1, 0)
    plant = Tank(order, inputs, state_names=named(STATES, order), input_names=named(INPUTS, inputs))
    np.testing.assert_array_equal(run(plant, kind)[0], expected[0])  # the log is in the model's order
    np.testing.assert_array_equal(run(plant, kind)[1], expected[1])
    more = Tank((1, 2, 0, 1), state_names=(*named(STATES, (1, 2, 0)), "battery"))
    np.testing.assert_array_equal(run(more, kind)[0], expected[0])
    by_position = model(state_names=("x1", "x2", "x3"), input_names=("u1", "u2"))  # data without names
    np.testing.assert_array_equal(run(Tank(state_names=STATES, input_names=INPUTS), kind, by_position)[1], expected[1])


def test_units_of_a_plant_are_converted() -> None:
    expected = run(Tank())
    plant = Tank(sizes=(1e3, 1e3, 1.0), state_units=("mm", "mm", "m/s"))
    np.testing.assert_allclose(run(plant)[0], expected[0], rtol=1e-9, atol=1e-12)

    class Millimetres(Tank):
        def step(self, u: Array) -> PlantStep:
            return super().step(1e-3 * u)

    np.testing.assert_allclose(run(Millimetres(input_units=("mm", "mm")))[0], expected[0], rtol=1e-9, atol=1e-12)
    unknown = model(state_units=None)
    loop = ClosedLoop(Tank(state_units=UNITS), controller("mpc", unknown))
    assert loop.run(references.constant([0.1, 0.1]), 2, progress=False).output_units == ("m", "m")


@pytest.mark.parametrize(
    ("told", "message"),
    [
        ({"state_names": ("tip_x", "tip_z", "speed")}, "no states named tip_y of the model, but tip_z"),
        ({"input_names": ("left", "middle")}, "no inputs named right of the model, but middle"),
        ({"state_names": ("tip_x", "tip_y")}, "expected 3 texts"),
        ({"input_names": ("left", "left")}, "no name twice"),
        ({"state_units": ("m", "rad", "m/s")}, "tip_y is in rad in the plant, in m in the model"),
        ({"state_units": ("m", "m")}, "expected 3 texts"),
    ],
)
def test_other_names_and_units_are_refused_in_one_line(told: dict[str, tuple[str, ...]], message: str) -> None:
    for kind in ("mpc", "feed-forward"):
        with pytest.raises(ValueError, match=message) as caught:
            ClosedLoop(Tank(**told), controller(kind, model()))
        assert "\n" not in str(caught.value)


class Reusing(Tank):
    """Measures into one buffer, and uses the command as memory of its own."""

    def reset(self, u0: Array | None = None) -> Array:
        if u0 is not None:
            u0 *= 0.0
        self.buffer = np.zeros(3)
        super().reset()
        return self.buffer

    def step(self, u: Array) -> PlantStep:
        super().step(u)
        u *= 1e3
        u[:] = np.nan
        self.buffer[:] = self.x
        return PlantStep(self.buffer[:])


@pytest.mark.parametrize("kind", ["mpc", "feed-forward"])
def test_a_plant_may_reuse_its_buffer_and_change_its_command(kind: str) -> None:
    expected, found = run(Tank(), kind), run(Reusing(), kind)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)


def test_what_a_controller_hands_out_and_is_given_is_not_shared() -> None:
    one, other = MPC(model(), 6, -1.0, 1.0, 0.3), MPC(model(), 6, -1.0, 1.0, 0.3)
    x, window = np.array([0.1, 0.0, 0.0]), np.full((6, 2), 0.3)
    for _ in range(4):
        mine, theirs = x.copy(), window.copy()
        move = one.step(mine, theirs)
        mine[:], theirs[:] = np.nan, np.nan
        reference = other.step(x, window)
        np.testing.assert_array_equal(move.u, reference.u)
        x = A @ x + B @ reference.u
        move.u[:], move.predicted[:] = np.nan, np.nan
        one.disturbance[:] = np.nan
    with pytest.raises(ValueError, match="read-only"):
        one.u_max[:] = 5.0
    forward = FeedForward(inverse, model(), -1.0, 1.0, 0.3)
    forward.step(x, window[:1]).u[:] = np.nan
    assert np.isfinite(forward.step(x, window[:1]).u).all()


def test_arguments_are_copied() -> None:
    low, high, rate, y_max = np.full(2, -1.0), np.full(2, 1.0), np.full(2, 0.3), np.full(2, 0.1)
    one, other = (MPC(model(), 6, low, high, rate, y_max=y_max) for _ in range(2))
    for array in (low, high, rate, y_max):
        array[:] = 1e-3
    fresh = MPC(model(), 6, -1.0, 1.0, 0.3, y_max=0.1)
    window = np.full((6, 2), 0.3)
    for mpc in (one, other):
        np.testing.assert_array_equal(mpc.step(np.zeros(3), window).u, fresh.step(np.zeros(3), window).u)
        fresh.reset()


@pytest.mark.parametrize(
    "make",
    [
        lambda y, t: references.from_array(y, 0.1),
        lambda y, t: references.setpoint(y, t),
        lambda y, t: references.waypoints(y, t),
        lambda y, t: references.constant(y[0]),
        lambda y, t: references.circle(0.1, 1.0, center=y[0], approach=0.0),
        lambda y, t: references.constant(width=2).starting_at(y[0]),
    ],
)
def test_references_keep_copies(make: Callable[[Array, Array], references.Reference]) -> None:
    y, times, at = np.array([[0.1, 0.2], [0.3, 0.4]]), np.array([0.0, 0.5]), np.linspace(0.0, 1.0, 7)
    reference = make(y, times)
    before = reference(at)
    kept = before.copy()
    y[:], times[:] = 9.0, 7.0
    np.testing.assert_array_equal(reference(at), kept)
    before[:] = -1.0
    np.testing.assert_array_equal(reference(at), kept)


def test_a_function_of_the_users_own_cannot_be_changed_by_what_it_gave() -> None:
    table = np.zeros((5, 2))
    reference = references.Reference(lambda t, start: table, width=2)
    t = np.arange(5.0)
    reference(t)[:] = 3.0
    assert not table.any() and not reference(t).any()


@pytest.mark.parametrize(
    ("options", "states", "given"),
    [
        ({"track": "tip", "axes": (1, 0)}, [1, 0], [0.3, 0.2]),
        ({"track": "tip", "axes": (1,)}, [1], [0.3, 0.2]),
        ({"track": ["tip_y", "tip_x"]}, [1, 0], [0.2, 0.3]),
        ({"track": ["tip_y", 0], "axes": (1, 0)}, [0, 1], [0.2, 0.3]),
        ({"track": [1, 0], "axes": (1,)}, [0], [0.2, 0.3]),
        ({"track": [1, 0], "axes": (1,)}, [0], [0.3]),
    ],
)
def test_axes_and_lists_of_states_in_any_order(
    options: dict[str, object], states: list[int], given: list[float]
) -> None:
    """The reference is that of the whole group in its own order, or of the tracked axes; the tip goes to (0.3, 0.2)."""
    mpc = MPC(model(), 10, -1.0, 1.0, 0.3, rate_weight=1e-6, **options)  # type: ignore[arg-type]
    log = ClosedLoop(Tank(), mpc).run(references.constant(given), 80, progress=False)
    np.testing.assert_allclose(log.y[-1], np.array([0.3, 0.2])[states], atol=1e-3)
    np.testing.assert_allclose(log.reference[-1], np.array([0.3, 0.2])[states])
    assert log.output_names == tuple(STATES[i] for i in states)
