"""The documentation site: links lead somewhere, every page is in the contents, every public name in the reference."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PAGES = sorted([*DOCS.rglob("*.md"), *ROOT.glob("*.md")])
PUBLIC = (
    "pisplit",
    "pisplit.front",
    "pisplit.observables",
    "pisplit.controllers",
    "pisplit.controllers.plants",
    "pisplit.models",
    "pisplit.models.rod",
    "pisplit.models.arm",
    "pisplit.models.calibration",
)


def prose(page: Path) -> str:
    """Text of a page without its blocks of code."""
    return re.sub(r"^```.*?^```", "", page.read_text(), flags=re.S | re.M)


def anchors(page: Path) -> set[str]:
    """Anchors of the headings of a page, as GitHub and the site make them."""
    titles = re.findall(r"^#+ (.+)$", prose(page), re.M)
    return {re.sub(r"[^\w\- ]", "", title.strip().lower()).replace(" ", "-") for title in titles}


def links(page: Path) -> list[str]:
    return [t for t in re.findall(r"\]\(([^)\s]+)\)", prose(page)) if not t.startswith(("http", "mailto:"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_links_lead_to_a_page_and_to_a_heading_there(page: Path) -> None:
    for link in links(page):
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        assert target.exists(), f"{page.name}: {link} leads nowhere"
        if anchor:
            assert anchor in anchors(target), (
                f"{page.name}: {link}: no such heading; there are {sorted(anchors(target))}"
            )


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_files_that_a_page_names_exist(page: Path) -> None:
    text = prose(page)
    for name in re.findall(r"(?<![\w/])((?:scripts|tests|docs|models|controllers|pisplit)/[\w/]+\.(?:py|md))\b", text):
        assert (ROOT / name).exists(), f"{page.name} names {name}"


def test_every_page_is_in_the_contents_once() -> None:
    listed = []
    for page in DOCS.rglob("*.md"):
        for tree in re.findall(r"^```\{toctree\}\n(.*?)^```", page.read_text(), re.S | re.M):
            names = [line.strip() for line in tree.splitlines() if line.strip() and not line.startswith(":")]
            listed += [(page.parent / f"{name}.md").resolve() for name in names]
    assert sorted(listed) == sorted(p for p in DOCS.rglob("*.md") if p != DOCS / "index.md")


@pytest.mark.parametrize("package", PUBLIC)
def test_every_public_name_is_in_the_reference(package: str) -> None:
    pages = [page.read_text() for page in (DOCS / "reference").glob("*.md")]
    whole = {name for page in pages for name in re.findall(r"automodule:: (\S+)", page)}
    single = {name for page in pages for name in re.findall(r"auto(?:class|function):: (\S+)", page)}
    module = importlib.import_module(package)
    for name in module.__all__:
        found = getattr(module, name)
        home = found.__name__ if isinstance(found, ModuleType) else package
        assert home in whole or f"{package}.{name}" in single or listed_elsewhere(found, whole), f"{package}.{name}"


def listed_elsewhere(thing: object, modules: set[str]) -> bool:
    """Whether one of the documented modules hands the same thing on."""
    known = [importlib.import_module(name) for name in modules]
    return any(getattr(m, n) is thing for m in known for n in getattr(m, "__all__", ()))


def test_docstrings_keep_formulas_and_tables() -> None:
    pytest.importorskip("sphinx", reason="needs the extra docs")
    sys.path.insert(0, str(DOCS))
    try:
        docstrings = importlib.import_module("docstrings")
    finally:
        sys.path.remove(str(DOCS))
    assert docstrings.escaped("|K| and ``|K|``, 2 * x, *sic*, alpha_") == r"\|K\| and ``|K|``, 2 \* x, *sic*, alpha\_"
    table = ["Says.", "", "xs      states (T, n)", "        one array each", "u, du   inputs", "and more."]
    docstrings.reshape(None, "class", "x", None, None, table)
    said = ["Says.", "- ``xs`` -- states (T, n)", "  one array each", "- ``u, du`` -- inputs", "and more."]
    assert [line for line in table if line] == said
    formula = ["It is", "", "    y = A x", "", "Args:", "    x: states.", "", "    more."]
    docstrings.reshape(None, "class", "x", None, None, formula)
    assert formula[2:5] == [".. code-block:: text", "", "    y = A x"] and formula[-2] == "    more."
    assert docstrings.exists("pisplit.controllers.MPC") and not docstrings.exists("pisplit.controllers.MPX")
    assert docstrings.exists("KalmanFilter") and not docstrings.exists("KalmanFilters")


def test_a_broken_link_ends_the_build(tmp_path: Path) -> None:
    for name in ("sphinx", "myst_parser", "furo"):
        pytest.importorskip(name, reason="needs the extra docs")
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "docstrings.py").write_text((DOCS / "docstrings.py").read_text())
    conf = (DOCS / "conf.py").read_text().replace(', "pictures"', "")  # they take a minute
    (tmp_path / "site" / "conf.py").write_text(conf)
    good = "# Start\n\n[there](#there)\n\n## There\n\n```{eval-rst}\n:py:obj:`pisplit.Episodes`\n```\n"
    pages = [good, good.replace("#there", "#where"), good.replace("Episodes", "Episode")]
    codes = []
    for text in pages:
        (tmp_path / "site" / "index.md").write_text(text)
        command = [
            sys.executable,
            "-m",
            "sphinx",
            "-W",
            "-q",
            "-b",
            "dummy",
            str(tmp_path / "site"),
            str(tmp_path / "o"),
        ]
        codes.append(subprocess.run(command, cwd=ROOT, capture_output=True).returncode)
    assert codes[0] == 0 and all(codes[1:]), codes


def test_sections_of_a_page_do_not_skip_a_level() -> None:
    for page in PAGES:
        levels = [len(found) for found in re.findall(r"^(#+) ", prose(page), re.M)]
        assert all(b <= a + 1 for a, b in pairwise(levels)), page.name
