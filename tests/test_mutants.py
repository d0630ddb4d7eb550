"""Mutation testing itself: what is mutated, who is asked, and what counts as noticed."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from mutation.equivalent import Equivalent, reason_for
from mutation.operators import mutations
from mutation.reached import Passing, Reach
from mutation.rooms import ROOMS, files
from mutation.trial import covering

ROOT = Path(__file__).resolve().parents[1]
FORMULA = b'''"""A - b."""
GAIN = 2

def sign(a: int | float, b: float) -> float:
    """c - d."""
    if a.T >= b:
        raise ValueError(f"{a + b} + 1")
    return (a - b) * GAIN
'''
MODULE = """
def half(a):
    return a / 2

def slow(n):
    while n > 0:
        n = n // 2
    return n

def double(a):
    return a + a

def never():
    return x.T
"""
TESTS = """
from functools import cache
import pytest
from pisplit.regression.small import double, half, slow

@cache
def cached():
    return half(4.0)

@pytest.fixture(scope="module")
def fixed():
    return half(6.0)

def test_uses_first(): cached()
def test_a_half(): assert cached() == 2.0
def test_fixed_first(fixed): pass
def test_fixed_half(fixed): assert fixed == 3.0
def test_slow(): assert slow(3) == 0
def test_weak(): assert double(1) > 0
"""


def lines(source: bytes) -> set[str]:
    return {m.after for m in mutations("a.py", source)}


def test_mutants_are_single_slips_of_code_and_of_nothing_else() -> None:
    found = mutations("a.py", FORMULA)
    for mutation in found:
        ast.parse(mutation.apply(FORMULA))
        assert mutation.apply(FORMULA) != FORMULA
    after = {m.after for m in found}
    assert {"return (a + b) * GAIN", "return (a - b) / GAIN", "return -((a - b) * GAIN)", "return (a - b)"} <= after
    assert {"GAIN = 3", "GAIN = 1", "if a.T > b:", "if a.T < b:", "if (a) >= b:"} <= after
    assert not any(word in m.after for m in found for word in ('"""', "raise", "def "))


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("x = a @ b", "x = (b) @ (a)"),
        ("x = cross(a, b)", "x = cross(b, a)"),
        ("x = -a", "x = (a)"),
        ("x = a[1:]", "x = a[:]"),
        ("x = a[k - 1]", "x = a[k + 1]"),
        ("x = 1e-8", "x = 0.001"),
        ("x = a**2", "x = a*2"),
        ("x = np.maximum(a, b)", "x = np.minimum(a, b)"),
        ("x = a.sum()", "x = a.mean()"),
        ("x = not a", "x = (a)"),
        ("x += a", "pass"),
        ("x[0] = a", "pass"),
        ("x = np.sqrt(a)", "x = (a)"),
        ("x = a is not None", "x = a is None"),
        ("x = a and b", "x = a or b"),
    ],
)
def test_an_operator_makes_its_slip(line: str, expected: str) -> None:
    assert expected in lines(line.encode())


def test_a_constant_of_a_module_is_tested_by_whoever_names_it_or_uses_its_file(tmp_path: Path) -> None:
    (tmp_path / "pisplit").mkdir()
    (tmp_path / "pisplit" / "a.py").write_bytes(FORMULA)
    users = Passing("t.py::uses", 1.0, {"pisplit/a.py": frozenset({8})})
    others = Passing("t.py::other", 1.0, {"pisplit/a.py": frozenset({6})})
    elsewhere = Passing("t.py::elsewhere", 1.0, {"pisplit/b.py": frozenset({8})})
    reach = Reach((users, others, elsewhere), (), ())
    constant = next(m for m in mutations("pisplit/a.py", FORMULA) if m.line == 2)
    assert constant.executed is None and constant.names == ("GAIN",)
    assert covering(constant, reach, tmp_path) == [users, others]
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_b.py").write_text("assert a.GAIN == 2")
    reading = Passing("tests/test_b.py::reading", 1.0, {})
    assert covering(constant, Reach((users, elsewhere, reading), (), ()), tmp_path) == [users, reading]
    condition = next(m for m in mutations("pisplit/a.py", FORMULA) if m.line == 6)
    assert covering(condition, reach, tmp_path) == [others]


def test_mutants_keep_their_name_when_lines_move() -> None:
    moved = b"import os\n" + FORMULA
    assert {m.key for m in mutations("a.py", moved)} == {m.key for m in mutations("a.py", FORMULA)}
    known = (Equivalent("a.py", "GAIN = 2", "GAIN = 3", "nothing depends on it"),)
    assert sum(reason_for(m, known) is not None for m in mutations("a.py", moved)) == 1


def test_every_room_has_formulas() -> None:
    assert set(files(ROOT)) == set(ROOMS)


def test_killed_surviving_and_endless_mutants_are_told_apart_and_the_tree_is_left_alone(tmp_path: Path) -> None:
    tree = tmp_path / "tree"
    (tree / "pisplit" / "regression").mkdir(parents=True)
    (tree / "tests").mkdir()
    (tree / "pyproject.toml").write_text("[tool.pytest.ini_options]\naddopts = '-q --import-mode=importlib'\n")
    for name in ("__init__.py", "regression/__init__.py"):
        (tree / "pisplit" / name).touch()
    (tree / "pisplit" / "regression" / "small.py").write_text(MODULE)
    (tree / "tests" / "test_small.py").write_text(TESTS)
    before = {path: path.read_bytes() for path in tree.rglob("*") if path.is_file()}
    command = [sys.executable, str(ROOT / "scripts" / "mutants.py"), "--root", "tree", "--out", "out"]
    command += ["--json", "out.json", "--sample", "100", "--grace", "0.5"]
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    ended = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300)
    assert ended.returncode == 1, ended.stderr
    figures = {name: f["value"] for name, f in json.loads((tmp_path / "out.json").read_text())["figures"].items()}
    left = [line.strip() for line in ended.stdout.splitlines() if line.strip().startswith("+ ")]
    assert set(left) == {"+ return (a)", "+ n = n // 3", "+ return (x)"}  # two that the tests allow, one never run
    assert "timeout" in ended.stdout and "not covered: pisplit/regression/small.py:14" in ended.stdout
    assert figures["noticed"] == pytest.approx(100.0 * (1.0 - len(left) / figures["mutants"]))
    assert {path: path.read_bytes() for path in tree.rglob("*") if path.is_file()} == before
