"""The command line: ``pisplit record``, ``identify``, ``report``, ``track``, ``export``, ``bench``, ``demo``.

Exit codes: 0 done, 1 the data or files do not allow it (said in one line), 2 wrong arguments, 3 a loop that stopped.
Shells complete commands, options and files where argcomplete is installed (``pip install pisplit[completion]``) and
told of them: ``eval "$(register-python-argcomplete pisplit)"``.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pisplit import Episodes, LiftedModel, TendonArm, __version__, identify, references, to_c_header
from pisplit.front.report import Report
from pisplit.front.words import add_words, of_tables

ARMS = {"paper": TendonArm.paper, "prototype": TendonArm.prototype}
FAILED, STOPPED = 1, 3
CODES = "exit codes: 0 done, 1 data or files do not allow it (one line says why), 2 wrong arguments, 3 a loop stopped"
#: Files that a run is written to.
PLACES = (".png", ".html", ".h5")


class _Help(argparse.ArgumentDefaultsHelpFormatter):
    """Help that tells defaults, where there are any."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        if action.default is None or action.default is False or action.default == [] or action.required:
            return action.help
        return super()._get_help_string(action)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command of ``argv`` (the process's own arguments if not given); its exit code."""
    made = parser()
    _complete(made)
    given = made.parse_args(argv)
    try:
        facts, code = given.run(given)
        if given.json:
            print(json.dumps(facts, indent=1, allow_nan=False), flush=True)
    except BrokenPipeError:  # whoever read the output has had enough, as head has
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except (ValueError, OSError, RuntimeError) as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return FAILED
    return int(code)


def _complete(made: argparse.ArgumentParser) -> None:
    """Answer a shell that asks how a line goes on, and leave; nothing where none asks."""
    if "_ARGCOMPLETE" not in os.environ:
        return
    try:
        completion: Any = importlib.import_module("argcomplete")
    except ImportError:
        return
    completion.autocomplete(made)


def parser() -> argparse.ArgumentParser:
    """The commands and their arguments."""
    made = argparse.ArgumentParser(
        prog="pisplit",
        description="models of soft arms from little data, and MPC on them",
        epilog=f"'pisplit COMMAND --help' tells the options of a command; every one takes --json; {CODES}",
    )
    made.add_argument("--version", action="version", version=f"pisplit {__version__}")
    commands = made.add_subparsers(required=True, metavar="command")

    def command(name: str, run: Any, text: str) -> argparse.ArgumentParser:
        one = commands.add_parser(name, help=text, description=text, epilog=CODES, formatter_class=_Help)
        one.add_argument("--json", action="store_true", help="print facts as JSON on standard output, and nothing else")
        one.set_defaults(run=run)
        return one

    record = command("record", _record, "recordings of a simulated arm")
    record.add_argument("--episodes", type=int, default=10, help="recordings")
    record.add_argument("--steps", type=int, default=200, help="of each recording")
    record.add_argument("--seed", type=int, default=0, help="of the random commands")
    record.add_argument("--out", type=Path, required=True, metavar="PATH", help="HDF5 file to write")
    fit = command("identify", _identify, "the best model that recordings allow, with a report")
    fit.add_argument("files", nargs="+", type=Path, help="recordings: one HDF5 file, CSV files, or one MATLAB file")
    add_words(fit)
    fit.add_argument("--candidates", nargs="+", help="models to try; all that the data allow if not given")
    fit.add_argument("--out", type=Path, required=True, metavar="PATH", help="HDF5 file of the model and its report")
    report = command("report", _report, "the report that a model was saved with")
    report.add_argument("model", type=Path, help="file that pisplit identify wrote")
    track = command("track", _track, "model predictive control of a simulated arm along a circle")
    track.add_argument("model", type=Path, help="file that pisplit identify wrote")
    track.add_argument("--reference", choices=["circle"], default="circle", help="what the tip follows")
    track.add_argument("--radius", type=float, default=0.1, help="of the circle in m")
    track.add_argument("--period", type=float, default=4.0, help="of a round in s")
    track.add_argument("--steps", type=int, default=400, help="of the loop")
    track.add_argument("--u-max", type=float, default=0.016, help="largest input, in its SI unit")
    track.add_argument("--du-max", type=float, default=0.002, help="largest change of an input in a step")
    track.add_argument("--rate-weight", type=float, default=0.1, help="weight of changes of inputs")
    track.add_argument(
        "--out", type=Path, nargs="+", default=[], metavar="PATH", help=".png, .html or .h5 files of the run"
    )
    export = command("export", _export, "a model as a C header")
    export.add_argument("model", type=Path, help="file that pisplit identify wrote")
    export.add_argument("--c", type=Path, required=True, metavar="PATH", help="header to write")
    demo = command("demo", _demo, "the five lines of the README: record, identify, track; pictures and a page")
    demo.add_argument("--quick", action="store_true", help="fewer recordings and models")
    demo.add_argument("--out", type=Path, default=Path("out/five-lines"), help="folder of the pictures")
    timed = command("bench", _bench, "times beside errors on this machine, in a minute: statics, motion, a fit, MPC")
    timed.add_argument("--steps", type=int, default=60, help="of each motion and loop")
    timed.add_argument("--seed", type=int, default=0, help="of the random commands")
    for one in (record, fit, track, demo):
        one.add_argument("--arm", choices=ARMS, default=None if one is fit else "paper", help="a simulated arm")
    return made


def _say(given: argparse.Namespace, text: object) -> None:
    if not given.json:
        print(text)


def _record(given: argparse.Namespace) -> tuple[dict[str, Any], int]:
    arm = ARMS[given.arm]()
    d1 = arm.record(given.episodes, given.seed, given.steps, path=given.out, progress=not given.json)
    _say(given, f"{len(d1)} recordings of {given.steps} steps of {d1.dt:g} s in {given.out}")
    return {"out": str(given.out), "episodes": len(d1), "steps": given.steps, "dt": d1.dt}, 0


def _identify(given: argparse.Namespace) -> tuple[dict[str, Any], int]:
    arm = None if given.arm is None else ARMS[given.arm]()
    found = identify(_recordings(given), arm=arm, candidates=given.candidates, progress=not given.json)
    found.save(given.out)
    _say(given, f"{found.report()}\n\nmodel in {given.out}")
    return {"out": str(given.out), **found.report().as_dict()}, 0


def _recordings(given: argparse.Namespace) -> Episodes:
    if len(given.files) == 1 and given.files[0].suffix in (".h5", ".hdf5"):
        return Episodes.load(given.files[0])
    return of_tables(given)


def _report(given: argparse.Namespace) -> tuple[dict[str, Any], int]:
    facts = LiftedModel.load(given.model).provenance.get("report")
    if facts is None:
        raise ValueError(f"{given.model} was saved without a report; pisplit identify makes one")
    _say(given, Report.of_dict(facts))
    return dict(facts), 0


def _track(given: argparse.Namespace) -> tuple[dict[str, Any], int]:
    from pisplit.controllers import MPC, ClosedLoop

    _check_places(given.out)
    arm, model = ARMS[given.arm](), LiftedModel.load(given.model)
    plant = arm.scene.fast_stepper(dt=model.dt, stations=max(1, model.n_states // 24))
    if (tuple(model.state_names), tuple(model.input_names)) != (tuple(plant.state_names), tuple(plant.input_names)):
        raise ValueError(
            f"{given.model} is a model of {_few(model.state_names)} and inputs {_few(model.input_names)}; track runs "
            f"models of the simulated arm ({_few(plant.state_names)}; {_few(plant.input_names)}): for a plant of your "
            "own, LiftedModel.load it in Python (docs/control.md)"
        )
    low = 2.0 * arm.pretension - given.u_max
    mpc = MPC(model, 20, low, given.u_max, given.du_max, rate_weight=given.rate_weight)
    reference = references.circle(given.radius, given.period)
    log = ClosedLoop(plant, mpc).run(reference, given.steps, u0=arm.rest_inputs, progress=not given.json)
    return _told(given, log, given.period / 2, given.out)


def _few(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def _check_places(places: Sequence[Path]) -> None:
    """Refuse files of a run that are no pictures, pages or logs, before anything is run."""
    for place in places:
        if place.suffix not in PLACES:
            raise ValueError(f"--out {place}; expected {', '.join(PLACES)}: a picture, a page, the log")


def _told(given: argparse.Namespace, log: Any, after: float, places: Sequence[Path]) -> tuple[dict[str, Any], int]:
    for place in places:
        place.parent.mkdir(parents=True, exist_ok=True)
        (log.plot if place.suffix == ".png" else log.save)(place)
    error = log.rms_error(after=after)
    _say(given, log.summary())
    shown = f"{1e3 * error:.3g} mm" if error == error else "the run ends before; give more --steps"
    _say(given, f"RMS error from {after:g} s on: {shown}")
    facts = {
        "rms_error": error if error == error else None,
        "after": after,
        "steps": len(log.u),
        "stopped": log.message,
        "out": [str(p) for p in places],
    }
    return facts, STOPPED if log.stopped else 0


def _export(given: argparse.Namespace) -> tuple[dict[str, Any], int]:
    model = LiftedModel.load(given.model)
    to_c_header(model, given.c)
    _say(given, f"{model.n_lifted} lifted states, {model.n_inputs} inputs in {given.c}")
    return {"out": str(given.c), "n_lifted": model.n_lifted, "n_inputs": model.n_inputs}, 0


def _bench(given: argparse.Namespace) -> tuple[dict[str, Any], int]:
    import os
    import platform

    from pisplit.front.bench import bench

    found = bench(given.steps, given.seed)
    _say(given, "\n".join(map(str, found)))
    machine = {"processor": platform.machine(), "cores": os.cpu_count(), "python": platform.python_version()}
    return {"pisplit": __version__, "machine": machine, "measured": [m.as_dict() for m in found]}, 0


def _demo(given: argparse.Namespace) -> tuple[dict[str, Any], int]:
    arm, show = ARMS[given.arm](), not given.json
    few = ["L-EDMDc", "B-EDMDc", "PI-EDMDc, hold"] if given.quick else None
    d1 = arm.record(4 if given.quick else 10, progress=show)
    model = identify(d1, arm=arm, candidates=few, progress=show)
    _say(given, model.report())
    mpc = model.mpc(u_max=0.016, du_max=0.002)
    log = mpc.run(arm, references.circle(radius=0.1, period=4.0), 200 if given.quick else 400, progress=show)
    given.out.mkdir(parents=True, exist_ok=True)
    model.plot(given.out / "model.png")
    _say(given, f"pictures and page in {given.out}: model.png, run.png, run.html, run.h5")
    return _told(given, log, 2.0, [given.out / name for name in ("run.png", "run.html", "run.h5")])


if __name__ == "__main__":
    sys.exit(main())
