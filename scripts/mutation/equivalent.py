"""Mutants that compute the same, and why: no test can notice them, so they do not count."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mutation.operators import Mutation


@dataclass(frozen=True)
class Equivalent:
    """In ``file``, changing the line ``before`` to ``after`` changes no answer, because of ``reason``."""

    file: str
    before: str
    after: str
    reason: str

    def gone(self, root: Path) -> bool:
        """True if the line is not in the file any more, blanks aside."""
        path = root / self.file
        text = " ".join(path.read_text().split()) if path.is_file() else ""
        return self.before not in text


EQUIVALENT: tuple[Equivalent, ...] = ()


def reason_for(mutation: Mutation, known: tuple[Equivalent, ...] = EQUIVALENT) -> str | None:
    """Why the mutation is none, or None."""
    return next((e.reason for e in known if (e.file, e.before, e.after) == mutation.key), None)
