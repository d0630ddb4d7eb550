"""The map from the paper's labels to the code holds: each label is cited where it is computed."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
#: Equations that carry a label in the paper's source, and the algorithm.
LABELS = [
    "x_diff_eq",
    "x_flow_map",
    "koopman_def",
    "theta_matrix",
    "discrete-time-koop",
    "update_rule",
    "lie_deriv",
    "cont_koopman_solve",
    "jacob_solve",
    "matrix_exp",
    "hilbert_split",
    "l_edmdc_dict",
    "linearly_separable_diffeq",
    "koopman_strang_splitting",
    "full_kth",
    "cosserat_rod_eq",
    "alg:pi-edmdc",
]


def rows() -> list[tuple[str, str, str]]:
    """Label, file and function of every row of the table."""
    text = (ROOT / "docs" / "equations.md").read_text()
    cells = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("|")
    ]
    return [(row[0].strip("`"), row[2], row[3].strip("`")) for row in cells[2:]]


def source(path: str, name: str) -> str:
    """The lines of a function, class or method."""
    text = (ROOT / path).read_text()
    scope: ast.AST = ast.parse(text)
    for part in name.split("."):
        kinds = (ast.FunctionDef, ast.ClassDef)
        found = [node for node in ast.iter_child_nodes(scope) if isinstance(node, kinds) and node.name == part]
        assert len(found) == 1, f"{path} has no {name}"
        scope = found[0]
    return ast.get_source_segment(text, scope) or ""


def test_every_label_of_the_paper_has_a_row() -> None:
    assert set(LABELS) <= {label for label, _, _ in rows()}


@pytest.mark.parametrize(("label", "path", "name"), rows())
def test_a_label_is_cited_where_it_is_computed(label: str, path: str, name: str) -> None:
    wanted = f"eq. {label}" if label in LABELS and ":" not in label else label
    assert re.search(rf"{re.escape(wanted)}(?![\w-])", source(path, name)), f"{path}: {name} does not cite {wanted!r}"


def test_no_label_is_cited_that_the_paper_does_not_have() -> None:
    for folder in ("pisplit", "models", "controllers", "scripts"):
        for path in (ROOT / folder).rglob("*.py"):
            for label in re.findall(r"eq\. ([a-z_]+[_-][a-z_-]+)", path.read_text()):
                assert label in LABELS, f"{path.relative_to(ROOT)} cites eq. {label}"
