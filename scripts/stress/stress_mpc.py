"""Closed loops under everything that goes wrong: inputs inside their limits, the log survives, all is counted.

Each run draws a plant, a model of it (or of another one), limits, a controller, a reference and a few faults: signs
flipped, inputs swapped, infeasible starts of outputs, NaN, sensors that stick, outliers, exceptions in the plant,
callbacks that raise, limits that are tightened under way, models that grow. How soon a wrong model is named is timed
from the first input that moved, over the time in which all was measured; loops on the right model are not to be
suspected.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
import warnings
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the other rooms of scripts/

from common.report import Report, parser, run
from pisplit import BilinearEDMDc, Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob
from pisplit.checks import Array
from pisplit.controllers import MPC, ClosedLoop, InnovationWatch, LoopLog, PlantStep, QPSettings, plants, references
from pisplit.controllers.plants.wrapped import WrappedPlant
from pisplit.lifted.model import LiftedModel

DT, STEPS = 0.05, 60
#: Faults, and how often a run has each.
FAULTS = {
    "flipped sign": 0.15,
    "inputs swapped": 0.1,
    "another arm's model": 0.1,
    "unstable model": 0.1,
    "infeasible outputs": 0.2,
    "NaN": 0.3,
    "stuck sensor": 0.3,
    "outliers": 0.2,
    "plant raises": 0.1,
    "plant fails": 0.05,
    "callback raises": 0.05,
    "limits tightened": 0.2,
    "far reference": 0.2,
    "few iterations": 0.2,
}

#: What an innovation test should speak of beside wrong models: loops that leave what was recorded, and measurements.
UNUSUAL = {"unstable model", "far reference", "stuck sensor", "outliers"}
#: Models of another plant, and plants with other wires.
OTHERS = {"flipped sign", "inputs swapped", "another arm's model"}

#: What is said of inputs that do not act as the model says.
MIXED_UP = ("the other way round", "in each other's place")


class Oscillators(WrappedPlant):
    """n points on springs, pushed by m inputs, with a force that grows with the cube of the way."""

    def __init__(self, rng: np.random.Generator) -> None:
        n, m = int(rng.integers(1, 4)), int(rng.integers(1, 4))
        self._omega, self._damping = rng.uniform(2.0, 12.0, n), rng.uniform(0.02, 0.5, n)
        self._pull, self._cubic = rng.uniform(-1.0, 1.0, (n, m)), float(rng.uniform(0.0, 2.0))
        self._sizes = n, m
        self.mixing, self.raises_at, self.fails_at = np.eye(m), -1, -1
        self._x = np.zeros(2 * n)
        super().__init__(_Inner(n, m))

    def reset(self, u0: Any = None) -> Array:
        self._x, self._k = np.zeros(2 * self._sizes[0]), 0
        self._states = [self._x.copy()]
        return self._x.copy()

    def step(self, u: Any) -> PlantStep:
        n, _ = self._sizes
        if self._k == self.raises_at:
            raise RuntimeError("the bus is silent")
        if self._k == self.fails_at:
            return PlantStep(self._x.copy(), False, "emergency stop")
        h, p, v = DT / 8, self._x[:n], self._x[n:]
        for _ in range(8):
            force = self._pull @ self.mixing @ np.asarray(u) - p - self._cubic * p**3
            v = (v + h * self._omega**2 * force) / (1.0 + 2.0 * h * self._damping * self._omega)
            p = p + h * v
        self._x, self._k = np.concatenate([p, v]), self._k + 1
        self._states.append(self._x.copy())
        return PlantStep(self._x.copy())


class _Inner:
    """Sizes, names and time step of the oscillators."""

    dt = DT

    def __init__(self, n: int, m: int) -> None:
        self.n_states, self.n_inputs = 2 * n, m

    def reset(self, u0: Any = None) -> Array:
        return np.zeros(self.n_states)

    def step(self, u: Array) -> PlantStep:
        return PlantStep(np.zeros(self.n_states))


def recorded(plant: Oscillators, rng: np.random.Generator, number: int) -> Episodes:
    """Recordings of the plant under steps of its inputs."""
    n, m = plant.n_states, plant.n_inputs
    xs, us = [], []
    for _ in range(number):
        u = np.repeat(rng.uniform(-1.0, 1.0, (15, m)), 6, axis=0)
        xs.append(np.array([plant.reset(), *(plant.step(v).state for v in u)]))
        us.append(u)
    return Episodes(xs, us, DT, outputs={"tip": tuple(range(n // 2))})


def fitted(plant: Oscillators, rng: np.random.Generator) -> tuple[LiftedModel, Episodes]:
    """A linear, delay or bilinear model of recordings, and others of them."""
    n, m = plant.n_states, plant.n_inputs
    data = recorded(plant, rng, 6)
    kind = rng.integers(3)
    parts: list[Any] = [ob.Constant(), ob.Identity()]
    if kind == 1:
        parts.append(ob.Delays(2, 2))
    if kind == 2:
        parts.append(ob.Bilinear())
    theta = Dictionary(*parts, n_states=n, n_inputs=m)
    estimator = (BilinearEDMDc if kind == 2 else LinearEDMDc)(theta, 1e-8)
    return estimator.fit(data[:3]).lifted, data[3:]


def mixed_up(plant: Oscillators, faults: list[str], rng: np.random.Generator) -> tuple[LiftedModel, Episodes, bool]:
    """A model of the ``plant`` or, by its ``faults``, not, and the recordings that it belongs to; whether it is wrong.

    It is wrong where a step of this plant is predicted less than a third as well as one of its own recordings.
    """
    n, m, own = plant.n_states, plant.n_inputs, plant
    if "another arm's model" in faults:
        own = Oscillators(rng)
        while (own.n_states, own.n_inputs) != (n, m):
            own = Oscillators(rng)
    model, data = fitted(own, rng)
    if "flipped sign" in faults:
        plant.mixing = -plant.mixing
    if "inputs swapped" in faults:
        plant.mixing = np.roll(plant.mixing, 1, axis=0)
    if own is plant and (plant.mixing == np.eye(m)).all():
        return model, data, False
    return model, data, missed(model, recorded(plant, rng, 1)) > 3.0 * missed(model, data)


def missed(model: LiftedModel, episodes: Episodes) -> float:
    """Root mean square of what the ``model`` misses in a step of the ``episodes``, in parts of its states' ranges."""
    D = model.n_delays
    parts = []
    for x, u in zip(episodes.xs, episodes.us, strict=True):
        at = np.arange(D, len(u))
        z = model.lift(x[at[:, None] + np.arange(-D, 1)], u[at[:, None] + np.arange(-D, 0)])
        parts.append((x[at + 1] - model.read(model.rollout(z, u[at][:, None]).z[:, 1])) / model.state_range)
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))


def one(seed: int) -> tuple[LoopLog | None, list[str], list[str]]:
    """A run: its log, its faults, and what is wrong with what came out."""
    rng = np.random.default_rng(seed)
    plant = Oscillators(rng)
    faults = [name for name, chance in FAULTS.items() if rng.uniform() < chance]
    model, data, wrong_model = mixed_up(plant, faults, rng)
    faults += ["wrong model"] * wrong_model
    n, m = plant.n_states, plant.n_inputs
    p = n // 2
    if "unstable model" in faults:
        model = replace(model, A=model.A * rng.uniform(1.05, 1.4))
    around: Any = plant
    if "stuck sensor" in faults:
        stuck = rng.choice(n, int(rng.integers(1, n + 1)), replace=False).tolist()
        around = plants.FrozenMeasurements(around, stuck, int(rng.integers(5, 40)), int(rng.integers(5, 30)))
    if "outliers" in faults:
        around = plants.Outliers(around, 0.1, float(rng.uniform(0.1, 5.0)), [[int(rng.integers(n))]], seed)
    if "NaN" in faults:
        around = plants.LostMeasurements(around, float(rng.uniform(0.05, 0.9)), None, seed)
    low = -rng.uniform(0.1, 1.0, m)
    high = rng.uniform(0.1, 1.0, m)
    rate = rng.uniform(0.02, 0.5, m)
    settings: dict[str, Any] = {"rate_weight": 10.0 ** rng.uniform(-5, 1), "estimator_gain": float(rng.uniform())}
    if "infeasible outputs" in faults:
        settings |= {"y_min": 0.3, "y_max": 0.31}
    if "few iterations" in faults:
        settings["qp"] = QPSettings(max_iterations=int(rng.integers(1, 20)), first_max_iterations=5)
    horizon = int(rng.integers(3, 25))
    size = 1e3 if "far reference" in faults else float(rng.uniform(0.05, 1.0))
    target = size * rng.uniform(-1.0, 1.0, (3, p))
    reference = references.setpoint(target, [0.2, 1.0, 2.0])
    plant.raises_at = int(rng.integers(STEPS)) if "plant raises" in faults else -1
    plant.fails_at = int(rng.integers(STEPS)) if "plant fails" in faults else -1
    watch = InnovationWatch(model, data)
    spoil = int(rng.integers(STEPS)) if "callback raises" in faults else -1

    def callback(step: Any) -> Any:
        if step.k == spoil:
            raise ValueError("no disk")
        return watch(step)

    wrong: list[str] = []
    try:
        mpc = MPC(model, horizon, low, high, rate, **settings)
        loop = ClosedLoop(around, mpc)
        if "limits tightened" in faults and not {"plant raises", "plant fails", "callback raises"} & set(faults):
            log = loop.run(reference, STEPS // 2, progress=False, callbacks=[callback])
            wrong += judged(log, low, high, rate)
            if not log.stopped:  # the present input stays allowed, wherever it is
                now = log.u[-1]
                low, high, rate = np.minimum(0.5 * low, now), np.maximum(0.5 * high, now), 0.5 * rate
                mpc.limit(low, high, rate)
                log = loop.resume(STEPS // 2, progress=False, callbacks=[callback])
                return log, faults, wrong + judged(log, low, high, rate, STEPS // 2)
        else:
            log = loop.run(reference, STEPS, progress=False, callbacks=[callback])
    except Exception as error:
        return None, faults, [f"{type(error).__name__} without a log: {error}"]
    return log, faults, wrong + judged(log, low, high, rate)


def judged(log: LoopLog, low: Array, high: Array, rate: Array, first: int = 0) -> list[str]:
    """What is wrong with a log, whose inputs from step ``first`` on have these limits."""
    found = []
    moves = np.diff(np.vstack([log.u0, log.u]), axis=0)[first:]
    if not np.isfinite(log.u).all():
        found.append("applied inputs that are not finite")
    if (log.u[first:] < low).any() or (log.u[first:] > high).any():
        found.append("applied inputs outside their box")
    if (np.abs(moves) > rate * (1.0 + 1e-9) + 1e-12).any():
        found.append("applied inputs faster than their limit")
    if log.limit_violations:
        found.append("limit violations counted")
    named = np.array([bool(action) for action in log.actions], dtype=bool)
    if not np.array_equal(named, log.fallback):
        found.append("a fallback without a name")
    if len(log.statuses) != len(log.u) or len(log.x) != len(log.u) + 1:
        found.append("a log of unequal lengths")
    return found


def counted(log: LoopLog, faults: list[str], counts: Counter[str], times: list[float]) -> None:
    """Whether a wrong model was named, and after how long, or a right one suspected."""
    mixed = [note for note in log.notes if any(text in note for text in MIXED_UP)]
    said = [note for note in log.notes if "innovations are" in note or note in mixed]
    if "wrong model" not in faults:
        if not set(faults) & (UNUSUAL | OTHERS):
            counts["loops on right models"] += 1
            counts["of these suspected"] += bool(said)
        return
    if "unstable model" in faults:  # its recordings contradict it, which is said before any loop
        return
    moving = np.flatnonzero(np.abs(log.u - log.u0).max(axis=1) > 0.05)
    known = np.array([not np.isnan(x).any() for x in log.x])
    whole = known[1:] & known[:-1]
    first = int(moving[0]) if len(moving) else len(log.u)
    at = round(float(said[0].split("t = ")[1].split(" s")[0]) / DT) if said else len(log.u)
    after = DT * int(np.count_nonzero(whole[first:at]))  # in which one could know
    if said:
        times.append(after)
    elif after > 1.0:
        times.append(np.inf)
    named = "wrong models that moved"
    counts[named] += bool(said) or after > 1.0
    counts[f"{named}: named within 1 s"] += bool(said) and after <= 1.0 + 1e-9
    counts[f"{named}: named by what is mixed up"] += bool(mixed)


def main() -> None:
    """Run them all and count."""
    made = parser((__doc__ or "").splitlines()[0])
    made.add_argument("--runs", type=int, default=2000)
    given = made.parse_args()
    runs = 40 if given.quick else given.runs
    if runs < 1:
        made.error(f"--runs {runs}; expected at least one")
    counts: Counter[str] = Counter()
    wrong: dict[int, list[str]] = {}
    times: list[float] = []
    for k in tqdm(range(runs), desc="closed loops", unit="run"):
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            log, faults, found = one(given.seed * 1_000_000 + k)
        counts.update(faults)
        if found:
            wrong[k] = [*found, *faults]
        if log is not None:
            counts["steps"] += len(log.u)
            counts["fallbacks"] += log.fallbacks
            counts.update({f"fallback: {name}": n for name, n in Counter(filter(None, log.actions)).items()})
            counts["runs with stuck sensors found"] += bool(log.stuck.any())
            counts["runs ended early, with their log"] += log.stopped
            counted(log, faults, counts, times)
    report = Report.of("MPC under stress", given)
    report.figure("runs", runs, "")
    report.figure("runs with a breach (limits, log, names)", len(wrong), "", ("<=", 0))
    if times:
        report.figure("median time until a wrong model is named", float(np.median(times)), "s", ("<=", 1.0))
        report.figure("wrong models not named within 1 s", sum(t > 1.0 + 1e-9 for t in times), "", ("<=", 0))
    for name, n in sorted(counts.items()):
        report.figure(name, n, "")
    for k, found in list(wrong.items())[:10]:
        print(f"run {k}: {'; '.join(found)}")
    report.write(given.json)
    print(report)
    if wrong:
        raise SystemExit(1)


if __name__ == "__main__":
    run(main)
