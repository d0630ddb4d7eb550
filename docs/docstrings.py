"""Docstrings as Sphinx takes them: formulas and columns of arguments keep their shape, names in roles must exist."""

from __future__ import annotations

import ast
import importlib
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util import logging

ROOT = Path(__file__).resolve().parent.parent
#: Titles that napoleon reads as sections of its own.
SECTION = re.compile(r"(Args|Attributes|Raises|Returns|Yields|Example|Examples|Note|Notes):$")
#: ``name, other    what it is``, a row of a table of arguments.
ROW = re.compile(r"(?P<names>\*{0,2}[A-Za-z_]\w*(?:, \w+)*)\s{2,}(?P<text>\S.*)$")
CODE = re.compile(r"(``.+?``|:\w+:`[^`]+`|`[^`]+`)")


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the hooks."""
    app.connect("autodoc-process-docstring", reshape, priority=400)
    app.connect("autodoc-process-signature", aliased)
    app.connect("missing-reference", missing)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}


def reshape(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Rewrite the ``lines`` of a docstring in place, before napoleon reads its sections."""
    found: list[str] = []
    inside = literal = False  # of a section, after a "::"
    for block in blocks(lines):
        indented = all(line.startswith(" ") for line in block)
        inside = (inside and indented) or bool(SECTION.match(block[0]))
        if literal and indented:
            found += [*block, ""]
        elif indented and not inside and not ROW.match(block[0].strip()) and not block[0].lstrip().startswith("- "):
            found += [".. code-block:: text", "", *block, ""]
        else:
            found += [*rewritten(block), ""]
            literal = block[-1].endswith("::")
    lines[:] = found


def aliased(
    app: Sphinx, what: str, name: str, thing: Any, options: Any, signature: str | None, result: str | None
) -> tuple[str | None, str | None]:
    """A ``signature`` and its ``result`` with type aliases under their own names."""
    shown = [t and re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", t) for t in (signature, result)]
    return shown[0], shown[1]


def blocks(lines: list[str]) -> Iterator[list[str]]:
    """Stretches of lines between blank ones; a section with its title stays one."""
    block: list[str] = []
    for line in [*lines, ""]:
        if line.strip():
            block.append(line)
        elif block:
            yield block
            block = []


def rewritten(block: list[str]) -> list[str]:
    """One stretch: sections as they are, tables of arguments as lists, other indented lines with their breaks."""
    if SECTION.match(block[0].strip()) or block[0].lstrip().startswith(("- ", "..", ">>>")):
        return [escaped(line) for line in block]
    found: list[str] = []
    depth = min(len(line) - len(line.lstrip()) for line in block)
    at = None  # column of the text of the last row
    broken: list[str] = []
    for line in block:
        indent = len(line) - len(line.lstrip())
        row = ROW.match(line.strip())
        if row and not re.match(r".*[=+<>]\s{2,}", line):
            if at is None and found:
                found.append("")
            at = indent + row.start("text")
            found.append(f"{' ' * depth}- ``{row['names']}`` -- {escaped(row['text'])}")
        elif at is not None and indent >= at:
            found.append(f"{' ' * depth}  {escaped(line.strip())}")
        elif indent > depth:
            broken.append(line)
            found.append(f"{' ' * depth}| {escaped(line.strip())}")
        else:
            if at is not None or (found and found[-1].lstrip().startswith("| ")):
                found.append("")
            at = None
            found.append(escaped(line))
    return list(spaced(found))


def spaced(lines: list[str]) -> Iterator[str]:
    """A blank line where a line block begins or ends."""
    before = ""
    for line in lines:
        starts, goes_on = line.lstrip().startswith("| "), before.lstrip().startswith("| ")
        if starts != goes_on and before and line:
            yield ""
        yield line
        before = line


def escaped(line: str) -> str:
    """Bars and stars of formulas, which reStructuredText takes for markup, outside of code and emphasis."""
    parts = CODE.split(line)
    return "".join(part if k % 2 else _plain(part) for k, part in enumerate(parts))


def _plain(text: str) -> str:
    text = re.sub(r"\|", r"\\|", text)
    text = re.sub(r"(?<!\\)\*(?![A-Za-z][\w ,-]*\*)(?<!\w\*)", r"\\*", text)
    return re.sub(r"(\w)_(?=\W|$)", r"\1\\_", text)


def missing(app: Sphinx, env: Any, node: addnodes.pending_xref, shown: nodes.Element) -> nodes.Element | None:
    """A name in a role that has no page stays plain code; one that does not exist is a broken link."""
    if node.get("refdomain") != "py" or _in_signature(node):
        return None
    if not exists(node["reftarget"]):
        logging.getLogger(__name__).warning("broken link to %s", node["reftarget"], location=node)
    return shown


def _in_signature(node: nodes.Node) -> bool:
    while node.parent is not None:
        node = node.parent
        if isinstance(node, addnodes.desc_signature | nodes.field):
            return True
    return False


def exists(target: str) -> bool:
    """Whether a dotted name can be imported, or a bare one is defined anywhere in the package."""
    if "." not in target or not target.startswith("pisplit"):
        return target.rsplit(".", 1)[-1] in defined()
    parts = target.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            found: Any = importlib.import_module(".".join(parts[:cut]))
        except ImportError:
            continue
        for name in parts[cut:]:
            if not hasattr(found, name):
                return name in getattr(found, "__annotations__", {})
            found = getattr(found, name)
        return True
    return False


@cache
def defined() -> frozenset[str]:
    """Names of all functions, classes and constants of the package."""
    found = set()
    for room in ("pisplit", "models", "controllers"):
        for path in (ROOT / room).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.FunctionDef | ast.ClassDef):
                    found.add(node.name)
                elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                    found.add(node.id)
    return frozenset(found)
