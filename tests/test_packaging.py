"""The package as users get it: wheel and editable install, one import name, dependencies one way."""

import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PLACES = {"pisplit": "pisplit", "models": "pisplit/models", "controllers": "pisplit/controllers"}

SOLVE = """
import pisplit, pisplit.models.rod as rod, pisplit.controllers
scene = rod.Scene(rod.Rod(1.0, rod.Circle(0.01), rod.Elastic(1e9, 4e8, 1000.0)), rod.Gravity((-9.81, 0, 0)))
equilibrium = scene.statics().solve()
assert equilibrium.success and equilibrium.tip[0] < 0.0
print(pisplit.__file__, rod.__file__, pisplit.controllers.__file__, sep="\\n")
"""

LOADED = """
import importlib, pkgutil, sys
others = {others!r}
rooms = [{package!r}]
for name in rooms:
    for module in pkgutil.iter_modules(importlib.import_module(name).__path__, name + "."):
        if not module.name.startswith(others):
            importlib.import_module(module.name)
            if module.ispkg:
                rooms.append(module.name)
print(*[name for name in sys.modules if name.startswith(others)])
"""


def run(*command: str | Path, cwd: Path, path: Path | None = None) -> str:
    """Output of a command without this process's search path; ``path`` is searched first."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "PIP_"))}
    environment |= {"PIP_DISABLE_PIP_VERSION_CHECK": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    if path is not None:
        environment["PYTHONPATH"] = str(path)
    done = subprocess.run([str(c) for c in command], cwd=cwd, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout.strip()


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a copy of the sources, so that nothing is written beside the originals."""
    folder = tmp_path_factory.mktemp("packaging")
    for name in PLACES:
        shutil.copytree(ROOT / name, folder / "source" / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, folder / "source" / name)
    (folder / "elsewhere").mkdir()
    return folder


@pytest.fixture(scope="module")
def wheel(place: Path) -> Path:
    pip = (sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index")
    run(*pip, "--wheel-dir", place / "wheels", place / "source", cwd=place)
    (found,) = (place / "wheels").glob("*.whl")
    return found


@pytest.fixture(scope="module")
def site(place: Path, wheel: Path) -> Path:
    """The wheel, installed into a folder of its own."""
    pip = (sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--no-compile")
    run(*pip, "--target", place / "site", wheel, cwd=place)
    return place / "site"


def test_the_wheel_holds_every_module_under_one_name(wheel: Path) -> None:
    names = {name for name in zipfile.ZipFile(wheel).namelist() if not name.endswith("/")}
    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"pisplit"}
    wanted = {
        f"{inside}/{path.relative_to(ROOT / folder).as_posix()}"
        for folder, inside in PLACES.items()
        for path in (ROOT / folder).rglob("*.py")
    }
    assert wanted <= names
    assert "pisplit/py.typed" in names


def test_the_wheel_works_from_another_folder(place: Path, site: Path) -> None:
    files = run(sys.executable, "-c", SOLVE, cwd=place / "elsewhere", path=site).splitlines()
    assert all(Path(file).is_relative_to(site / "pisplit") for file in files)


def test_the_source_tree_does_not_break_the_wheel(site: Path) -> None:
    """In the source tree the folder ``pisplit`` hides the installed one and finds ``models`` beside itself."""
    files = run(sys.executable, "-c", SOLVE, cwd=ROOT, path=site).splitlines()
    assert [Path(file) for file in files] == [
        ROOT / n / "__init__.py" for n in ("pisplit", "models/rod", "controllers")
    ]


def test_an_editable_install_works(place: Path) -> None:
    """In a fresh environment that borrows the dependencies of this one, but not an installed pisplit."""
    environment, borrowed = place / "environment", place / "borrowed"
    run(sys.executable, "-m", "venv", "--without-pip", environment, cwd=place)
    borrowed.mkdir()
    for name in {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}:
        for entry in Path(name).iterdir():
            if "pisplit" not in entry.name and entry.suffix != ".pth":
                (borrowed / entry.name).symlink_to(entry)
    (packages,) = environment.glob("lib/python*/site-packages")
    (packages / "borrowed.pth").write_text(f"{borrowed}\n")
    python = environment / "bin" / "python"
    run(
        *(python, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"),
        *("--editable", place / "source"),
        cwd=place,
    )
    files = run(python, "-c", SOLVE, cwd=place / "elsewhere").splitlines()
    assert all(Path(file).is_relative_to(place / "source") for file in files)


@pytest.mark.parametrize(
    ("package", "others"),
    [
        ("pisplit", ("pisplit.models", "pisplit.controllers", "pisplit.front")),
        ("pisplit.models", ("pisplit.controllers",)),
        ("pisplit.controllers", ("pisplit.models",)),
    ],
)
def test_dependencies_run_one_way(place: Path, site: Path, package: str, others: tuple[str, ...]) -> None:
    code = LOADED.format(package=package, others=others)
    assert run(sys.executable, "-c", code, cwd=place / "elsewhere", path=site) == ""
