"""Words of the command line for tables of recordings: those of ``Episodes.from_csv`` and ``Episodes.from_mat``."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

from pisplit import Episodes
from pisplit.data.recordings import INTERPOLATIONS
from pisplit.data.screening import KINDS

#: Words of text tables alone, and those of MATLAB files too.
TEXT = ("delimiter", "names", "decimal", "encoding", "commands", "command_time", "command_time_unit")
BOTH = (
    "episode",
    "dt",
    "time_unit",
    "state_units",
    "input_units",
    "max_gap",
    "interpolation",
    "command_shift",
)
#: Delimiters that a shell does not like to pass on.
DELIMITERS = {"tab": "\t", "blank": " "}


def add_words(command: argparse.ArgumentParser) -> None:
    """Add the words to a ``command``."""
    group = command.add_argument_group("tables", "what is in CSV or MATLAB files (docs/recordings.md)")
    add = group.add_argument
    add("--time", default="t", help="column of the times")
    add("--no-time", action="store_true", help="there is none: samples are --dt apart")
    add("--states", nargs="+", metavar="NAME", help="columns of the states")
    add("--inputs", nargs="+", metavar="NAME", help="columns of the inputs")
    add("--episode", metavar="NAME", help="column that names the run of every sample, for clocks that restart")
    add("--dt", type=float, help="time step in s that tables are brought to")
    add("--time-unit", help="s, ms, us, ns, min, hour, day, or seconds a tick")
    add("--state-units", nargs="+", metavar="UNIT", help="of the states, one for all or one each")
    add("--input-units", nargs="+", metavar="UNIT", help="of the inputs, one for all or one each")
    add("--range", nargs=3, action="append", metavar=("NAME", "LOW", "HIGH"), help="that readings must lie in, SI")
    add("--max-gap", type=float, help="longest gap in s that is bridged")
    add("--interpolation", choices=INTERPOLATIONS, help="of the states between readings")
    add("--keep", nargs="+", choices=KINDS, default=[], help="readings that are not screened")
    add("--commands", nargs="+", metavar="FILE", help="CSV files of the inputs, which have a clock of their own")
    add("--command-time", metavar="NAME", help="column of the times there")
    add("--command-time-unit", metavar="UNIT", help="of them")
    add("--command-shift", help="s to add to the times of commands, negative where they are stamped late, or found")
    add("--names", nargs="+", metavar="NAME", help="of all columns, for CSV files without a header")
    add("--delimiter", help="of CSV files, one character, tab or blank")
    add("--decimal", choices=[".", ","], help="mark of numbers in CSV files")
    add("--encoding", help="of CSV files")


def of_tables(given: argparse.Namespace) -> Episodes:
    """Recordings of the tables that the words ``given`` on the command line name.

    Raises ValueError, in one line, for words that are missing, or of another kind of file.
    """
    if not given.states or not given.inputs:
        raise ValueError("CSV and MATLAB files need --states and --inputs: names of their columns")
    time = None if given.no_time else given.time
    suffixes = {file.suffix.lower() for file in given.files}
    if ".mat" in suffixes:
        odd = [name for name in TEXT if getattr(given, name) is not None]
        if odd:
            raise ValueError(f"--{odd[0].replace('_', '-')} is a word of CSV files; leave it out for MATLAB files")
        if len(given.files) > 1:
            raise ValueError(f"{len(given.files)} files, one of MATLAB; give one MATLAB file, or CSV files")
        return Episodes.from_mat(given.files[0], time, given.states, given.inputs, **_options(given, BOTH))
    return Episodes.from_csv(given.files, time, given.states, given.inputs, **_options(given, (*TEXT, *BOTH)))


def _options(given: argparse.Namespace, words: tuple[str, ...]) -> Mapping[str, Any]:
    """Options of the ``words`` that were said."""
    found = {name: getattr(given, name) for name in words if getattr(given, name) is not None}
    for name in ("state_units", "input_units"):
        if name in found and len(found[name]) == 1:
            found[name] = found[name][0]
    for name in ("time_unit", "command_time_unit", "command_shift"):
        if name in found:
            found[name] = _ticks(found[name])
    if "delimiter" in found:
        found["delimiter"] = DELIMITERS.get(found["delimiter"], found["delimiter"])
    if given.range:
        try:
            found["ranges"] = {name: (float(low), float(high)) for name, low, high in given.range}
        except ValueError:
            raise ValueError(f"--range {given.range} has a limit that is no number; give NAME LOW HIGH") from None
    if given.keep:
        found["screen"] = tuple(kind for kind in KINDS if kind not in given.keep)
    return found


def _ticks(unit: str) -> str | float:
    """A unit, or seconds a tick."""
    try:
        return float(unit)
    except ValueError:
        return unit
