"""Whatever a user holds of a closed loop can be copied, sent and kept, and goes on to the last bit."""

import copy
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from joblib import Parallel, delayed

from pisplit.checks import Array
from pisplit.controllers import MPC, ClosedLoop, FeedForward, LoopLog, Move, PlantStep, references
from pisplit.lifted.model import LiftedModel

A = np.array([[0.99, 0.03, 0.0], [-0.3, 0.9, 0.1], [0.0, 0.0, 0.8]])
B = np.array([[0.0, 0.01], [0.2, -0.1], [0.1, 0.3]])
N = 0.05 * np.random.default_rng(3).standard_normal((2, 3, 3))


def model(kind: str) -> LiftedModel:
    """Three states, two inputs, one delay of the input that does not act."""
    x, v, u = ca.SX.sym("x", 3, 2), ca.SX.sym("v", 2, 1), ca.SX.sym("u", 2)
    return LiftedModel(
        A=A,
        B=B,
        c=np.array([0.0, 0.01, 0.0]),
        C=np.diag([1.0, 0.9, 1.0]),
        d=np.zeros(3),
        dt=0.05,
        lift_function=ca.Function("lift", [x, v], [x[:, 1]]),
        input_function=ca.Function("phi", [u], [ca.tanh(u) if kind == "features" else u]),
        n_delays=1,
        state_names=("a", "b", "c"),
        input_names=("left", "right"),
        column_names=("a", "b", "c"),
        feature_names=("f1", "f2"),
        input_offset=np.zeros(2),
        input_basis=np.eye(2),
        state_range=np.ones(3),
        outputs={"tip": (0, 2)},
        N=N if kind == "products" else None,
    )


def made(kind: str) -> MPC:
    limits: dict[str, Any] = {"y_max": 0.15} if kind == "soft outputs" else {}
    return MPC(model(kind), 8, -1.0, 1.0, 0.4, **limits)


def steps(controller: MPC, first: int, last: int) -> list[Move]:
    """Steps on measurements and references that are drawn anew for each; some references leave an output free."""
    moves = []
    for k in range(first, last):
        rng = np.random.default_rng(k)
        window = 0.3 * rng.standard_normal((8, 2))
        window[:, k % 2] = np.nan if k % 3 == 0 else window[:, k % 2]
        moves.append(controller.step(0.3 * rng.standard_normal(3), window))
    return moves


def restored(controller: MPC) -> MPC:
    other = copy.deepcopy(controller)
    steps(other, 50, 55)
    other.restore(pickle.loads(pickle.dumps(controller.snapshot())))
    return other


WAYS: dict[str, Callable[[MPC], MPC]] = {
    "pickle": lambda c: pickle.loads(pickle.dumps(c)),
    "deepcopy": copy.deepcopy,
    "snapshot": restored,
}
KINDS = ["linear", "features", "products", "soft outputs"]


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_copied_controller_goes_on_as_the_original(kind: str, way: str) -> None:
    alone, original = made(kind), made(kind)
    steps(alone, 0, 7)
    steps(original, 0, 7)
    other = WAYS[way](original)
    expected = steps(alone, 7, 20)
    for controller in (other, original):  # neither disturbs the other
        found = steps(controller, 7, 20)
        assert [move.status for move in found] == [move.status for move in expected]
        assert [move.iterations for move in found] == [move.iterations for move in expected]
        for one, two in zip(found, expected, strict=True):
            np.testing.assert_array_equal(one.u, two.u)
            np.testing.assert_array_equal(one.predicted, two.predicted)
        np.testing.assert_array_equal(controller.disturbance, alone.disturbance)


@pytest.mark.parametrize("kind", KINDS)
def test_a_controller_that_was_reset_is_as_new(kind: str) -> None:
    used, new = made(kind), made(kind)
    steps(used, 0, 9)
    used.reset()
    for one, two in zip(steps(used, 20, 26), steps(new, 20, 26), strict=True):
        np.testing.assert_array_equal(one.u, two.u)


def test_a_worker_steps_the_controller_it_was_sent() -> None:
    controller = made("linear")
    steps(controller, 0, 5)
    x, window = np.full(3, 0.1), np.full((8, 2), 0.2)
    sent = Parallel(n_jobs=2)(delayed(controller.step)(x, window) for _ in range(2))
    here = controller.step(x, window)
    for move in sent:
        np.testing.assert_array_equal(move.u, here.u)


def test_a_snapshot_of_another_controller_is_refused() -> None:
    with pytest.raises(ValueError, match="snapshot is of another problem"):
        made("linear").restore(MPC(model("linear"), 9, -1.0, 1.0, 0.4).snapshot())
    with pytest.raises(ValueError, match="state has shape"):
        FeedForward(inverse, model("linear"), -1.0, 1.0, 0.1).restore(np.zeros(3))


def inverse(y: Array) -> Array:
    return np.nan_to_num(y)


class Slow:
    """x+ = A x + B u with a slow actuator, which is part of its state; can be set."""

    dt, n_states, n_inputs = 0.05, 3, 2

    def __init__(self) -> None:
        self.reset()

    def reset(self, u0: Array | None = None) -> Array:
        self.x, self.held = np.zeros(3), np.zeros(2)
        return self.x

    def step(self, u: Array) -> PlantStep:
        self.held = 0.5 * (self.held + u)
        self.x = A @ self.x + B @ self.held
        return PlantStep(self.x)

    def snapshot(self) -> tuple[Array, Array]:
        return self.x.copy(), self.held.copy()

    def restore(self, snapshot: tuple[Array, Array]) -> None:
        self.x, self.held = (part.copy() for part in snapshot)


def reference() -> references.Reference:
    return references.waypoints([[0.2, 0.1], [-0.1, 0.0]], [0.6, 1.4])


def make_controller(name: str) -> MPC | FeedForward:
    return FeedForward(inverse, model("linear"), -1.0, 1.0, 0.1) if name == "feed-forward" else made(name)


def equal(one: LoopLog, other: LoopLog) -> None:
    for name in ("t", "x", "u", "reference", "iterations"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert one.statuses == other.statuses


@pytest.mark.parametrize("name", ["linear", "products", "feed-forward"])
def test_a_run_in_parts_is_the_run_in_one(name: str) -> None:
    whole = ClosedLoop(Slow(), make_controller(name)).run(reference(), 40, progress=False)
    loop = ClosedLoop(Slow(), make_controller(name))
    first = loop.run(reference(), 13, progress=False)
    kept = pickle.dumps(loop.snapshot())
    sent = pickle.dumps(loop)
    equal(loop.resume(27, progress=False), whole)
    assert len(first.u) == 13  # a log is not changed by what comes later
    loop.restore(pickle.loads(kept))  # back to step 13
    equal(loop.resume(27, progress=False), whole)
    elsewhere = ClosedLoop(Slow(), make_controller(name))
    elsewhere.restore(pickle.loads(kept))
    equal(elsewhere.resume(10, progress=False), ClosedLoop.run(loop, reference(), 23, progress=False))
    equal(elsewhere.resume(17, progress=False), whole)
    equal(pickle.loads(sent).resume(27, progress=False), whole)


def test_a_plant_that_another_loop_moved_is_not_gone_on_with() -> None:
    plant, controller = Slow(), made("linear")
    one, other = ClosedLoop(plant, made("linear")), ClosedLoop(plant, controller)
    whole = one.run(reference(), 12, progress=False)
    one.run(reference(), 5, progress=False)
    kept = one.snapshot()
    other.run(reference(), 3, progress=False)
    with pytest.raises(ValueError, match="Slow was used in another loop since"):
        one.resume(7, progress=False)
    other.resume(2, progress=False)
    one.restore(kept)
    equal(one.resume(7, progress=False), whole)
    with pytest.raises(ValueError, match="used in another loop"):
        other.resume(1, progress=False)


def test_what_cannot_go_on_says_so() -> None:
    class Deaf:
        dt, n_states, n_inputs = 0.05, 3, 2

        def reset(self, u0: Array | None = None) -> Array:
            return np.zeros(3)

        def step(self, u: Array) -> PlantStep:
            return PlantStep(np.zeros(3), ok=False, message="asleep")

    loop = ClosedLoop(Deaf(), made("linear"))
    for use in (lambda: loop.resume(3), loop.snapshot, lambda: loop.log):
        with pytest.raises(ValueError, match="nothing was run yet"):
            use()
    assert loop.run(reference(), 3, progress=False).stopped
    for use in (lambda: loop.resume(3), loop.snapshot):
        with pytest.raises(ValueError, match=r"amid a step .*asleep"):
            use()
    awake = ClosedLoop(Slow(), made("linear"))
    awake.run(reference(), 3, progress=False)
    with pytest.raises(ValueError, match=r"Deaf has no snapshot\(\) and restore"):
        loop.restore(awake.snapshot())


@pytest.mark.parametrize("way", [copy.deepcopy, lambda r: pickle.loads(pickle.dumps(r))])
@pytest.mark.parametrize(
    "made",
    [
        references.circle(0.1, 2.0),
        references.circle(0.1, 2.0, center=(0.0, 0.1), approach=0.0),
        references.constant(),
        references.constant([0.1, np.nan, 0.3]),
        references.setpoint([[0.1, 0.2, 0.3]], [0.5]),
        references.waypoints([[0.1, 0.2, 0.3]], [0.5]),
        references.from_array(np.arange(12.0).reshape(4, 3), 0.1),
        references.sequence((references.constant(), 0.3), (references.circle(0.1, 2.0), np.inf)),
    ],
)
def test_references_are_copied_and_sent(made: references.Reference, way: Callable[[Any], Any]) -> None:
    t, start = np.linspace(0.0, 3.0, 31), [0.1, 0.2, 0.3]
    np.testing.assert_array_equal(way(made).starting_at(start)(t), made.starting_at(start)(t))
    np.testing.assert_array_equal(way(made.starting_at(start))(t), made.starting_at(start)(t))


def test_a_log_is_saved_and_loaded_whole(tmp_path: Path) -> None:
    free = references.constant([5.0, np.nan])  # far outside, and one output free
    with pytest.warns(UserWarning, match="5 times the range of the training data"):
        log = ClosedLoop(Slow(), made("linear")).run(free, 5, progress=False)
    log.save(tmp_path / "run.h5")
    for other in (LoopLog.load(tmp_path / "run.h5"), pickle.loads(pickle.dumps(log)), copy.deepcopy(log)):
        for name, value in vars(log).items():
            np.testing.assert_array_equal(getattr(other, name), value, err_msg=name)
            assert type(getattr(other, name)) is type(value), name
        assert other.summary() == log.summary()
    (tmp_path / "cut.h5").write_bytes((tmp_path / "run.h5").read_bytes()[:600])
    with pytest.raises(ValueError, match=r"cut\.h5"):
        LoopLog.load(tmp_path / "cut.h5")
