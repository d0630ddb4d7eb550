"""Form of the tendons and groups of parameters by held-out roll-outs; windows; how candidates are compared."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pisplit import Actuator, Episodes
from pisplit.models.arm.predictor import ArmPredictor
from pisplit.models.arm.recording import labels, random_differential
from pisplit.models.arm.resting import RestShapes
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.calibration import choose_calibration
from pisplit.models.calibration.choice import compared, hopeless, worse, worth
from pisplit.models.calibration.choosing import over_disks
from pisplit.models.calibration.judging import FitEnd, HeldOut
from pisplit.models.calibration.model import ParametrisedArm
from pisplit.models.calibration.motion import Known, Motion
from pisplit.models.calibration.problem import Problem
from pisplit.models.calibration.windows import Windows, stretches

DT, STATIONS = 0.03, 4
pytestmark = pytest.mark.filterwarnings("ignore::pisplit.models.rod.Unresolved")


@pytest.fixture(scope="module")
def arm() -> TendonArm:
    return TendonArm.paper(nodes=3)


def recorded(arm: TendonArm, servo: Actuator, episodes: int, steps: int, seed: int) -> Episodes:
    """Recordings from rest, commands by straight lines."""
    rng, xs, us = np.random.default_rng(seed), [], []
    stepper = arm.scene.fast_stepper(DT, step=0.015, stations=STATIONS)
    start = arm.scene.statics().solve(arm.rest_inputs).state
    for _ in range(episodes):
        ends = np.vstack([np.zeros(3), random_differential(arm, 2, rng)])
        way = np.linspace(0.0, 2.0, steps)
        u = arm.rest_inputs + np.stack([np.interp(way, np.arange(3), c) for c in ends.T], axis=1)
        moved, _ = servo.simulate(np.vstack([arm.rest_inputs, u]), DT)
        found = stepper.run(moved[1:], start, check=False)
        xs.append(found.fields(STATIONS).reshape(steps + 1, -1))
        us.append(u)
    return Episodes(xs, us, DT, **labels(arm, arm.scene.field_map(STATIONS)))


def shapes_of(arm: TendonArm, number: int) -> RestShapes:
    u = arm.rest_inputs + random_differential(arm, number, np.random.default_rng(0))
    solved = arm.scene.statics().solve_many(u)
    return RestShapes(u, arm.scene.fields(solved.states, STATIONS).reshape(number, -1), 2e-4, 4e-3)


def test_the_form_is_chosen_by_roll_outs(arm: TendonArm) -> None:
    true = over_disks(arm, 2)
    d1 = recorded(true, Actuator(), 2, 12, 1)
    found = choose_calibration(
        arm,
        d1,
        shapes_of(true, 5),
        disks=(None, 2),
        groups=(),
        ahead=4,
        progress=False,
    )
    assert found.arm.tendons.disks == 2
    along, over = found.tried
    assert along.error > 10.0 * over.error
    assert found.doubts == ()
    held, wrong = HeldOut(d1[-1:], stretches(d1[-1:], 4)), along.calibration
    assert wrong is not None
    model = ParametrisedArm(arm, wrong.parameters, ("tendons",))
    ahead = held.rollouts(model, wrong)
    np.testing.assert_allclose(ahead.errors, along.errors, rtol=1e-4)
    said = held.doubts(model, wrong, ahead, (2e-4, 4e-3, 0.05))
    assert len(said) == 1 and "the form is wrong" in said[0]
    # parameters that the data leave vague explain as much: then it is the data that are too few
    for size, why in ((1e-3, "the form is wrong"), (0.3, "too few")):
        end = FitEnd(model.first, np.eye(len(model.first)) / size**2, 1.0)
        said = held.doubts(model, wrong, ahead, (2e-4, 4e-3, 0.05), end)
        assert len(said) == 1 and why in said[0]
    told = held.doubts(model, wrong, ahead, (2e-4, 4e-3, 0.05), replace(end, why="no step goes downhill"))
    assert "did not come to its end" in told[0] and told[1:] == said
    assert over.name in found.report() and along.name in found.report()
    assert found.plot().axes


def test_roll_outs_of_candidates_are_those_of_the_predictor(arm: TendonArm) -> None:
    model = ParametrisedArm(arm, None, ("tendons", "friction"))
    values = tuple(model.start.tolist())
    found = model.result(model.first, 0.0, 1, np.eye(len(model.first)), 0.0)
    assert found.arm.tendons.values == values  # type: ignore[attr-defined]
    data = recorded(arm, Actuator(lag=0.02), 1, 10, 5)
    held, predictor = HeldOut(data, [(0, 4, 10)]), ArmPredictor(found.arm, DT, STATIONS, Actuator(lag=0.02))
    ahead = held.rollouts(model, replace(found, actuator=Actuator(lag=0.02)))
    x, u = data.xs[0], data.us[0]
    told = predictor.predict(x[4], u[4:], np.vstack([arm.rest_inputs, u[:4]]))
    np.testing.assert_allclose(ahead.points[0], told[1:, predictor.outputs["shape"]], atol=3e-4)
    again = held.rollouts(model, replace(found, actuator=Actuator(lag=0.02)), ahead)  # from known steps: the same
    np.testing.assert_allclose(again.points[0], ahead.points[0], atol=1e-8)


def test_steps_looked_for_nearby_are_the_same_and_so_are_their_derivatives(arm: TendonArm) -> None:
    model = ParametrisedArm(over_disks(arm, 2), None, ("tendons", "bending", "friction", "lag"), Actuator(lag=0.02))
    data = recorded(arm, Actuator(), 1, 6, 4)
    seen = model.sight(STATIONS)
    logs = [np.vstack([arm.rest_inputs, data.us[0]])]
    errors = np.full(len(seen.rows), 1e-2)
    motion = Motion(model, seen, DT, data.xs[0][None][..., seen.rows], logs, errors, 1e-4)
    x, first = model.first.copy(), np.concatenate([seen.state(data.xs[0][0]), np.zeros(3)])
    x[-3] = 1.0  # friction, of disks
    found = motion.simulated(x, first, 0)
    assert found is not None
    of_state, of_parameters, near = motion.linearised(found, len(x), 0)
    rng = np.random.default_rng(0)
    way = np.concatenate([np.tile(model.scene.nominal_strains, 2), np.full(3, 1e-3), np.ones(len(x))])
    way *= rng.normal(size=len(way))
    step = 1e-4
    ends = [
        motion.simulated(x + s * step * way[len(first) :], first + s * step * way[: len(first)], 0) for s in (1.0, -1.0)
    ]
    assert ends[0] is not None and ends[1] is not None
    slope = (ends[0].misses - ends[1].misses) / (2.0 * step)
    told = np.hstack([of_state, of_parameters]) @ way
    np.testing.assert_allclose(told, slope, atol=2e-4 * np.abs(slope).max())
    hinted = motion.simulated(x + step * way[len(first) :], first + step * way[: len(first)], 0, near)
    assert hinted is not None
    np.testing.assert_allclose(hinted.misses, ends[0].misses, atol=1e-5)
    apart = max(
        np.abs(hint.z - piece.z).max() / np.abs(piece.z).max()
        for hints, pieces in zip(near.hints(hinted.point), hinted.intervals, strict=True)
        for hint, piece in zip(hints, pieces, strict=True)
    )
    assert apart < 1e-3  # to first order


def test_what_is_worse_is_not_looked_at_to_the_end(arm: TendonArm) -> None:
    data, model = recorded(arm, Actuator(), 1, 8, 6), ParametrisedArm(arm, None, ("bending",))
    seen = model.sight(STATIONS)
    y = np.stack([data.xs[0][k : k + 4] for k in (0, 2, 4)])
    logs = [data.us[0][k : k + 4] for k in (0, 2, 4)]
    motion = Motion(model, seen, DT, y[..., seen.rows], logs, np.full(len(seen.rows), 1e-3), 0.0)
    problem, first = Problem(model, motion, None), np.stack([seen.state(rows[0]) for rows in y])
    here = problem.missed(model.first, first)
    best = problem.linearised(model.first, here)
    far = problem.missed(model.first + 0.5, first, best)
    assert len(here.motions) == 3 and len(far.motions) < 3 and not far.better(here)
    steps = {i: Known.of(near.found, near.of_steps) for i, near in best.nearby.items()}
    again = problem.missed(model.first + 0.01, first, known=steps)
    assert again.cost == pytest.approx(problem.missed(model.first + 0.01, first).cost, rel=1e-6)


def test_a_lag_is_kept_where_it_is_and_a_load_is_not_where_it_is_not(arm: TendonArm) -> None:
    found = choose_calibration(
        arm,
        recorded(arm, Actuator(lag=0.03), 2, 12, 2),
        shapes_of(arm, 4),
        groups=("lag", "load"),
        ahead=4,
        progress=False,
    )
    assert found.free == ("tendons", "bending", "damping", "lag")
    assert found.actuator.lag == pytest.approx(0.03, abs=4e-3)
    assert found.arm.tendons.parameters.tip_mass == 0.0  # type: ignore[attr-defined]
    without = [t for t in found.tried if "lag" not in t.free]
    assert min(t.error for t in without) > 10.0 * found.tried[found.chosen].error


def test_a_gain_has_to_be_more_than_its_spread() -> None:
    rng = np.random.default_rng(0)
    base = np.exp(rng.normal(size=12))
    gain, spread = compared(base / 1.5, base, 0.0)  # paired: the spread among roll-outs themselves does not matter
    assert gain == pytest.approx(np.log(1.5)) and spread == pytest.approx(0.0, abs=1e-12)
    assert worth(gain, spread)
    assert not worth(*compared(base * np.exp(rng.normal(0.0, 1.0, 12)), base, 0.0))
    assert not worth(*compared(base / 1.5, base, 1e6))  # below what sensors tell apart
    assert not worth(*compared(base / 1.02, base, 0.0))
    alone = compared(base[:1] / 1.9, base[:1], 0.0)  # one roll-out says little
    assert not worth(*alone) and worth(*compared(base[:1] / 2.1, base[:1], 0.0))
    assert hopeless(*compared(base / 4.0, base, 0.0)) and not hopeless(*compared(base / 2.0, base, 0.0))
    assert worse(*compared(1.1 * base, base, 0.0)) and not worse(*compared(base, base, 0.0))
    lost = base.copy()
    lost[3] = np.inf
    assert compared(lost, base, 0.0)[0] == -np.inf and compared(base, lost, 0.0)[0] == np.inf
    assert compared(lost / 2.0, lost, 0.0)[0] == pytest.approx(np.log(2.0))


def test_windows_join_spans_and_are_as_long_as_enough_of_them_are() -> None:
    rng = np.random.default_rng(1)
    data = Episodes([rng.normal(size=(101, 24)) for _ in range(3)], [rng.normal(size=(100, 2)) for _ in range(3)], DT)
    rest = np.zeros(2)
    pairs = [(e, k - 4, k + 1) for e, k in ((0, 4), (0, 30), (1, 50), (2, 70), (2, 90))]
    few = Windows.of(data, pairs, rest)
    assert few.steps == 5 and len(few) == 5
    np.testing.assert_array_equal(few.fields[1], data.xs[0][26:32])
    np.testing.assert_array_equal(few.logs[1], np.vstack([rest, data.us[0][:31]]))
    joined = Windows.of(data, [(0, 0, 5), (0, 3, 8), (0, 8, 16)], rest)
    assert joined.steps == 5 and joined.rows.tolist() == [[0, 0], [0, 5], [0, 10]]
    everything = Windows.of(data, None, rest)
    assert everything.steps == 32 and len(everything) == 9
    assert len(Windows.of(data, None, rest, budget=256)) == 8
    few = Windows.of(data, None, rest, 128, 16)
    assert few.steps == 16 and len(few) == 8 and set(few.rows[:, 0].tolist()) == {0, 1, 2}
    with pytest.raises(ValueError, match="outside the recordings"):
        Windows.of(data, [(0, 90, 101)], rest)
    assert stretches(data, 40) == [(e, a, a + 40) for e in range(3) for a in (4, 44)]
    assert stretches(data, 40, most=2) == [(0, 4, 44), (2, 44, 84)]
    assert stretches(data, 400) == [(e, 4, 100) for e in range(3)]


def test_what_does_not_fit_is_refused(arm: TendonArm) -> None:
    d1 = Episodes([np.zeros((30, 96))], [np.zeros((29, 3))], DT)
    with pytest.raises(ValueError, match="one recording"):
        choose_calibration(arm, d1)
    with pytest.raises(ValueError, match="expected some of lag, play"):
        choose_calibration(arm, d1, groups=("weight",))
    with pytest.raises(ValueError, match="disks is empty"):
        choose_calibration(arm, d1, held_out=d1, disks=())
