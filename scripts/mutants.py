"""Do the tests notice single-line mistakes? Mutants of the formulas, each run against the tests that execute it.

A sample of single-line mutations (signs, factors, constants, comparisons, transposes, indices, dropped statements) of
the rooms named in mutation/rooms.py, an equal share a room by the root of its size, and all of mutation/named.py.
Mutated source stands only in copies under the folder of --out. Mutants of mutation/equivalent.py are not counted. A run
that is stopped goes on when it is started again. Ends with 1 if fewer than 95 % are noticed or a named one is not.
"""

from __future__ import annotations

import argparse
import os
import random
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from tqdm import tqdm

from common.report import Report, parser, run
from mutation.copies import Copy
from mutation.equivalent import EQUIVALENT, reason_for
from mutation.forks import LIBRARIES, Task, load_libraries, run_forked
from mutation.named import NAMED
from mutation.operators import Mutation, mutations
from mutation.reached import Reach, measure_reach
from mutation.results import Result, Results, table
from mutation.rooms import files
from mutation.trial import Trial, covering, plan, try_out

ROOT = Path(__file__).resolve().parent.parent
TARGET = 0.95
#: Wall-clock time of a trial beyond which it hangs: this many times its CPU time, and this many seconds.
HANGING, AT_LEAST = 10.0, 120.0


def main() -> None:
    """Choose mutants, try them out, print what became of them."""
    given = _arguments()
    started = time.monotonic()
    given.out.mkdir(parents=True, exist_ok=True)
    copies = [Copy(given.root, given.out.resolve() / f"copy{i}") for i in range(given.jobs)]
    source = copies[0].folder
    rooms = _chosen(source, given)
    named = {n: n.mutation(source) for n in NAMED} if given.root == ROOT and not given.module else {}
    rooms["named"] = [m for m in named.values() if m is not None]
    lost = [n for n, m in named.items() if m is None]
    stale = [e for e in EQUIVALENT if e.gone(source)] if given.root == ROOT else []

    load_libraries(LIBRARIES if given.root == ROOT else ("coverage", "pytest"))
    reach = measure_reach(copies, given.out / "reach.json", given.tests)
    for copy in copies[1:]:
        copy.take_bytecode(copies[0])
        copies[0].take_bytecode(copy)
    results = _try_all(rooms, reach, copies, Results(given.out / "results.json", copies[0], given.tests), given)

    report = Report.of("Mutants", given)
    noticed, total = sum(r.noticed for r in results.values()), len(results)
    report.figure("mutants", total, "")
    report.figure("noticed", 100.0 * noticed / max(total, 1), "%", (">=", 100.0 * TARGET))
    report.figure("named mutants not noticed", sum(not results[m].noticed for m in rooms["named"]), "", ("<=", 0.0))
    report.figure("named mutants whose line is gone", len(lost), "", ("<=", 0.0))
    report.figure("known equivalents", len(EQUIVALENT), "")
    report.figure("known equivalents whose line is gone", len(stale), "")
    report.figure("tests that fail without a mutation", len(reach.failed) + len(reach.unmeasured), "")
    report.figure("CPU time of all tests", sum(t.seconds for t in reach.tests), "s")
    report.figure("run time", time.monotonic() - started, "s")
    for mutation, result in sorted(results.items(), key=lambda pair: (pair[0].file, pair[0].line)):
        if not result.noticed:
            print(f"{result.how}: {mutation}")
    for n in lost:
        print(f"no such line: {n.file}: {n.old!r} ({n.fact})")
    for e in stale:
        print(f"known equivalent that is gone: {e.file}: {e.before!r} -> {e.after!r}")
    for name in (*reach.failed, *reach.unmeasured):
        print(f"fails without a mutation: {name}")
    print(table(rooms, results), report, sep="\n")
    report.write(given.json)
    if noticed < TARGET * total or lost or not all(results[m].noticed for m in rooms["named"]):
        sys.exit(1)


def _arguments() -> argparse.Namespace:
    made = parser(__doc__.splitlines()[0], "out/mutants")
    made.add_argument("--sample", type=int, default=360, metavar="N", help="number of random mutants")
    made.add_argument("--module", default="", metavar="TEXT", help="only files whose path contains this, and no named")
    made.add_argument("--tests", nargs="*", default=[], metavar="TEXT", help="only test files named like this")
    made.add_argument("--jobs", type=int, default=2, metavar="N", help="mutants at a time")
    made.add_argument("--budget", type=float, default=40.0, metavar="S", help="CPU time of the tests of one mutant")
    made.add_argument(
        "--grace", type=float, default=10.0, metavar="S", help="CPU time a test may take beyond 3 x its own"
    )
    made.add_argument("--root", type=Path, default=ROOT, metavar="DIR", help="source tree; default this one")
    given = made.parse_args()
    if given.sample < 0 or given.jobs < 1 or not given.budget > 0.0:
        raise ValueError("expected --sample of 0 or more, --jobs of 1 or more and a --budget above 0")
    if not given.grace > 0.0:
        raise ValueError(f"--grace is {given.grace:g}; expected seconds above 0")
    if given.quick:
        given.sample = min(given.sample, 20)
    given.root = given.root.resolve()
    return given


def _chosen(source: Path, given: argparse.Namespace) -> dict[str, list[Mutation]]:
    """A random sample of mutants that are not known to be equivalent, by room."""
    generator = random.Random(given.seed)
    pools: dict[str, list[Mutation]] = {}
    for room, names in files(source).items():
        wanted = [name for name in names if given.module in name]
        found = [m for name in wanted for m in mutations(name, (source / name).read_bytes())]
        generator.shuffle(found)  # before anything is left out: a longer list of equivalents changes no other choice
        pools[room] = [m for m in found if reason_for(m) is None]
    pools = {room: pool for room, pool in pools.items() if pool}
    if not pools:
        raise ValueError(f"no file that is mutated has {given.module!r} in its path; see mutation/rooms.py")
    return {room: pools[room][:size] for room, size in _shares(pools, given.sample).items()}


def _shares(pools: Mapping[str, Sequence[Mutation]], sample: int) -> dict[str, int]:
    """How many mutants of every room: by the root of its size, and never more than there are."""
    shares = dict.fromkeys(pools, 0)
    for _ in range(min(sample, sum(map(len, pools.values())))):
        open_rooms = [room for room in pools if shares[room] < len(pools[room])]
        shares[min(open_rooms, key=lambda room: (shares[room] + 0.5) / len(pools[room]) ** 0.5)] += 1
    return shares


def _try_all(
    rooms: Mapping[str, Sequence[Mutation]], reach: Reach, copies: list[Copy], kept: Results, given: argparse.Namespace
) -> dict[Mutation, Result]:
    """What became of every mutant; rooms in turn, so that a stopped run has seen all of them."""
    turns = [((i + 0.5) / len(found), room, m) for room, found in rooms.items() for i, m in enumerate(found)]
    order = [m for _, _, m in sorted(turns, key=lambda turn: turn[:2])]
    results = {m: found for m in order if (found := kept.get(m)) is not None}
    killers: dict[str, Counter[str]] = {m.file: Counter() for m in order}

    def take(mutation: Mutation, result: Result) -> None:
        results[mutation] = result
        killers[mutation.file][result.by] += bool(result.by)

    for mutation, result in list(results.items()):
        take(mutation, result)

    def trials() -> Iterator[Task[Trial]]:
        for mutation in order:
            if mutation in results:
                continue
            tests = covering(mutation, reach, copies[0].folder)
            if not tests:
                take(mutation, Result("not covered"))
                continue
            source = (copies[0].folder / mutation.file).read_bytes()
            trial = plan(mutation, mutation.apply(source), tests, killers[mutation.file], given.budget, given.grace)
            prepared = lambda copy, trial: copy.changed(trial.mutation.file, trial.source)  # noqa: E731
            yield Task(trial, try_out, prepared, HANGING * trial.seconds + AT_LEAST)

    with tqdm(total=len(order), initial=len(results), desc="mutants", unit="mutant") as bar:
        for trial, end in run_forked(trials(), copies):
            how = end.how if end.how != "done" else "survived" if end.value is None else "killed"
            take(trial.mutation, Result(how, end.value or ""))
            kept.put(trial.mutation, results[trial.mutation])
            if not results[trial.mutation].noticed:
                tqdm.write(f"{how}: {trial.mutation}", file=sys.stderr)
            bar.update(len(results) - bar.n)
            bar.set_postfix(left=sum(not r.noticed for r in results.values()))
        bar.update(len(results) - bar.n)
    return results


if __name__ == "__main__":
    run(main)
