"""Machine code of a scene gives the numbers of the virtual machine, from a cache that survives crowds and damage."""

import logging
import multiprocessing
import pickle
import shutil
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pisplit.models import rod
from pisplit.models.arm import TendonArm, make_episodes, make_phase_samples
from pisplit.models.rod.output import compiled, paying, processor

STEEL = rod.Elastic(207e9, 207e9 / 2.6, 8000.0)
PULLS = 0.004 * np.array([[1.0, -1.0], [-1.0, 1.0], [0.5, 0.0]])

needs_compiler = pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="no C compiler on the PATH: nothing to compile with"
)


def arm(strains: str = "planar", nodes: int = 3) -> rod.Scene:
    """A rod with everything that the solvers meet: gravity, damping, drag and two tendons."""
    return rod.Scene(
        rod.Rod(0.5, rod.Circle(1e-3), STEEL, strains),
        rod.Gravity((-9.81, 0.0, 0.0)),
        rod.KelvinVoigt(bending=5e-4, torsion=5e-4),
        rod.QuadraticDrag(1e-3),
        rod.Tendons([[0.015, 0.0], [-0.015, 0.0]], rod.Displacement(1e-4)),
        nodes=nodes,
    )


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache of machine code for one test."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "pisplit"


def libraries(cache: Path) -> list[Path]:
    return sorted(cache.glob("*.so"))


@needs_compiler
@pytest.mark.parametrize("strains", ["planar", "kirchhoff"])
def test_machine_code_gives_the_numbers_of_the_virtual_machine(strains: str, cache: Path) -> None:
    interpreted = arm(strains, nodes=2)
    machine = interpreted.compile(stations=2)
    assert machine.machine_code and len(libraries(cache)) == 3
    equilibria = [s.statics().solve(PULLS[0]) for s in (interpreted, machine)]
    assert equilibria[0].success and equilibria[1].success
    assert np.allclose(equilibria[0].state, equilibria[1].state, rtol=1e-10, atol=1e-10)
    runs = [s.simulator(0.03, stations=2).run(PULLS, equilibria[0].state, check=False) for s in (interpreted, machine)]
    assert runs[0].success and runs[1].success
    assert np.allclose(runs[0].x, runs[1].x, rtol=1e-10, atol=1e-10 * np.abs(runs[0].x).max())
    fields = [s.fields(runs[0].x, stations=2) for s in (interpreted, machine)]
    assert np.allclose(fields[0], fields[1], rtol=1e-10, atol=1e-10)


@needs_compiler
def test_residual_and_jacobian_agree_at_random_states(cache: Path) -> None:
    scene = arm("kirchhoff", nodes=2)
    given = scene.motion_residual
    (built,) = compiled.compiled_functions([given])
    assert built is not given
    rng = np.random.default_rng(0)
    for size in (1e-3, 1.0, 30.0):
        point = [size * rng.standard_normal(given.size1_in(i)) for i in range(3)] + [PULLS[0]]
        assert np.allclose(np.asarray(built(*point)), np.asarray(given(*point)), rtol=1e-10, atol=1e-10)
        blocks = [f.jacobian()(*point, np.zeros(scene.n_strains)) for f in (built, given)]
        for mine, theirs in zip(*blocks, strict=True):
            assert np.allclose(np.asarray(mine.full()), np.asarray(theirs.full()), rtol=1e-10, atol=1e-10)


@needs_compiler
def test_a_second_scene_with_the_same_content_builds_nothing(cache: Path) -> None:
    arm().compile(stations=1)
    before = {path: path.stat().st_mtime_ns for path in libraries(cache)}
    twin = arm().compile(stations=1)
    assert twin.machine_code
    assert {path: path.stat().st_mtime_ns for path in libraries(cache)} == before
    (arm() - rod.QuadraticDrag(1e-3)).compile(stations=1)
    assert len(libraries(cache)) > len(before)


@needs_compiler
@pytest.mark.parametrize("damage", ["truncated", "empty", "not a library"])
def test_a_broken_library_is_built_again(damage: str, cache: Path) -> None:
    scene = arm(nodes=2)
    compiled.compiled_functions([scene.motion_residual])
    (path,) = libraries(cache)
    content = path.read_bytes()
    path.unlink()  # the process may still have it in memory: damage a new file, not the mapped one
    path.write_bytes({"truncated": content[: len(content) // 2], "empty": b"", "not a library": b"x" * 5000}[damage])
    (built,) = compiled.compiled_functions([scene.motion_residual])
    assert built is not scene.motion_residual
    assert path.read_bytes() == content


def build_at(moment: float) -> tuple[bool, float]:
    """Compile the arm at a moment shared by all processes; whether it is machine code, and its answer."""
    while time.time() < moment:
        time.sleep(1e-3)
    machine = arm().compile(stations=1)
    return machine.machine_code, float(machine.statics().solve(PULLS[0]).tip[0])


@needs_compiler
def test_processes_that_compile_at_once_do_not_clash(cache: Path) -> None:
    context = multiprocessing.get_context("fork")
    with context.Pool(3) as pool:
        found = pool.map(build_at, [time.time() + 0.3] * 3, chunksize=1)
    assert {built for built, _ in found} == {True}
    assert len({tip for _, tip in found}) == 1
    assert len(libraries(cache)) == 3 and not list(cache.glob("build-*"))


def test_without_a_compiler_the_virtual_machine_serves(
    cache: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    with caplog.at_level(logging.WARNING):
        machine = arm().compile(stations=1)
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    assert "no C compiler" in caplog.text
    assert not machine.machine_code and not libraries(cache)
    assert np.array_equal(machine.statics().solve(PULLS[0]).state, arm().statics().solve(PULLS[0]).state)


def test_a_compiler_that_fails_is_told_in_one_line(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    broken = tmp_path / "cc"
    broken.write_text("#!/bin/sh\necho 'no space left' >&2\nexit 3\n")
    broken.chmod(0o755)
    monkeypatch.setenv("CC", str(broken))
    machine = arm(nodes=2).compile(stations=1)
    assert not machine.machine_code
    assert len(caplog.records) == 1 and "status 3: no space left" in caplog.text
    assert not list(cache.iterdir())


def test_a_cache_folder_that_cannot_be_made_is_told_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "pisplit").write_text("a file where the folder should be")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert not arm(nodes=2).compile(stations=1).machine_code
    assert len(caplog.records) == 1


@needs_compiler
def test_compiled_scenes_travel_between_processes(cache: Path) -> None:
    machine = arm(nodes=2).compile(stations=1)
    copy = pickle.loads(pickle.dumps(machine))
    assert copy == machine and copy != arm(nodes=2) and isinstance(copy, compiled.CompiledScene)
    before = {path: path.stat().st_mtime_ns for path in libraries(cache)}
    assert copy.statics().solve(PULLS[0]).success and copy.machine_code
    assert {path: path.stat().st_mtime_ns for path in libraries(cache)} == before


@needs_compiler
def test_undamped_rods_move_by_machine_code_too(cache: Path) -> None:
    scene = arm("kirchhoff", nodes=2).without(rod.KelvinVoigt)
    twin = scene.compile(stations=1).variational()
    assert isinstance(twin, compiled.CompiledScene)
    runs = [s.simulator(0.03).run(PULLS[:1], np.zeros(s.n_states), check=False) for s in (scene, twin)]
    assert twin.machine_code and np.allclose(runs[0].x, runs[1].x, rtol=1e-10, atol=1e-10)


@needs_compiler
def test_scenes_that_differ_in_the_last_bit_share_no_machine_code(cache: Path) -> None:
    """And a byte that flips anywhere in a library is noticed before it is loaded."""
    last = float(np.nextafter(0.015, 1.0))
    tendons = [rod.Tendons([[x, 0.0], [-0.015, 0.0]], rod.Displacement(1e-4)) for x in (0.015, last)]
    functions = [arm(nodes=2).replace(t).statics().residual_function for t in tendons]
    compiled.compiled_functions(functions[:1])
    (first,) = libraries(cache)
    compiled.compiled_functions(functions)
    assert len(libraries(cache)) == 2
    content = bytearray(first.read_bytes())
    assert compiled._intact(first)
    damaged = first.with_name("damaged.so")
    for place in (0, len(content) // 3, len(content) // 2, len(content) - 40, len(content) - 1):
        content[place] ^= 1
        damaged.write_bytes(content)
        assert not compiled._intact(damaged)
        content[place] ^= 1


@needs_compiler
def test_a_plant_of_machine_code_goes_on_elsewhere_to_the_last_bit(cache: Path) -> None:
    plant = arm(nodes=2).compile(stations=1).simulator(0.03, stations=1)
    plant.reset()
    plant.step(PULLS[0])
    mark, twin = plant.snapshot(), pickle.loads(pickle.dumps(plant))
    measured = plant.step(PULLS[1]).state
    assert isinstance(twin.scene, compiled.CompiledScene) and np.array_equal(twin.step(PULLS[1]).state, measured)
    plant.restore(mark)
    assert np.array_equal(plant.step(PULLS[1]).state, measured)


@needs_compiler
def test_machine_code_and_threads_change_no_bit(cache: Path, tmp_path: Path) -> None:
    scene = arm(nodes=3)
    rows = 0.004 * np.random.default_rng(0).uniform(-1.0, 1.0, (150, 2))
    usual = scene.statics().solve_many(rows, chunk=32, compiled=False)
    for threads in (1, 2):
        found = scene.statics().solve_many(rows, chunk=32, threads=threads, compiled=True)
        assert found.states.tobytes() == usual.states.tobytes() and found.scene is scene
    assert len(libraries(cache)) == 1
    small = {"episodes": 1, "steps": 5, "stations": 1, "workers": 1, "progress": False}
    paper = TendonArm.paper(nodes=3)
    made = [make_episodes(paper, tmp_path / f"{c}.h5", compiled=c, **small) for c in (True, False)]  # type: ignore[arg-type]
    assert made[0].xs[0].tobytes() == made[1].xs[0].tobytes()


@needs_compiler
def test_machine_code_is_made_where_a_run_gains_by_it(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    statics, rows = arm(nodes=2).statics(), np.tile(PULLS[0], (40, 1))
    statics.solve_many(rows)
    assert not cache.exists() or not libraries(cache)
    monkeypatch.setattr(paying, "COMPILING", paying.EQUILIBRIUM * len(rows))
    monkeypatch.setattr(paying, "LOOKING", 10)
    statics.solve_many(rows[:-1])  # one row too few
    assert not libraries(cache)
    statics.solve_many(rows)
    assert len(libraries(cache)) == 1
    monkeypatch.setattr(paying, "COMPILING", 10**9)
    twin = arm(nodes=2).statics()
    twin.solve_many(rows[:5])  # it is there already
    assert paying.pays("auto", 30, lambda: [twin.residual_function])
    assert not paying.pays("auto", 30, lambda: [arm(nodes=3).statics().residual_function])
    with pytest.raises(ValueError, match="threads"):
        statics.solve_many(rows, threads=0)


@pytest.mark.parametrize("wrong", ["yes", None, 2, 0, np.zeros(3)])
def test_other_values_of_compiled_are_refused_wherever_they_would_have_no_part(wrong: Any, tmp_path: Path) -> None:
    """On scenes that are compiled, held or jointed already, and before anything is simulated."""
    free = arm(nodes=2)
    held = rod.Scene(free.rod, rod.HeldTip(position=(0.0, 0.0, 0.99 * free.rod.length)), nodes=2)
    jointed = rod.Scene(free.rod, rod.Base(hinge=(0, 1, 0), stiffness=1.0), nodes=2)
    told = "^compiled = .*; expected True, False or 'auto'$"
    for scene in (free, compiled.CompiledScene.of(free), held, jointed):
        with pytest.raises(ValueError, match=told):
            scene.statics().solve_many(np.zeros((1, scene.n_inputs)), compiled=wrong)
    paper = TendonArm.paper()
    with pytest.raises(ValueError, match=told):
        make_episodes(paper, tmp_path / "a.h5", 1, steps=2, compiled=wrong)
    with pytest.raises(ValueError, match=told):
        make_phase_samples(paper, tmp_path / "b.h5", 2, rates=np.zeros((3, 15)), compiled=wrong)
    assert not list(tmp_path.iterdir())


def test_a_long_run_without_a_compiler_says_nothing(
    cache: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    assert not paying.pays("auto", 10**9, list)
    assert not caplog.records


@needs_compiler
def test_machine_code_is_for_one_kind_of_processor(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    function = arm(nodes=2).statics().residual_function
    compiled.compiled_functions([function])
    assert compiled.kept([function])
    monkeypatch.setattr(compiled, "processor", lambda: "another one")
    assert not compiled.kept([function])
    monkeypatch.setattr(processor, "processor", lambda: "x86_64")
    processor.native.cache_clear()
    assert processor.native("cc") == ()
    processor.native.cache_clear()
