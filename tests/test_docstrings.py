"""Every public function, method and class says what it does and names each of its arguments."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
ROOMS = ("pisplit", "models", "controllers")
#: Arguments that need no word: the object itself, and what Python's own protocols hand over.
UNNAMED = ("self", "cls")

Function = ast.FunctionDef | ast.AsyncFunctionDef


def files() -> list[Path]:
    return sorted(p for room in ROOMS for p in (ROOT / room).rglob("*.py") if not p.name.startswith("_"))


def public(name: str) -> bool:
    return not name.startswith("_")


def has(node: Function | ast.ClassDef, *decorators: str) -> bool:
    return any(re.search(rf"\b({'|'.join(decorators)})\b", ast.unparse(d)) for d in node.decorator_list)


def arguments(node: Function) -> list[str]:
    """Names of the arguments that a caller gives, those with an underscore in front aside."""
    given = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    rest = [a for a in (node.args.vararg, node.args.kwarg) if a is not None]
    return [a.arg for a in (*given, *rest) if a.arg not in UNNAMED and public(a.arg)]


def unnamed(names: list[str], text: str) -> list[str]:
    return [name for name in names if not re.search(rf"(?<!\w){re.escape(name)}(?!\w)", text)]


def fields(node: ast.ClassDef) -> list[str]:
    """Fields that a dataclass takes."""
    found = [s for s in node.body if isinstance(s, ast.AnnAssign) and isinstance(s.target, ast.Name)]
    taken = [s for s in found if "ClassVar" not in ast.unparse(s.annotation) and "init=False" not in ast.unparse(s)]
    return [s.target.id for s in taken if isinstance(s.target, ast.Name) and public(s.target.id)]


def complaints(tree: ast.Module, known: dict[str, ast.ClassDef]) -> Iterator[tuple[int, str]]:
    """Line and what is missing there; ``known`` are the classes that a class may inherit docstrings from."""
    for node in tree.body:
        if isinstance(node, Function) and public(node.name):
            yield from of_function(node, node.name, "")
        if isinstance(node, ast.ClassDef) and public(node.name):
            yield from of_class(node, known)


def of_function(node: Function, name: str, elsewhere: str) -> Iterator[tuple[int, str]]:
    if has(node, "overload", "setter"):
        return
    text = ast.get_docstring(node) or elsewhere
    if not text:
        yield node.lineno, f"{name} has no docstring"
    elif missing := unnamed(arguments(node), text + elsewhere):
        yield node.lineno, f"{name} does not say: {', '.join(missing)}"


def of_class(node: ast.ClassDef, known: dict[str, ast.ClassDef]) -> Iterator[tuple[int, str]]:
    if ast.get_docstring(node) is None:
        yield node.lineno, f"{node.name} has no docstring"
        return
    family = [node, *ancestors(node, known)]
    made = next((m for m in methods(node) if m.name == "__init__"), None)
    wanted = arguments(made) if made is not None else fields(node) if has(node, "dataclass") else []
    if missing := unnamed(wanted, said_by([*family, *([made] if made else [])])):
        yield node.lineno, f"{node.name} does not say: {', '.join(missing)}"
    for member in methods(node):
        if public(member.name):
            above = [m for one in family[1:] for m in methods(one) if m.name == member.name]
            yield from of_function(member, f"{node.name}.{member.name}", said_by(above))


def said_by(nodes: Sequence[Function | ast.ClassDef]) -> str:
    return " ".join(ast.get_docstring(n) or "" for n in nodes).strip()


def methods(node: ast.ClassDef) -> list[Function]:
    return [m for m in node.body if isinstance(m, Function)]


def ancestors(node: ast.ClassDef, known: dict[str, ast.ClassDef]) -> list[ast.ClassDef]:
    names = [ast.unparse(base).split("[")[0].split(".")[-1] for base in node.bases]
    found = [known[name] for name in names if name in known and known[name] is not node]
    return [*found, *(a for one in found for a in ancestors(one, known))]


@cache
def classes() -> dict[str, ast.ClassDef]:
    trees = [ast.parse(path.read_text()) for path in files()]
    return {n.name: n for tree in trees for n in ast.walk(tree) if isinstance(n, ast.ClassDef)}


@pytest.mark.parametrize("path", files(), ids=lambda p: p.relative_to(ROOT).as_posix())
def test_every_argument_is_said(path: Path) -> None:
    found = list(complaints(ast.parse(path.read_text()), classes()))
    assert not found, "\n".join(f"{path}:{line}: {what}" for line, what in found)


def test_what_is_not_said_is_found() -> None:
    code = '''
class Silent:
    """Says nothing of its arguments."""
    def __init__(self, told: int, other: int) -> None: ...
    def move(self, by: float) -> None:
        """Moves."""
    def stay(self) -> None: ...
def double(number: float, *rest: float) -> float:
    """Twice the ``number``."""
'''
    assert [what for _, what in complaints(ast.parse(code), {})] == [
        "Silent does not say: told, other",
        "Silent.move does not say: by",
        "Silent.stay has no docstring",
        "double does not say: rest",
    ]


#: Annotations of arrays, and what tells a shape: "(m, 3)", "numbers", "as in ..." another place that does.
ARRAY = re.compile(r"\b(Array|ArrayLike|NDArray|ndarray)\b")
SHAPE = re.compile(
    r"\([^()]*(?:,|\.\.\.|\b[nmpT]\b|[A-Z]\w*)[^()]*\)|\b(?:numbers?|shape|scalar|points?|see)\b"
    r"|\bone (?:per|a|an|each)\b|\bas (?:in|for)\b"
)
#: Rooms whose names users meet.
FACES = (
    *("pisplit", "pisplit/front", "pisplit/observables", "controllers", "controllers/plants"),
    *("models", "models/rod", "models/arm", "models/calibration"),
)


@cache
def public_names() -> frozenset[str]:
    found: set[str] = set()
    for face in FACES:
        for node in ast.parse((ROOT / face / "__init__.py").read_text()).body:
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
                found |= set(ast.literal_eval(node.value))
    return frozenset(found)


def shapeless(names: list[str], text: str) -> list[str]:
    """Names near which, and in whose sentence, nothing tells a shape."""
    told = []
    for name in names:
        for found in re.finditer(rf"(?<!\w){re.escape(name)}(?!\w)", text):
            sentence = text[text.rfind(". ", 0, found.start()) + 1 :].split(". ")[0]
            near = text[found.start() : found.end() + 160]
            if SHAPE.search(sentence) or SHAPE.search(near):
                told.append(name)
                break
    return [name for name in names if name not in told]


def arrays(node: Function) -> list[str]:
    given = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    return [
        a.arg for a in given if a.annotation is not None and ARRAY.search(ast.unparse(a.annotation)) and public(a.arg)
    ]


def without_shape(tree: ast.Module, known: dict[str, ast.ClassDef], names: frozenset[str]) -> Iterator[tuple[int, str]]:
    """Line and array arguments, and array fields of dataclasses, of the public ``names`` whose shape nobody tells."""
    for node in tree.body:
        if isinstance(node, Function) and node.name in names:
            for name in shapeless(arrays(node), ast.get_docstring(node) or ""):
                yield node.lineno, f"{node.name}: the shape of {name}"
        if isinstance(node, ast.ClassDef) and node.name in names:
            family = [node, *ancestors(node, known)]
            for member in methods(node):
                above = family if member.name == "__init__" else [m for o in family[1:] for m in methods(o)]
                text = f"{ast.get_docstring(member) or ''} {said_by(above)}"
                if public(member.name) or member.name == "__init__":
                    for name in shapeless(arrays(member), text):
                        yield member.lineno, f"{node.name}.{member.name}: the shape of {name}"
            if has(node, "dataclass"):
                annotated = [s for s in node.body if isinstance(s, ast.AnnAssign) and isinstance(s.target, ast.Name)]
                held = [s.target.id for s in annotated if ARRAY.search(ast.unparse(s.annotation))]  # type: ignore[union-attr]
                for name in shapeless([h for h in held if public(h)], said_by(family)):
                    yield node.lineno, f"{node.name}: the shape of {name}"


@pytest.mark.parametrize("path", files(), ids=lambda p: p.relative_to(ROOT).as_posix())
def test_shapes_of_arrays_are_said(path: Path) -> None:
    found = list(without_shape(ast.parse(path.read_text()), classes(), public_names()))
    assert not found, "\n".join(f"{path}:{line}: {what}" for line, what in found)


def test_a_shape_that_is_not_said_is_found() -> None:
    code = '''
def moved(x: Array, by: ArrayLike, late: float) -> Array:
    """States ``x`` (T, n), moved. The ``by`` is what moves them, by so much in every direction that there is, and as
    often as somebody wants it, whoever that may be, which takes a while if it is done well, as is done here, late."""
@dataclass
class Held:
    """What is kept.

    values  of the things that are kept in this box, which is large enough for all of them, today and on all days
            and never runs over, whatever is put into it by whomever and how often that may happen in this house
    """
    values: Array
'''
    found = [what for _, what in without_shape(ast.parse(code), {}, frozenset({"moved", "Held"}))]
    assert found == ["moved: the shape of by", "Held: the shape of values"]


def unsaid_errors(tree: ast.Module, known: dict[str, ast.ClassDef], names: frozenset[str]) -> Iterator[tuple[int, str]]:
    """Line and function, class or method of public ``names`` that raises by itself and does not say so."""
    for node in tree.body:
        if isinstance(node, Function) and node.name in names and raises(node) and not tells(ast.get_docstring(node)):
            yield node.lineno, f"{node.name} raises {', '.join(raises(node))}"
        if isinstance(node, ast.ClassDef) and node.name in names:
            above = said_by([node, *ancestors(node, known)])
            for member in methods(node):
                own = public(member.name) or member.name in ("__init__", "__post_init__", "__call__")
                if own and raises(member) and not tells(f"{ast.get_docstring(member) or ''} {above}"):
                    yield member.lineno, f"{node.name}.{member.name} raises {', '.join(raises(member))}"


def raises(node: Function) -> list[str]:
    """Errors that a caller may make; what is not written yet or never happens is not."""
    made = [n.exc for n in ast.walk(node) if isinstance(n, ast.Raise) and n.exc is not None]
    found = [ast.unparse(e.func if isinstance(e, ast.Call) else e) for e in made]
    return sorted({f for f in found if f[:1].isupper() and f not in ("AssertionError", "StopIteration")})


def tells(text: str | None) -> bool:
    return re.search(r"\b[Rr](aises?|efuse[sd]?)\b", text or "") is not None


@pytest.mark.parametrize("room", ROOMS)
def test_errors_are_said(room: str) -> None:
    paths = [p for p in files() if p.is_relative_to(ROOT / room)]
    told = [(p, *c) for p in paths for c in unsaid_errors(ast.parse(p.read_text()), classes(), public_names())]
    assert not told, "\n".join(f"{path}:{line}: {what}" for path, line, what in told)


def test_an_error_that_is_not_said_is_found() -> None:
    code = '''
def half(number: float) -> float:
    """Half of it."""
    if number < 0:
        raise ValueError("number is negative")
    return number / 2
def third(number: float) -> float:
    """A third of it. Raises ValueError for negative ones."""
    if number < 0:
        raise ValueError("number is negative")
    return number / 3
'''
    found = list(unsaid_errors(ast.parse(code), {}, frozenset({"half", "third"})))
    assert found == [(2, "half raises ValueError")]


#: Arguments that are quantities of one kind wherever they stand, and what tells their unit.
MEASURES = (
    *("dt", "period", "duration", "approach", "lag", "deadline", "command_shift", "max_gap"),
    *("length", "radius", "offset", "diameter", "mass", "tip_mass", "density", "young", "pitch", "angle", "turn"),
)
UNIT = re.compile(
    r"\[[^\]]{1,12}\]|\b(?:in|s|m|mm|ms|rad|deg|degrees?|kg|Hz|Pa|N|steps?|seconds?|parts?|units?)\b|\bas (?:in|for)\b"
)
#: Where the next argument of a list begins.
ENTRY = re.compile(r"\n\s*[\w, ]+(?::|  )")


def unitless(tree: ast.Module, names: frozenset[str]) -> Iterator[tuple[int, str]]:
    """Line and argument or field of public ``names`` that is a time, length or mass and near which no unit stands."""
    for node in tree.body:
        if not isinstance(node, Function | ast.ClassDef) or node.name not in names:
            continue
        whole = ast.get_docstring(node) or ""
        parts: list[tuple[str, list[str], str]] = []
        if isinstance(node, Function):
            parts.append((node.name, arguments(node), whole))
        else:
            if has(node, "dataclass"):
                parts.append((node.name, fields(node), whole))
            for m in methods(node):
                if public(m.name) or m.name == "__init__":
                    parts.append((f"{node.name}.{m.name}", arguments(m), f"{ast.get_docstring(m) or ''}\n{whole}"))
        for name, given, text in parts:
            for measure in sorted(set(given) & set(MEASURES)):
                places = [f.end() for f in re.finditer(rf"(?<!\w){measure}(?!\w)", text)]
                if not any(UNIT.search(ENTRY.split(text[at : at + 160])[0]) for at in places):
                    yield node.lineno, f"{name}: the unit of {measure}"


@pytest.mark.parametrize("room", ROOMS)
def test_units_of_times_lengths_and_masses_are_said(room: str) -> None:
    paths = [p for p in files() if p.is_relative_to(ROOT / room)]
    told = [(p, *c) for p in paths for c in unitless(ast.parse(p.read_text()), public_names())]
    assert not told, "\n".join(f"{path}:{line}: {what}" for path, line, what in told)


def test_a_unit_that_is_not_said_is_found() -> None:
    code = '''
def wave(period: float, radius: float) -> float:
    """A wave.

    period  how long it takes
    radius  [m] of the circle
    """
'''
    assert [what for _, what in unitless(ast.parse(code), frozenset({"wave"}))] == ["wave: the unit of period"]
