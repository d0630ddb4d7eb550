"""Every result has a picture that shows what it holds, and every motion a page that stands alone."""

from __future__ import annotations

import ast
import base64
import json
import re
import shutil
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pisplit as ps
from pisplit import observables as ob
from pisplit.controllers import MPC, ClosedLoop
from pisplit.controllers.plants import ModelPlant
from pisplit.models import systems
from pisplit.models.arm import equilibrium_table
from pisplit.models.calibration import calibrate_from_shapes
from pisplit.models.rod.dynamics.trajectory import Trajectory
from pisplit.pictures import Chart, Outline, Page

pytestmark = pytest.mark.filterwarnings("ignore")
ROOT = Path(__file__).resolve().parent.parent
ROOMS = ("pisplit", "models", "controllers")
FACES = (
    *("pisplit/__init__.py", "pisplit/front/__init__.py", "controllers/__init__.py", "controllers/plants/__init__.py"),
    *("controllers/references/__init__.py", "models/__init__.py", "models/rod/__init__.py", "models/arm/__init__.py"),
    *("models/calibration/__init__.py", "models/systems.py", "pisplit/observables/__init__.py"),
)
#: What is returned and needs no picture of its own, and why.
WITHOUT = {
    "one step, or a state to go on from": (
        *("PlantStep", "Move", "Step", "Snapshot", "LoopState", "MPCState", "WrappedState", "ActuatorState"),
        *("StepSensitivity", "DiscreteLinearisation", "Start"),
    ),
    "recordings and samples, which are data and not results": ("Episodes", "Pairs", "PhaseSamples", "InputDirections"),
    "parts of an equation, of a dictionary or of a program": (
        *("Balance", "Motion", "BaseState", "Loads", "Pull", "Profile", "StrainSet", "StrainCoordinates", "Columns"),
        *(
            "StateMap",
            "Principal",
            "Radial",
            "Tension",
            "Slip",
            "Input",
            "Tendons",
            "Chambers",
            "PointMass",
            "Regression",
            "Condensed",
            "HeldTip",
            "Layout",
            "Maxwell",
            "Base",
        ),
    ),
    "numbers and matrices at one point": (
        *("Stability", "PoseSensitivity", "Verdict", "Judge", "TendonParameters", "ActuatorChoice"),
    ),
    "drawn by what holds it: an account, an identification, a page": ("Energies", "Report", "Outline", "NewModel"),
    "files": ("Exported",),
    "an instrument that is told or found": ("Actuator", "MotionCapture"),
    "a robot, drawn as its arm": ("DiskRobot",),
}

#: What solvers are made of: what these return is nobody's result.
INNER = ("Branches", "Search", "Whitened", "Certificate", "FixedTip", "Balance", "Propagation", "Collocation")


@cache
def definitions() -> tuple[dict[str, list[ast.ClassDef]], dict[str, list[ast.FunctionDef]]]:
    """Classes and functions of the package by name."""
    classes: dict[str, list[ast.ClassDef]] = {}
    functions: dict[str, list[ast.FunctionDef]] = {}
    for room in ROOMS:
        for path in sorted((ROOT / room).rglob("*.py")):
            for node in ast.parse(path.read_text()).body:
                if isinstance(node, ast.ClassDef):
                    classes.setdefault(node.name, []).append(node)
                elif isinstance(node, ast.FunctionDef):
                    functions.setdefault(node.name, []).append(node)
    return classes, functions


def family(name: str) -> list[ast.ClassDef]:
    classes = definitions()[0]
    above = [ast.unparse(b).split("[")[0].split(".")[-1] for one in classes[name] for b in one.bases]
    return [*classes[name], *(one for b in above if b in classes and b != name for one in family(b))]


def methods(name: str) -> list[ast.FunctionDef]:
    return [m for one in family(name) for m in one.body if isinstance(m, ast.FunctionDef)]


def returned() -> set[str]:
    """Dataclasses that public functions and methods return, also those of what they return."""
    classes, functions = definitions()
    todo: list[str] = []
    for face in FACES:
        tree = ast.parse((ROOT / face).read_text())
        listed = [n for n in tree.body if isinstance(n, ast.Assign) and ast.unparse(n.targets[0]) == "__all__"]
        todo += ast.literal_eval(listed[0].value) if listed else [n.name for n in tree.body if hasattr(n, "name")]
    found, seen = set(), set()
    while todo:
        name = todo.pop()
        if name in seen or name in INNER:
            continue
        seen.add(name)
        own = [m for m in methods(name) if not m.name.startswith("_")] if name in classes else []
        for function in [*own, *functions.get(name, [])]:
            words = re.findall(r"\w+", ast.unparse(function.returns)) if function.returns else []
            known = [w for w in words if w in classes]
            todo += known
            found |= {
                w for w in known if any("dataclass" in ast.unparse(d) for c in classes[w] for d in c.decorator_list)
            }
    return found


def test_every_result_has_a_picture() -> None:
    excused = [name for names in WITHOUT.values() for name in names]
    results = returned()
    assert {"Trajectory", "Modes", "LoopLog", "Identified", "Calibration", "RolloutErrors"} <= results
    missing = {n for n in results - set(excused) if not any(m.name == "plot" for m in methods(n))}
    assert not missing, f"without plot(): {sorted(missing)}"
    assert len(excused) == len(set(excused)) and set(excused) <= set(definitions()[0])


class Made:
    """One of every result, made when it is asked for."""

    arm = ps.TendonArm(length=0.45, radius=0.7e-3, material="steel", offset=0.01, angles_deg=(0, 120, 240), nodes=3)
    scene = arm.scene
    pull = arm.rest_inputs + np.array([0.004, -0.002, -0.002])

    def __init__(self) -> None:
        self.kept: dict[str, Any] = {}

    def __getattr__(self, name: str) -> Any:
        make: Callable[[], Any] = getattr(type(self), f"make_{name}")
        return self.kept.setdefault(name, None) or self.kept.__setitem__(name, make(self)) or self.kept[name]

    def make_motion(self) -> Trajectory:
        return self.scene.simulator(0.02).run(np.tile(self.pull, (12, 1)), energy=True, check=False)

    def make_data(self) -> tuple[ps.Episodes, ps.Episodes]:
        spring = systems.duffing(stiffness=1.0)
        draws = [np.random.default_rng(k) for k in range(8)]
        runs = [np.repeat(g.uniform(-1, 1, (20, 1)), 6, axis=0) for g in draws]
        every = ps.Episodes.from_system(spring, np.array([g.uniform(-1, 1, 2) for g in draws]), runs, 0.05)
        return every[:6], every[6:]

    def make_theta(self) -> ps.Dictionary:
        return ps.Dictionary(ob.Constant(), ob.Identity(), ob.Polynomials(3), n_states=2, n_inputs=1)

    def make_model(self) -> ps.LinearEDMDc:
        return ps.LinearEDMDc(self.theta, alpha=1e-6).fit(self.data[0])

    def make_samples(self) -> ps.PhaseSamples:
        x = np.random.default_rng(0).uniform(-1, 1, (200, 2))
        return ps.PhaseSamples.from_system(systems.duffing(), x, np.zeros((200, 1)), dt=0.05)

    def make_found(self) -> ps.Identified:
        return ps.identify(self.data[0], candidates=["L-EDMDc", "L-EDMDc, cubic"], progress=False)

    def make_linear(self) -> ps.LinearEDMDc:
        theta = ps.Dictionary(ob.Constant(), ob.Identity(), n_states=2, n_inputs=1)
        return ps.LinearEDMDc(theta, alpha=1e-6).fit(self.data[0])

    def make_log(self) -> Any:
        model, test = self.linear.lifted, self.data[1]
        mpc = MPC(model, 10, -1.0, 1.0, 0.5, track=["x"])
        wanted = ps.references.setpoint([[0.5]], [0.5], track="")
        return ClosedLoop(ModelPlant(model, test.xs[0][0]), mpc).run(wanted, 60, progress=False)

    def results(self) -> dict[str, Any]:
        d1, test = self.data
        curve = {"cubic": ps.LinearEDMDc(self.theta, alpha=1e-6)}
        start = test.start(0, 0)
        statics = self.scene.statics()
        at_rest = statics.solve(self.pull)
        return {
            "RolloutErrors": self.model.score(test),
            "HorizonErrors": ps.horizon_errors(self.model, test, [1, 3, 10, 30]),
            "PredictedError": ps.predicted_error(self.model, test),
            "Comparison": ps.compare({"cubic": self.model, "again": self.model}, test, horizons=[1, 10]),
            "LearningCurve": ps.learning_curve(curve, d1, test, sizes=[16, 64], seeds=range(2)),
            "Rollout": self.model.lifted.predict(start.x_history, start.u_history, start.inputs),
            "LiftedModel": self.model.lifted,
            "Modes": ps.modes(self.model.lifted),
            "Reduction": ps.balanced_truncation(self.model.lifted, 6),
            "ModelSpectrum": ps.model_spectrum(self.model, test),
            "Spectrum": ps.generator_spectrum(self.theta, self.samples, np.ones(self.theta.n_columns)),
            "HalfStep": ps.half_step(self.theta, self.samples, 0.05, np.ones(self.theta.n_columns)),
            "FoundActuator": ps.find_actuator(d1[:2], [0.0, 0.05], [0.0]),
            "Identified": self.found,
            "Control": self.found.mpc(u_max=1.0, du_max=0.5),
            "LoopLog": self.log,
            "Reference": ps.references.circle(0.1, 4.0),
            "Trajectory": self.motion,
            "EnergyAccount": self.motion.energy(),
            "MotionError": self.scene.simulator(0.02).run(np.tile(self.pull, (12, 1)), check="whole").error,
            "Equilibrium": at_rest,
            "EquilibriumBatch": statics.solve_many(np.linspace(0.2, 1.0, 5)[:, None] * self.pull),
            "InverseSolution": statics.inverse([at_rest.tip[0], at_rest.tip[1], np.nan], start=self.pull),
            "FixedTipEquilibrium": statics.pin_tip(0.98 * at_rest.tip, self.pull),
            "NaturalModes": self.scene.modes(at_rest.state),
            "Linearisation": self.scene.linearise(at_rest.state),
            "Cost": self.scene.cost(),
            "TendonArm": self.arm,
            "RestShapes": self.arm.rest_shapes(5),
            "EquilibriumTable": equilibrium_table(self.arm, 0.004, points=9),
            "Calibration": self.calibration,
        }

    def make_calibration(self) -> Any:
        shapes = self.arm.rest_shapes(4)
        return calibrate_from_shapes(self.arm, shapes.inputs, shapes.fields)


@pytest.fixture(scope="module")
def made() -> Made:
    return Made()


def test_every_picture_is_drawn_and_shows_data(made: Made, tmp_path: Path) -> None:
    found = made.results()
    assert set(found) <= {n for n in returned() if any(m.name == "plot" for m in methods(n))}
    for name, result in found.items():
        written = name in ("Modes", "Trajectory", "LoopLog", "Rollout")
        figure = result.plot(tmp_path / f"{name}.png") if written else result.plot()
        for axis in figure.axes:
            assert axis.lines or axis.collections or axis.patches or axis.images, f"{name}: an empty panel"
        assert not written or (tmp_path / f"{name}.png").stat().st_size > 8_000, name


def test_no_result_floods_a_prompt(made: Made) -> None:
    """Arrays are told by their shapes; recordings of any length take a line."""
    d1, _ = made.data
    for name, result in {**made.results(), "Episodes": d1, "PhaseSamples": made.samples, "Report": d1.report()}.items():
        assert len(repr(result)) < 1000, f"{name}: {len(repr(result))} letters"
    assert repr(d1) == "Episodes(6 of 120 steps of 0.05 s, 2 states: x, v, 1 input: u1)"
    assert "x=13 x " in repr(made.motion)


def test_a_picture_of_errors_shows_these_errors(made: Made) -> None:
    errors = made.model.score(made.data[1])
    (axis,) = errors.plot().axes
    np.testing.assert_array_equal(axis.lines[0].get_ydata(), errors.squared[0])
    modes = ps.modes(made.model.lifted)
    points = np.concatenate([np.stack(line.get_data()).T for line in modes.plot().axes[0].lines[1:]])
    assert sorted(np.hypot(*points.T)) == pytest.approx(sorted(np.abs(modes.eigenvalues)))


def read(page: Path) -> dict[str, Any]:
    """What a page holds, its lines in m."""
    text = page.read_text()
    assert page.stat().st_size < 5e6 and "http" not in text and "<link" not in text and "src=" not in text
    data = json.loads(text.split("const D = ")[1].split(";\n")[0])
    for packed in [*data["lines"], *([data["reference"]] if data["reference"] else [])]:
        grid = np.frombuffer(base64.b64decode(packed["data"]), "<u2").reshape(len(data["t"]), packed["points"], 3)
        points = data["low"] + data["step"] * grid
        packed["points"] = np.where(grid == 65535, np.nan, points)
    return data


def test_the_page_of_a_motion_shows_its_shapes_and_tensions(made: Made, tmp_path: Path) -> None:
    motion = made.motion
    motion.save(tmp_path / "run.html", ghost=motion)
    data = read(tmp_path / "run.html")
    backbone, *tendons, ghost = (line["points"] for line in data["lines"])
    assert len(tendons) == 3 and data["ghost"] and data["up"] == pytest.approx([0.0, 0.0, -1.0])
    np.testing.assert_allclose(backbone[:, -1], motion.fields(1)[:, 0, :3], atol=1e-5)
    np.testing.assert_allclose(ghost, backbone, atol=2e-5)
    for line in tendons:
        np.testing.assert_allclose(np.linalg.norm(line - backbone, axis=2), 0.01, atol=2e-5)
    last = made.scene.statics().solve(made.pull).tensions  # it has come to rest, nearly
    np.testing.assert_allclose(data["tensions"][-1], last, rtol=0.1)
    with pytest.raises(ValueError, match="over the same times"):
        motion.save(
            tmp_path / "run.html", ghost=made.scene.simulator(0.02).run(np.tile(made.pull, (3, 1)), check=False)
        )
    with pytest.raises(ValueError, match="expected a page"):
        motion.save(tmp_path / "run.png")


def test_the_page_of_a_loop_holds_the_ghost_of_its_model(made: Made, tmp_path: Path) -> None:
    """The model is the plant: what it predicted ten steps before is what came."""
    log = made.log.beside(made.linear, 10)
    np.testing.assert_allclose(log.ghost[10:], log.x[10:], atol=1e-9)
    assert np.isnan(log.ghost[:10]).all()
    log.save(tmp_path / "loop.h5")
    assert type(log).load(tmp_path / "loop.h5").ghost is None  # made for the page alone
    log.save(tmp_path / "loop.html")
    data = read(tmp_path / "loop.html")
    assert data["lines"] == [] and len(data["charts"]) == 2
    with pytest.raises(ValueError, match="other states"):
        log.beside(ps.LinearEDMDc(made.theta, alpha=1e-6).fit(ps.Episodes(made.data[0].xs, made.data[0].us, 0.05)))


def test_an_arm_is_recognised_in_its_measured_fields(made: Made) -> None:
    motion = made.motion
    told = made.arm.outline(motion.fields(6).reshape(13, -1), motion.x[:, -3:])
    known = made.scene.statics().scene
    from pisplit.models.rod.output.outline import outline_of

    direct = outline_of(known, motion.x)
    np.testing.assert_allclose(told.backbone, direct.backbone, atol=1e-9)
    np.testing.assert_allclose(told.tensions, direct.tensions, atol=1e-6)
    fields = motion.fields(6).reshape(13, -1)
    fields[4, 7] = np.nan
    gap = made.arm.outline(fields, motion.x[:, -3:])
    assert np.isnan(gap.backbone[4]).all() and np.isfinite(gap.backbone[5]).all()


def test_long_motions_are_thinned_and_say_so(tmp_path: Path) -> None:
    t = np.arange(9000.0)
    arm = Outline(np.random.default_rng(0).normal(size=(9000, 60, 3)))
    Page("long", t, [Chart("a", ("b",), t)], "text", arm).write(tmp_path / "long.html")
    data = read(tmp_path / "long.html")
    assert len(data["t"]) <= 1500 and "every 6. moment" in data["summary"]
    np.testing.assert_allclose(data["lines"][0]["points"], arm.backbone[::6], atol=2e-4)
    with pytest.raises(ValueError, match=r"tensions have the shape \(0, 0\); expected \(9000, 1\)"):
        Outline(arm.backbone, (arm.backbone,))


def test_a_browser_draws_the_page(made: Made, tmp_path: Path) -> None:
    browser = shutil.which("chromium") or shutil.which("chromium-browser")
    if browser is None:
        pytest.skip("needs chromium (apt install chromium)")
    made.motion.save(tmp_path / "run.html")
    command = [
        browser,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--dump-dom",
        f"file://{tmp_path}/run.html#step=7",
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert 'data-step="7"' in done.stdout and "0.14 s</output>" in done.stdout
