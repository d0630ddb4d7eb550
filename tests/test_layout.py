"""The rooms of the house and the arrows between them: imports run downwards only."""

from __future__ import annotations

import ast
import importlib
import re
import warnings
from pathlib import Path

import pytest

from pisplit._moved import _Moved

ROOT = Path(__file__).resolve().parent.parent

#: What a room may import besides ``pisplit.checks`` and itself. A name not listed here may not be imported.
PISPLIT = {
    "data": set(),
    "observables": {"data", "regression"},
    "regression": set(),
    "dictionary": {"data", "observables"},
    "generator": {"data", "dictionary", "regression"},
    "splitting": {"data", "dictionary", "generator", "regression"},
    "lifted": {"data", "dictionary", "regression"},
    "evaluation": {"data", "lifted"},
    "estimators": {"data", "dictionary", "evaluation", "generator", "lifted", "observables", "regression", "splitting"},
}
CONTROLLERS = {
    "loop": {"references"},
    "estimation": {"loop"},
    "mpc": {"estimation", "loop", "references"},
    "learning": {"loop", "mpc", "references"},
    "feedforward": {"loop", "mpc"},
    "references": set(),
    "plants": {"loop"},
    "tuning": {"estimation", "loop", "mpc", "plants", "references"},
}
ROD = {
    "kinematics": set(),
    "section": {"kinematics"},
    "terms": {"kinematics", "section"},
    "equations": {"kinematics", "section", "terms"},
    "statics": {"equations", "output", "section", "terms"},
    "dynamics": {"analysis", "equations", "kinematics", "output", "terms"},
    "analysis": {"kinematics", "terms"},
    "output": {"analysis", "equations", "terms"},
}
#: Arms are scenes with tendons of any kind; what identifies them stands above.
MODELS = {
    "rod": set(),
    "arm": {"rod"},
    "calibration": {"arm", "rod"},
    "control_system": set(),
    "rod_system": {"control_system", "rod"},
    "systems": {"arm", "control_system", "rod_system"},
}
PARTS = {"pisplit": ("pisplit", PISPLIT), "controllers": ("pisplit.controllers", CONTROLLERS)}
PARTS["models"] = ("pisplit.models", MODELS)
#: Hands on names of all rooms when they are asked for; the front door behind it stands above all rooms.
FACE = (ROOT / "pisplit" / "__init__.py", ROOT / "pisplit" / "__main__.py")
PARTS["models/rod"] = ("pisplit.models.rod", ROD)


def imported(path: Path) -> set[str]:
    """Modules that a file imports, those for type checking alone left out."""
    tree = ast.parse(path.read_text())
    typing_only = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "_TYPE_CHECKING")
        for inner in ast.walk(node)
    }
    found = set()
    for node in ast.walk(tree):
        if id(node) in typing_only:
            continue
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            found |= {node.module or "", *(f"{node.module}.{name.name}" for name in node.names)}
        elif isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
    return found


@pytest.mark.parametrize("folder", PARTS)
def test_imports_run_along_the_allowed_arrows(folder: str) -> None:
    package, allowed = PARTS[folder]
    rooms = {p.stem for p in (ROOT / folder).iterdir() if p.stem in allowed}
    assert rooms == set(allowed)
    seen: dict[str, set[str]] = {room: set() for room in allowed}
    for path in sorted((ROOT / folder).rglob("*.py")):
        room = path.relative_to(ROOT / folder).parts[0].removesuffix(".py")
        if room not in allowed:
            continue
        for name in imported(path):
            rest = name.removeprefix(f"{package}.")
            other = rest.split(".")[0]
            if name != rest and other in allowed and other != room:
                assert other in allowed[room], f"{path.relative_to(ROOT)}: {room} -> {name} runs upwards"
                seen[room].add(other)
    assert seen == allowed, "arrows that nothing uses any more"


@pytest.mark.parametrize(
    ("folder", "forbidden"),
    [
        ("pisplit", ("pisplit.models", "pisplit.controllers")),
        ("models", ("pisplit.controllers",)),
        ("controllers", ("pisplit.models", "pisplit.estimators", "pisplit.splitting", "pisplit.generator")),
    ],
)
def test_the_three_parts_depend_one_way(folder: str, forbidden: tuple[str, ...]) -> None:
    for path in sorted((ROOT / folder).rglob("*.py")):
        if path in FACE or path.is_relative_to(ROOT / "pisplit" / "front"):
            continue
        bad = [name for name in imported(path) if name.startswith(forbidden)]
        assert not bad or path.name == "_moved.py", f"{path.relative_to(ROOT)} imports {bad}"


def test_nothing_below_the_front_door_knows_it() -> None:
    for folder in ("pisplit", "models", "controllers"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            if path not in FACE and not path.is_relative_to(ROOT / "pisplit" / "front"):
                assert not any(n.startswith("pisplit.front") for n in imported(path)), f"{path} imports the front"


def test_rooms_of_the_identification_have_an_order() -> None:
    """No circle among them: rooms can be read one after another."""
    left = dict(PISPLIT)
    while left:
        free = [room for room, needs in left.items() if not needs & set(left)]
        assert free, f"a circle among {sorted(left)}"
        for room in free:
            del left[room]


def test_every_room_says_what_it_is_for() -> None:
    for folder in ("pisplit", "models", "controllers", "scripts"):
        for path in (ROOT / folder).rglob("*.py"):
            house = path.parent / "__init__.py"
            if path.parent != ROOT / "scripts":
                assert ast.get_docstring(ast.parse(house.read_text())), f"{house.relative_to(ROOT)} says nothing"


def test_former_import_paths_lead_to_the_new_place() -> None:
    for old, new in _Moved.places.items():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            assert importlib.import_module(old) is importlib.import_module(new)


def test_a_former_import_path_says_where_the_module_is_now() -> None:
    import sys

    sys.modules.pop("pisplit.models.tendon_arm", None)
    with pytest.warns(DeprecationWarning, match=re.escape("is now pisplit.models.arm.tendon_arm")):
        importlib.import_module("pisplit.models.tendon_arm")
