"""One look at recordings: how long, how fine, how noisy, what moved, what is suspicious."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pisplit.brief import brief
from pisplit.data import suspicions
from pisplit.data.latency import Latency, find_latency
from pisplit.data.rounding import coarse

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pisplit.data.episodes import Episodes

Array = NDArray[np.float64]

#: Inputs whose correlation is larger move together.
TOGETHER = 0.9
#: Facts of the origin that count samples.
COUNTED = ("samples", "incomplete_samples", "lost_samples", "pieces")


@dataclass(frozen=True)
class Column:
    """One state or input in all episodes, in its unit.

    name, unit  as in the episodes
    kind        "state" or "input"
    low, high   least and largest value
    spread      standard deviation
    noise       standard deviation of the noise of a state, from differences of third order; None where motion hides it
                and for inputs
    hold        median number of steps for which an input stays the same; None for states
    suspicions  what is odd about it, in words: constant, duplicated, saturated, stalled, spikes, few values
    """

    name: str
    unit: str
    kind: str
    low: float
    high: float
    spread: float
    noise: float | None
    hold: float | None
    suspicions: tuple[str, ...]


@brief
@dataclass(frozen=True, eq=False)
class DataReport:
    """Facts about recordings, by :meth:`pisplit.Episodes.report`; ``str`` is a table of them, :meth:`plot` a picture.

    episodes      their number
    steps         (E,) steps of each
    dt            step [s]
    duration      of all of them [s]
    origin        counts of the import: samples, incomplete and lost ones, pieces, jitter [s], screened readings
    columns       states, then inputs
    directions    one line a direction of the inputs: how much it varies, kept or held
    excited       number of those that are kept
    correlations  (m, m) of the inputs, NaN where one is constant
    latency       when the motion follows the commands
    remarks       what to think about before a fit, most serious first
    drawn         the recordings themselves, for :meth:`plot`
    """

    episodes: int
    steps: tuple[int, ...]
    dt: float
    duration: float
    origin: Mapping[str, Any]
    columns: tuple[Column, ...]
    directions: tuple[str, ...]
    excited: int
    correlations: Array
    latency: Latency
    remarks: tuple[str, ...]
    drawn: Any = None

    def __str__(self) -> str:
        shortest, longest = min(self.steps), max(self.steps)
        lengths = f"{shortest} steps" if shortest == longest else f"{shortest} to {longest} steps"
        lines = [f"{self.episodes} episodes of {lengths} of {self.dt:.6g} s, {self.duration:.4g} s in all"]
        if self.origin:
            lines.append("from " + ", ".join(f"{_number(v)} {k.replace('_', ' ')}" for k, v in self.origin.items()))
        lines += ["", *_table(self.columns)]
        if self.directions:
            lines += ["", f"directions of the inputs, {self.excited} of {len(self.directions)} excited:"]
            lines += [f"  {line}" for line in self.directions]
            lines.append(f"motion after commands: {self.latency}")
        if self.remarks:
            lines += ["", *(f"! {remark}" for remark in self.remarks)]
        return "\n".join(lines)

    def as_dict(self) -> dict[str, Any]:
        """The same facts as JSON-able numbers, texts and lists; None in the place of what is not known."""
        late = self.latency
        return {
            "episodes": self.episodes,
            "steps": list(self.steps),
            "dt": self.dt,
            "duration": self.duration,
            "origin": dict(self.origin),
            "columns": [{**asdict(c), "suspicions": list(c.suspicions)} for c in self.columns],
            "directions": list(self.directions),
            "excited": self.excited,
            "correlations": [[None if np.isnan(v) else float(v) for v in row] for row in self.correlations],
            "latency": {"delay": late.delay, "error": late.error if np.isfinite(late.error) else None},
            "remarks": list(self.remarks),
        }

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """A picture: the longest episode, inputs against one another, the scan of the delay; written to ``path``."""
        from pisplit.data.pictures import plot_report

        return plot_report(self, path)


def report_on(episodes: Episodes) -> DataReport:
    """Look at ``episodes``: lengths, gaps, ranges, noise, excited inputs, delay, suspicious columns, correlations."""
    x, u = episodes.stacked_states(), episodes.stacked_inputs()
    runs = suspicions.rows_of([len(part) for part in episodes.xs])
    before = suspicions.rows_of([len(part) for part in episodes.us])
    odd = suspicions.of_states(episodes, runs)
    columns = []
    for i, name in enumerate(episodes.state_names or ()):
        noise = suspicions.noise_level(x[:, i], runs)
        columns.append(_column(x[:, i], name, (episodes.units or ())[i], "state", noise, None, odd[i]))
    odd_inputs = suspicions.of_inputs(episodes)
    for i, name in enumerate(episodes.input_names or ()):
        hold = suspicions.usual_hold(u[:, i], before)
        columns.append(_column(u[:, i], name, (episodes.input_units or ())[i], "input", None, hold, odd_inputs[i]))
    found = episodes.input_directions()
    directions = found.lines(episodes.input_names or ()) if episodes.n_inputs else ()
    away = u - u.mean(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        away = away / np.linalg.norm(away, axis=0)
        correlations = away.T @ away
    latency = find_latency(episodes.xs, episodes.us, episodes.dt)
    steps = tuple(len(part) for part in episodes.us)
    return DataReport(
        len(episodes),
        steps,
        episodes.dt,
        episodes.dt * sum(steps),
        _origin(episodes.provenance or {}),
        tuple(columns),
        directions,
        found.basis.shape[1],
        correlations,
        latency,
        tuple(_remarks(columns, steps, episodes, found.basis.shape[1], correlations, latency)),
        episodes,
    )


def _table(columns: Sequence[Column]) -> list[str]:
    """One line a column, under a head."""
    width, unit = max(len(c.name) for c in columns), max(4, *(len(c.unit) for c in columns))
    head = f"{'least':>10} {'largest':>10} {'spread':>9} {'noise':>9}  suspicions"
    lines = [f"{'column':<{width + 6}} {'unit':<{unit}} {head}"]
    for c in columns:
        noise = f"{c.noise:.2g}" if c.noise is not None else "hidden" if c.hold is None else f"holds {c.hold:.3g}"
        numbers = f"{c.low:>10.4g} {c.high:>10.4g} {c.spread:>9.3g} {noise:>9}"
        lines.append(
            f"{c.kind:<6}{c.name:<{width}} {c.unit or '?':<{unit}} {numbers}  {'; '.join(c.suspicions)}".rstrip()
        )
    return lines


def _column(
    values: Array, name: str, unit: str, kind: str, noise: float | None, hold: float | None, odd: Sequence[str]
) -> Column:
    low, high, spread = float(values.min()), float(values.max()), float(values.std())
    return Column(name, unit, kind, low, high, spread, noise, hold, tuple(odd))


def _origin(provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Counts of the import, those of recordings that were joined added up."""
    parts = provenance.get("parts", [provenance])
    found: dict[str, Any] = {}
    for name in COUNTED:
        if any(name in part for part in parts):
            found[name] = sum(int(part.get(name, 0)) for part in parts)
    taken = sum(max(columns.values()) for part in parts for columns in part.get("screened", {}).values())
    if taken:
        found["screened_readings"] = taken
    jitter = [float(part["jitter"]) for part in parts if "jitter" in part]
    return {**found, "s_jitter": round(max(jitter), 9)} if jitter else found  # rounding of times is none


def _number(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _remarks(
    columns: Sequence[Column],
    steps: Sequence[int],
    episodes: Episodes,
    excited: int,
    correlations: Array,
    latency: Latency,
) -> list[str]:
    m, found, late = episodes.n_inputs, [], latency.delay
    if late is not None and late < -latency.error:
        found.append(f"the motion comes {-1e3 * late:.0f} ms before the commands: clocks are not one (command_shift=)")
    elif late is not None and late > max(latency.error, episodes.dt):
        found.append(
            f"the motion follows the commands by {late / episodes.dt:.1f} steps: take delays of inputs, "
            f"and command_delay in MPC"
        )
    if m == 0:
        found.append("there are no inputs: what is learned cannot be controlled")
    elif excited == 0:
        found.append("the inputs never change: what they do cannot be learned")
    elif excited < m:
        found.append(f"the inputs move in {excited} of {m} directions: along the others nothing can be learned")
    names = episodes.input_names or ()
    for i, j in zip(*np.nonzero(np.tril(np.abs(np.nan_to_num(correlations)) > TOGETHER, -1)), strict=True):
        if excited == m:
            pair = f"{names[j]} and {names[i]} move together (correlation {correlations[i, j]:.2f})"
            found.append(f"{pair}: their effects are hard to tell apart")
    if len(steps) < 3:
        found.append(f"{len(steps)} recording{'s' if len(steps) > 1 else ''}: little can be held out for a test")
    if min(steps) < 10:
        found.append(f"{sum(n < 10 for n in steps)} of {len(steps)} episodes are shorter than 10 steps")
    if rough := coarse(episodes):
        name, step, part = rough[0]
        more = f" and {len(rough) - 1} more" if len(rough) > 1 else ""
        found.append(
            f"{name}{more}: rounded to {step:.3g}, {100 * part:.0f} % of the usual change: where the log rounds and "
            "the robot does not, pisplit.data.unrounded(d1) makes them smooth again"
        )
    noisy = [c.name for c in columns if c.noise is not None and c.noise > 0.2 * c.spread > 0.0]
    if noisy:
        found.append(f"noise is more than a fifth of the spread of {', '.join(noisy[:4])}")
    odd = [f"{c.name} ({c.suspicions[0]})" for c in columns if c.suspicions]
    if odd:
        found.append(f"look at {', '.join(odd[:6])}{f' and {len(odd) - 6} more' if len(odd) > 6 else ''}")
    return found
