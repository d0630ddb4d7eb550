"""What an identification says of itself: one screen of text, one picture."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

#: Width of the text.
WIDTH = 110


@dataclass(frozen=True)
class Tried:
    """A candidate and what became of it.

    Attributes:
        name: of the candidate.
        error: root mean square error of held-out roll-outs over the compared states; infinite where one diverged, and
            where it could not be fitted.
        note: why it was not tried, was refused or is worse than its error says; empty otherwise.
        seconds: CPU time of its fit.
    """

    name: str
    error: float
    note: str
    seconds: float


@dataclass(frozen=True)
class Report:
    """One screen about a model; ``print`` it.

    Attributes:
        chosen: name of the candidate.
        reason: why it was chosen.
        tried: all candidates.
        unit: of their errors.
        horizons: rows (seconds ahead, normalised error, error of the tip or None) on held-out recordings; a normalised
            error of 1 is that of predicting the mean.
        tip: name and unit of what the third column is about, empty without it.
        data: what it was learned from.
        unfit: what the model is not fit for.
        helps: what would help most.
        code: what does the same by hand.
        predicted: errors to expect under commands that were not recorded (:func:`pisplit.predicted_error`), in words.
    """

    chosen: str
    reason: str
    tried: tuple[Tried, ...]
    unit: str
    horizons: tuple[tuple[float, float, float | None], ...]
    tip: str
    data: str
    unfit: tuple[str, ...]
    helps: tuple[str, ...]
    code: str
    predicted: str = ""

    def __str__(self) -> str:
        width = max(len(t.name) for t in self.tried)
        unit = f" ({self.unit})" if self.unit else ""
        lines = [f"model    {self.chosen}: {self.reason}", f"data     {self.data}", "", f"tried    held-out RMS{unit}"]
        for t in self.tried:
            error = f"{t.error:10.3g}" if np.isfinite(t.error) else f"{'-':>10}"
            lines += _wrapped(f"  {t.name:<{width}} {error}  ", t.note or f"{t.seconds:.1f} s of CPU")
        lines += [
            "",
            f"expected error of held-out roll-outs (1 = predicting the mean){'; ' + self.tip if self.tip else ''}",
        ]
        lines.append("  ahead (s)  " + "".join(f"{t:>9.3g}" for t, _, _ in self.horizons))
        lines.append("  normalised " + "".join(f"{e:>9.2g}" for _, e, _ in self.horizons))
        if self.tip:
            lines.append("  tip        " + "".join(f"{e:>9.2g}" for *_, e in self.horizons))
        if self.predicted:
            lines += ["", *_wrapped("predicted ", self.predicted)]
        for title, items in (("not fit for", self.unfit), ("what would help most", self.helps)):
            lines += ["", title]
            for item in items:
                lines += _wrapped("  - ", item)
        return "\n".join([*lines, "", "by hand", textwrap.indent(self.code, "  ")])

    __repr__ = __str__

    def as_dict(self) -> dict[str, Any]:
        """The same as JSON-able facts; infinite errors are None."""
        found = asdict(self)
        found["tried"] = [{**t, "error": t["error"] if np.isfinite(t["error"]) else None} for t in found["tried"]]
        found["horizons"] = [[None if v is None or not np.isfinite(v) else float(v) for v in r] for r in self.horizons]
        return found

    @classmethod
    def of_dict(cls, facts: Mapping[str, Any]) -> Report:
        """The report whose ``facts`` ``as_dict`` gave."""
        tried = tuple(Tried(**{**t, "error": np.inf if t["error"] is None else t["error"]}) for t in facts["tried"])
        rows = [[np.inf if v is None and k < 2 else v for k, v in enumerate(row)] for row in facts["horizons"]]
        horizons = tuple((float(a), float(b), c) for a, b, c in rows)
        listed = {name: tuple(facts[name]) for name in ("unfit", "helps")}
        return cls(**{**facts, "tried": tried, "horizons": horizons, **listed})


def _wrapped(head: str, text: str) -> list[str]:
    body = textwrap.wrap(text, WIDTH - len(head)) or [""]
    return [head + body[0], *(" " * len(head) + line for line in body[1:])]
