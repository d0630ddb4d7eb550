"""The record of a closed-loop run: what was measured, applied and how it went; printed, saved and loaded."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import Field, dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from pisplit.brief import brief
from pisplit.checks import Array, non_negative
from pisplit.controllers.loop.pacing import TOLERANCE
from pisplit.data import store
from pisplit.evaluation.matching import Fitted
from pisplit.lifted.model import LiftedModel
from pisplit.pictures.page import Outline, shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KIND = "pisplit/loop-log"
#: Units that people read in another one: label, factor.
SHOWN = {"m": ("mm", 1e3), "m/s": ("mm/s", 1e3), "1": ("", 1.0)}
SOLVED = "solved"
INTERRUPTED = "interrupted by the keyboard"


class Drawable(Protocol):
    """An arm that knows how it looks."""

    def outline(self, fields: Array, inputs: Array) -> Outline:
        """Backbone, tendons and tensions under measured ``fields`` (T, n) and ``inputs`` (T, m)."""


def shown_unit(unit: str) -> tuple[str, float]:
    """Label and factor in which numbers of a ``unit`` are printed: metres as mm, others as they are."""
    return SHOWN.get(unit, (unit, 1.0))


@brief
@dataclass(frozen=True, eq=False)
class LoopLog:
    """Record of N closed-loop steps; states have N + 1 rows, row 0 at the start.

    dt [s], t (N+1,) [s], x (N+1, n) measured states in the order of the model, NaN where nothing was measured,
    reference (N+1, p) with NaN where an output was free, u (N, m) applied inputs, u0 (m,) the input before them.
    ``tracked`` (p,): indices of the tracked states. ``state_names``, ``state_units`` (n,) and ``input_names``,
    ``input_units`` (m,) in the order of the model; a unit is "" where nobody told it.
    Per step (N,): ``statuses``, ``actions`` (what stood in for a solution, "" where there was one), ``iterations``,
    ``fallback``, ``solve_time`` and ``cpu_time`` of the controller [s],
    ``plant_time`` [s]; ``jitter`` [s]: how late the measurement after it was, NaN where the loop did not run by the
    clock; ``missing`` and ``rejected``: how many entries of the measurement that the move answers to were
    not there, and how many the observer did not believe; ``stuck``: how many of the missing came from sensors that
    repeated themselves while the arm must have moved. ``x`` is NaN there, and ``notes`` name the states.
    ``limit_violations``: applied inputs outside box or rate limits by more than 1e-9.
    ``message``: why the run ended early, empty otherwise; the arrays hold what was run. ``notes``: what else is to be
    known, e.g. a reference far outside the training data.
    For the page alone, not in files: ``outline`` of the arm, and ``ghost`` (N+1, n), the states that a model predicted
    ``ahead`` steps before, NaN in the first rows; see ``drawn`` and ``beside``.
    """

    dt: float
    t: Array
    x: Array
    reference: Array
    u: Array
    u0: Array
    tracked: tuple[int, ...]
    state_names: tuple[str, ...]
    input_names: tuple[str, ...]
    state_units: tuple[str, ...]
    input_units: tuple[str, ...]
    statuses: tuple[str, ...]
    actions: tuple[str, ...]
    iterations: Array
    fallback: Array
    solve_time: Array
    cpu_time: Array
    plant_time: Array
    jitter: Array
    missing: Array
    rejected: Array
    stuck: Array
    limit_violations: int
    message: str = ""
    notes: tuple[str, ...] = ()
    outline: Outline | None = field(default=None, repr=False)
    ghost: Array | None = field(default=None, repr=False)
    ahead: int = 0

    @property
    def y(self) -> Array:
        """Tracked outputs (N+1, p)."""
        return self.x[:, list(self.tracked)]

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names (p,) of the tracked outputs."""
        return tuple(self.state_names[i] for i in self.tracked)

    @property
    def output_units(self) -> tuple[str, ...]:
        """Units (p,) of the tracked outputs, "" where unknown."""
        return tuple(self.state_units[i] for i in self.tracked)

    @property
    def stopped(self) -> bool:
        """Whether the run ended early; ``message`` says why."""
        return bool(self.message)

    @property
    def interrupted(self) -> bool:
        """Whether it was the keyboard that ended the run."""
        return self.message.endswith(INTERRUPTED)

    @property
    def fallbacks(self) -> int:
        """Steps without an accepted solution."""
        return int(np.count_nonzero(self.fallback))

    @property
    def unsolved(self) -> int:
        """Steps whose solution was accepted though not solved to tolerance."""
        return sum(not f and s != SOLVED for f, s in zip(self.fallback, self.statuses, strict=True))

    @property
    def deadline_misses(self) -> int:
        """Steps whose controller took longer than dt."""
        return int(np.count_nonzero(self.solve_time > self.dt))

    @property
    def overruns(self) -> int:
        """Steps by the clock that ended later than a tenth of a step."""
        return int(np.count_nonzero(self.jitter > TOLERANCE * self.dt))

    @property
    def error(self) -> Array:
        """Distance (N+1,) of the tracked outputs from the reference, over the outputs that it specifies; NaN where one
        of them was not measured.

        Raises ValueError for outputs of several units: see ``rms_errors``.
        """
        if len(set(self.output_units)) > 1:
            raise ValueError(f"outputs in {sorted(set(self.output_units))} have no distance; use rms_errors()")
        return self._distance(range(len(self.tracked)))

    def rms_error(self, after: float = 0.0, before: float = np.inf) -> float:
        """Root mean square of ``error`` over ``after`` < t <= ``before`` [s], in output units. NaN if nothing was run
        there.

        Rows in which a tracked output was not measured are left out. The preview moves the plant ahead of a jump: read
        steady errors from windows that end H steps before it.
        """
        return _rms(self.error[self._between(after, before)])

    def rms_errors(self, after: float = 0.0, before: float = np.inf) -> dict[str, float]:
        """As ``rms_error`` over ``after`` < t <= ``before`` [s], apart for the outputs of each unit: unit -> error."""
        chosen, units = self._between(after, before), np.array(self.output_units)
        groups = {unit: np.flatnonzero(units == unit).tolist() for unit in dict.fromkeys(self.output_units)}
        return {unit: _rms(self._distance(group)[chosen]) for unit, group in groups.items()}

    def summary(self) -> str:
        """A few lines for people; errors in the outputs' own units (metres as mm), without one where it is unknown."""
        errors = ", ".join(_text(error, unit) for unit, error in self.rms_errors().items())
        lines = [f"{len(self.u)} steps, {self.t[-1]:.2f} s; RMS error {errors}"]
        if len(self.u):
            median, p99, worst = 1e3 * np.percentile(self.solve_time, [50, 99, 100])
            lines.append(
                f"controller: median {median:.2f} ms, p99 {p99:.2f} ms, maximum {worst:.2f} ms, "
                f"{self.deadline_misses} deadline misses; plant: median {1e3 * np.median(self.plant_time):.2f} ms"
            )
            found = ", ".join(f"{n} x {status}" for status, n in Counter(self.statuses).most_common())
            lines.append(
                f"{found}; {self.unsolved} not to tolerance, {self.fallbacks} fallbacks{_told(self.actions)}, "
                f"{self.limit_violations} limit violations"
            )
            late = self.jitter[np.isfinite(self.jitter)]
            if len(late):
                median, p99, worst = 1e3 * np.percentile(late, [50, 99, 100])
                lines.append(
                    f"real time: jitter median {median:.2f} ms, p99 {p99:.2f} ms, maximum {worst:.2f} ms, "
                    f"{self.overruns} overruns"
                )
        gaps = np.count_nonzero(self.missing)
        if gaps:
            lines.append(f"{gaps} steps with missing measurements, {int(self.missing.sum())} entries in all, bridged")
        if self.rejected.any():
            lines.append(f"{np.count_nonzero(self.rejected)} steps with rejected measurements")
        if self.stuck.any():
            lines.append(
                f"{np.count_nonzero(self.stuck)} steps with stuck sensors, {int(self.stuck.sum())} entries in all"
            )
        lines += self.notes
        if self.stopped:
            lines.append(f"stopped: {self.message}")
        return "\n".join(lines)

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Outputs and reference, their distance and the inputs over time; written to ``path`` where one is given."""
        from pisplit.controllers.loop.pictures import plot_log

        return plot_log(self, path)

    def drawn(self, arm: Drawable) -> LoopLog:
        """The same log with the outline of the ``arm``: its page shows the tendons, coloured by tension.

        Raises ValueError where the states are not the fields that the arm knows.
        """
        return replace(self, outline=arm.outline(self.x, np.vstack([self.u0, self.u])))

    def beside(self, model: LiftedModel | Fitted, ahead: int = 20) -> LoopLog:
        """The same log with a ghost: what the ``model`` predicted ``ahead`` steps before, under the applied inputs.

        The distance of arm and ghost is the error of the prediction. Raises ValueError for a model of other states.
        """
        from pisplit.controllers.loop.ghost import ghost_of

        return replace(self, ghost=ghost_of(self, model, ahead), ahead=ahead)

    def show(self) -> str:
        """Open the page of the run (``save("run.html")``) in the web browser; its path."""
        return shown(self.save)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the log to the HDF5 file ``path``, whole or not at all; as a page to look at where it ends in .html."""
        if os.fspath(path).lower().endswith((".html", ".htm")):
            from pisplit.controllers.loop.page import write_page

            write_page(self, path)
            return
        with store.writing(path, KIND) as file:
            for item in _kept():
                value = getattr(self, item.name)
                if item.name in _TEXTS:
                    store.write_strings(file, item.name, value)
                elif item.name == "message":
                    store.write_text(file, item.name, value)
                else:
                    file[item.name] = value

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> LoopLog:
        """Read the log saved at ``path``, or written there by a run that was killed or goes on (up to its last flush).

        Raises one line for files that are missing, damaged or of another kind.
        """
        from pisplit.controllers.loop.stream import begins_as_stream, read_stream

        if begins_as_stream(path):
            return read_stream(path)
        with store.reading(path, KIND) as file:
            parts: dict[str, object] = {}
            for item in _kept():
                if item.name == "actions" and item.name not in file:
                    parts[item.name] = ("",) * len(file["u"])
                elif item.name in _TEXTS:
                    parts[item.name] = store.read_strings(file, item.name)
                elif item.name == "message":
                    parts[item.name] = store.read_text(file, item.name)
                elif item.name in _COUNTS and item.name not in file:  # of a version that did not count them
                    parts[item.name] = np.zeros(len(file["u"]), dtype=int)
                elif item.name == "jitter" and item.name not in file:
                    parts[item.name] = np.full(len(file["u"]), np.nan)
                else:
                    parts[item.name] = np.asarray(file[item.name][()])
            parts["dt"], parts["limit_violations"] = float(parts["dt"]), int(parts["limit_violations"])  # type: ignore[arg-type, call-overload]
            parts["tracked"] = tuple(int(i) for i in parts["tracked"])  # type: ignore[attr-defined]
            return cls(**parts)  # type: ignore[arg-type]

    def _between(self, after: float, before: float) -> Array:
        return np.asarray((self.t > non_negative(after, "after", "s")) & (self.t <= before))

    def _distance(self, outputs: Sequence[int]) -> Array:
        y, wanted = self.y[:, list(outputs)], self.reference[:, list(outputs)]
        return np.asarray(np.sqrt((np.where(np.isnan(wanted), 0.0, y - wanted) ** 2).sum(axis=1)))


#: What is made for the page alone.
_PAGE = ("outline", "ghost", "ahead")
_COUNTS = ("missing", "rejected", "stuck")
_TEXTS = ("state_names", "input_names", "state_units", "input_units", "statuses", "actions", "notes")


def _told(actions: Sequence[str]) -> str:
    """What stood in for solutions, and how often, in brackets."""
    found = Counter(action for action in actions if action)
    return f" ({', '.join(f'{n} x {action}' for action, n in found.items())})" if found else ""


def _kept() -> list[Field[Any]]:
    """Fields that a file holds."""
    return [item for item in fields(LoopLog) if item.name not in _PAGE]


def _rms(error: Array) -> float:
    known = error[np.isfinite(error)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")


def _text(value: float, unit: str) -> str:
    label, factor = shown_unit(unit)
    return f"{factor * value:.4g} {label}".rstrip()
