"""What became of every mutant, kept on disk so that a run that was stopped goes on."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from mutation.copies import Copy, file_digest
from mutation.operators import Mutation
from mutation.rooms import PACKAGE
from pisplit.files import write_text

#: What counts as noticed. A crash is one: the tests end with it.
NOTICED = ("killed", "timeout", "crash")


@dataclass(frozen=True)
class Result:
    """What became of a mutant: "killed" ``by`` a test, "timeout", "crash", "survived" or "not covered"."""

    how: str
    by: str = ""

    @property
    def noticed(self) -> bool:
        """Whether some test fails, stops or crashes."""
        return self.how in NOTICED


class Results:
    """Results for the sources as they are; a survivor is tried again when any test changes, a kill if its test does."""

    def __init__(self, path: Path, copy: Copy, asked: Sequence[str] = ()) -> None:
        self._path, self._folder = path, copy.folder
        self._package = copy.digest(*PACKAGE)
        self._tests = " ".join((copy.digest("tests"), *asked))
        self._entries: dict[str, dict[str, str]] = json.loads(path.read_text()) if path.exists() else {}

    def get(self, mutation: Mutation) -> Result | None:
        """What became of this mutant, if that is known and still true."""
        entry = self._entries.get(self._key(mutation))
        if entry is None or entry["tests"] != self._relevant(entry["by"]):
            return None
        return Result(entry["how"], entry["by"])

    def put(self, mutation: Mutation, result: Result) -> None:
        """Keep a result; the file is whole at any time."""
        self._entries[self._key(mutation)] = {**asdict(result), "tests": self._relevant(result.by)}
        write_text(self._path, json.dumps(self._entries))

    def _relevant(self, killer: str) -> str:
        return file_digest(self._folder / killer.split("::")[0].split(" ")[0]) if killer else self._tests

    def _key(self, m: Mutation) -> str:
        return hashlib.sha256(f"{self._package} {m.file} {m.start} {m.end} {m.new}".encode()).hexdigest()[:20]


def table(rooms: Mapping[str, Sequence[Mutation]], results: Mapping[Mutation, Result]) -> str:
    """One line a room: mutants by what became of them, and the part that was noticed."""
    columns = (*NOTICED, "survived", "not covered")
    lines = [f"{'room':<14}" + "".join(f"{c:>13}" for c in ("mutants", *columns, "noticed"))]
    counts = {room: Counter(results[m].how for m in found if m in results) for room, found in rooms.items()}
    for room, count in {**counts, "all": sum(counts.values(), Counter())}.items():
        total = sum(count.values())
        part = f"{100.0 * sum(count[c] for c in NOTICED) / total:.1f} %" if total else "-"
        lines.append(f"{room:<14}{total:>13}" + "".join(f"{count[c]:>13}" for c in columns) + f"{part:>13}")
    return "\n".join(lines)
