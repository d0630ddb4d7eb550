"""A controller closed on a plant, and the record of the run."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from tqdm import tqdm

from pisplit.checks import Array, count, non_negative
from pisplit.controllers.loop.plant import Plant
from pisplit.controllers.loop.tracking import Controller, start_input
from pisplit.controllers.references import Reference

DIVERGENCE_FACTOR = 1e3
LIMIT_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class LoopLog:
    """Record of N closed-loop steps; states have N + 1 rows, row 0 at the start.

    t (N+1,) [s], x (N+1, n) measured states, y (N+1, p) tracked outputs, reference (N+1, p) with NaN where an output
    was free, u (N, m) applied inputs, u0 (m,) the input before them. Per step (N,): ``statuses``, ``iterations``,
    ``fallback``, ``solve_time`` and ``cpu_time`` of the controller [s], ``plant_time`` [s].
    ``fallbacks``: steps without an accepted solution; ``deadline_misses``: steps whose controller took longer than dt;
    ``limit_violations``: applied inputs outside box or rate limits by more than 1e-9.
    ``stopped``: the run ended early, ``message`` says why, and the arrays hold what was run.
    """

    t: Array
    x: Array
    y: Array
    reference: Array
    u: Array
    u0: Array
    statuses: tuple[str, ...]
    iterations: Array
    fallback: Array
    solve_time: Array
    cpu_time: Array
    plant_time: Array
    fallbacks: int
    deadline_misses: int
    limit_violations: int
    stopped: bool
    message: str

    @property
    def error(self) -> Array:
        """Distance (N+1,) of the tracked outputs from the reference, over the outputs that it specifies."""
        return np.asarray(np.sqrt(np.nansum((self.y - self.reference) ** 2, axis=1)))

    def rms_error(self, after: float = 0.0, before: float = np.inf) -> float:
        """Root mean square of ``error`` over after < t <= before [s], in output units. NaN if nothing was run there.

        The preview moves the plant ahead of a jump: read steady errors from windows that end H steps before it.
        """
        chosen = (self.t > non_negative(after, "after", "s")) & (self.t <= before)
        return float(np.sqrt(np.mean(self.error[chosen] ** 2))) if chosen.any() else float("nan")

    def summary(self) -> str:
        """A few lines for people."""
        lines = [f"{len(self.u)} steps, {self.t[-1]:.2f} s; RMS error {1e3 * self.rms_error():.3f} mm"]
        if len(self.u):
            median, p99, worst = 1e3 * np.percentile(self.solve_time, [50, 99, 100])
            lines.append(
                f"controller: median {median:.2f} ms, p99 {p99:.2f} ms, maximum {worst:.2f} ms, "
                f"{self.deadline_misses} deadline misses; plant: median {1e3 * np.median(self.plant_time):.2f} ms"
            )
            found = ", ".join(f"{n} x {status}" for status, n in Counter(self.statuses).most_common())
            lines.append(f"{found}; {self.fallbacks} fallbacks, {self.limit_violations} limit violations")
        if self.stopped:
            lines.append(f"stopped: {self.message}")
        return "\n".join(lines)


class ClosedLoop:
    """A plant and a controller whose sizes and time steps match; raises ValueError if they do not."""

    def __init__(self, plant: Plant, controller: Controller) -> None:
        model = controller.model
        for name, of_plant, of_model in (
            ("states", plant.n_states, model.n_states),
            ("inputs", plant.n_inputs, model.n_inputs),
        ):
            if of_plant != of_model:
                raise ValueError(
                    f"the plant has {of_plant} {name}, the model {of_model}: a model fitted for another arm; refit it"
                )
        if not np.isclose(plant.dt, model.dt, rtol=1e-6, atol=0.0):
            raise ValueError(f"the plant steps {plant.dt:g} s, the model {model.dt:g} s; give both the same dt")
        self.plant = plant
        self.controller = controller

    def run(self, reference: Reference, steps: int, u0: ArrayLike | None = None, progress: bool = True) -> LoopLog:
        """Run ``steps`` steps from rest under u0 (m,), zeros if not given, along the reference.

        A plant that fails, leaves 1e3 times the range of the training data or measures numbers that are not finite
        ends the run; the log says so. Raises ValueError if reference and controller do not fit.
        """
        N = count(steps, "steps")
        plant, controller = self.plant, self.controller
        tracked = list(controller.tracked)
        if reference.track != controller.track and controller.track != "states":
            raise ValueError(f"the reference is for {reference.track!r}, the controller tracks {controller.track!r}")
        start = start_input(u0, controller.u_min, controller.u_max)
        controller.reset(start)
        x0 = np.asarray(plant.reset(start), dtype=np.float64)
        problem = _fault(x0, controller)
        if problem:
            raise ValueError(f"the plant at rest {problem}; check the model's units and the plant")
        dt = float(plant.dt)
        t = np.asarray(dt * np.arange(N + controller.horizon + 1), dtype=np.float64)
        wanted = _reference_samples(reference, controller, x0, t)

        x, u, moves, plant_time, message = [x0], [], [], [], ""
        for k in tqdm(range(N), disable=not progress, desc="closed loop", unit="step"):
            move = controller.step(x[-1], wanted[k + 1 : k + 1 + controller.horizon])
            begin = time.perf_counter()
            after = plant.step(move.u)
            plant_time.append(time.perf_counter() - begin)
            moves.append(move)
            u.append(move.u)
            state = np.asarray(after.state, dtype=np.float64)
            problem = f"failed: {after.message or 'no reason given'}" if not after.ok else _fault(state, controller)
            if problem:
                message = f"step {k + 1} of {N} (t = {(k + 1) * dt:.3f} s): the plant {problem}"
                # The input that broke the plant belongs to no completed step.
                moves.pop(), u.pop(), plant_time.pop()
                break
            x.append(state)

        steps_run = len(u)
        inputs = np.reshape(u, (steps_run, len(start)))
        states = np.asarray(x)
        solve_time = np.array([move.solve_time for move in moves])
        return LoopLog(
            t=t[: steps_run + 1],
            x=states,
            y=states[:, tracked],
            reference=wanted[: steps_run + 1],
            u=inputs,
            u0=start,
            statuses=tuple(move.status for move in moves),
            iterations=np.array([move.iterations for move in moves], dtype=int),
            fallback=np.array([move.fallback for move in moves], dtype=bool),
            solve_time=solve_time,
            cpu_time=np.array([move.cpu_time for move in moves]),
            plant_time=np.array(plant_time),
            fallbacks=sum(move.fallback for move in moves),
            deadline_misses=int(np.count_nonzero(solve_time > dt)),
            limit_violations=_count_violations(inputs, start, controller),
            stopped=bool(message),
            message=message,
        )


def _fault(x: Array, controller: Controller) -> str:
    """What is wrong with a measured state, or an empty text."""
    if not np.isfinite(x).all():
        return f"measured {np.count_nonzero(~np.isfinite(x))} states that are not finite"
    tracked = list(controller.tracked)
    y, reach = np.abs(x[tracked]), DIVERGENCE_FACTOR * controller.model.state_range[tracked]
    if (y > reach).any():
        i = int(np.argmax(y - reach))
        return f"diverged: {controller.model.state_names[tracked[i]]} = {y[i]:.3g} left 1e3 times the training range"
    return ""


def _reference_samples(reference: Reference, controller: Controller, x0: Array, t: Array) -> Array:
    """The reference (len(t), p) from the measured start, reduced to the controller's axes."""
    if controller.track == "states":
        group = list(controller.tracked)
    else:
        group = list(controller.model.outputs[controller.track])
    of_group = reference.width == len(group)
    bound = reference.starting_at(x0[group if of_group else list(controller.tracked)])
    if bound.width == len(controller.tracked):
        return bound(t)
    if of_group:
        return bound(t)[:, list(controller.axes)]
    raise ValueError(
        f"the reference has {reference.width} coordinates, the controller tracks {len(controller.tracked)} outputs"
    )


def _count_violations(u: Array, u0: Array, controller: Controller) -> int:
    """Steps whose applied input is outside the box or changed faster than the rate limits."""
    if not len(u):
        return 0
    change = np.abs(np.diff(u, axis=0, prepend=u0[None]))
    bad = (u < controller.u_min - LIMIT_TOLERANCE) | (u > controller.u_max + LIMIT_TOLERANCE)
    bad |= change > controller.du_max + LIMIT_TOLERANCE
    return int(np.count_nonzero(bad.any(axis=1)))
