"""Single-line mutations of Python source: what one slip of the pen would make of a formula."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass

SIGNS = {ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*"), ast.Pow: ("**", "*")}
LOGIC = {ast.BitAnd: ("&", "|"), ast.BitOr: ("|", "&")}
COMPARISONS = {
    ast.Lt: ("<", ("<=", ">=")),
    ast.LtE: ("<=", ("<", ">")),
    ast.Gt: (">", (">=", "<=")),
    ast.GtE: (">=", (">", "<")),
    ast.Eq: ("==", ("!=",)),
    ast.NotEq: ("!=", ("==",)),
    ast.Is: ("is", ("is not",)),
    ast.IsNot: ("is not", ("is",)),
    ast.In: ("in", ("not in",)),
    ast.NotIn: ("not in", ("in",)),
}
#: Functions and methods that are taken for each other.
SIBLINGS = {
    **{"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "fmin": "fmax", "fmax": "fmin"},
    **{"any": "all", "all": "any", "sum": "mean", "mean": "sum", "median": "mean", "std": "var", "cumsum": "cumprod"},
    **{"argmin": "argmax", "argmax": "argmin", "floor": "ceil", "ceil": "floor", "sin": "cos", "cos": "sin"},
    **{"zeros": "ones", "ones": "zeros", "zeros_like": "ones_like", "ones_like": "zeros_like"},
}
#: Functions of two arguments in which the order matters.
ORDERED = {"cross", "columnwise_cross", "outer", "kron", "arctan2", "atan2", "solve", "mtimes", "dot"}
#: Functions whose value is easily left at their argument.
WRAPPERS = {"sqrt", "abs", "fabs", "exp", "log", "square", "clip", "deg2rad", "radians", "pinv"}
#: Keyword arguments that change no result.
SILENT = {"stacklevel", "strict", "copy", "full_matrices", "check_finite", "overwrite_a", "overwrite_b"}


@dataclass(frozen=True)
class Mutation:
    """One change of a file: the bytes from ``start`` to ``end`` become ``new``.

    before, after  the changed lines, blanks at both ends removed; with ``file`` they name the mutation even after lines
                   have moved
    kind           the operator that made it
    executed       first and last line whose execution runs the changed code; None where it runs at import
    names          what the changed statement defines, where it runs at import
    """

    file: str
    line: int
    before: str
    after: str
    kind: str
    start: int
    end: int
    new: str
    executed: tuple[int, int] | None
    names: tuple[str, ...] = ()

    @property
    def key(self) -> tuple[str, str, str]:
        """What names the mutation wherever its lines stand."""
        return self.file, self.before, self.after

    def apply(self, source: bytes) -> bytes:
        """The mutated source."""
        return source[: self.start] + self.new.encode() + source[self.end :]

    def __str__(self) -> str:
        return f"{self.file}:{self.line} [{self.kind}]\n    - {self.before}\n    + {self.after}"


def replaced(
    file: str, source: bytes, start: int, end: int, new: str, kind: str, tree: ast.Module | None = None
) -> Mutation:
    """The mutation that puts ``new`` in place of the bytes from ``start`` to ``end`` of a file with syntax ``tree``."""
    first, last = source.rfind(b"\n", 0, start) + 1, source.find(b"\n", end)
    last = len(source) if last < 0 else last
    before = source[first:last].decode()
    after = source[first:start].decode() + new + source[end:last].decode()
    line = source.count(b"\n", 0, start) + 1
    executed, names = _reach(tree or ast.parse(source), line, source.count(b"\n", 0, end) + 1)
    return Mutation(file, line, _blank(before), _blank(after), kind, start, end, new, executed, names)


def mutations(file: str, source: bytes) -> list[Mutation]:
    """All mutations of a file, in the order of its lines."""
    tree = ast.parse(source)
    found: dict[tuple[int, int, str], Mutation] = {}
    places = _Places(source)
    for node in _formulas(tree):
        for start, end, new, kind in _changes(node, places):
            mutation = replaced(file, source, start, end, new, kind, tree)
            if mutation.before != mutation.after:
                found.setdefault((start, end, new), mutation)
    return sorted(found.values(), key=lambda m: (m.start, m.end, m.new))


class _Places:
    """Byte offsets of nodes."""

    def __init__(self, source: bytes) -> None:
        self.source = source
        self.lines = [0, *(m.end() for m in re.finditer(b"\n", source))]

    def of(self, node: ast.AST) -> tuple[int, int]:
        start = self.lines[getattr(node, "lineno") - 1] + getattr(node, "col_offset")  # noqa: B009
        return start, self.lines[getattr(node, "end_lineno") - 1] + getattr(node, "end_col_offset")  # noqa: B009

    def text(self, node: ast.AST) -> str:
        start, end = self.of(node)
        return self.source[start:end].decode()

    def token(self, left: ast.AST, right: ast.AST, token: str) -> tuple[int, int] | None:
        """Where the operator stands between two operands."""
        first, last = self.of(left)[1], self.of(right)[0]
        pattern = re.escape(token).replace(r"\ ", r"\s+")
        pattern = rf"\b{pattern}\b" if token[0].isalpha() else pattern
        match = re.search(pattern.encode(), self.source[first:last])
        return None if match is None else (first + match.start(), first + match.end())


def _blank(text: str) -> str:
    return " ".join(text.split())


def _formulas(node: ast.AST) -> Iterator[ast.AST]:
    """Nodes that compute something: no annotations, texts, messages, decorators, imports or types."""
    if isinstance(node, ast.Raise | ast.Assert | ast.JoinedStr | ast.Import | ast.ImportFrom | ast.Global):
        return
    if isinstance(node, ast.If) and ast.unparse(node.test).startswith(("TYPE_CHECKING", "__name__ ==")):
        return
    yield node
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "bases"):
            continue
        if isinstance(node, ast.keyword) and node.arg in SILENT:
            continue
        if isinstance(node, ast.Call) and name in ("args", "keywords") and _called(node) == "warn":
            continue
        children = value if isinstance(value, list) else [value]
        for child in children:
            if isinstance(child, ast.AST):
                yield from _formulas(child)


Change = tuple[int, int, str, str]


def _changes(node: ast.AST, places: _Places) -> Iterator[Change]:
    if isinstance(node, ast.BinOp):
        yield from _arithmetic(node, places)
    elif isinstance(node, ast.Compare):
        yield from _comparison(node, places)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not | ast.Invert):
        kind = "dropped sign" if isinstance(node.op, ast.USub) else "dropped not"
        yield *places.of(node), f"({places.text(node.operand)})", kind
    elif isinstance(node, ast.BoolOp):
        token, other = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
        for left, right in zip(node.values, node.values[1:], strict=False):
            where = places.token(left, right, token)
            if where is not None:
                yield *where, other, "and for or"
    elif isinstance(node, ast.Constant):
        yield from ((*places.of(node), new, "constant") for new in _constants(node.value))
    elif isinstance(node, ast.Attribute) and node.attr == "T" and _one_line(node):
        yield *places.of(node), f"({places.text(node.value)})", "dropped transpose"
    elif isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Slice):
        for bound in (node.slice.lower, node.slice.upper, node.slice.step):
            if bound is not None:
                yield *places.of(bound), "", "dropped bound"
    elif isinstance(node, ast.Call) and _one_line(node):
        yield from _calls(node, places)
    elif isinstance(node, ast.IfExp | ast.If | ast.While) and isinstance(
        node.test, ast.Name | ast.Attribute | ast.Call
    ):
        yield *places.of(node.test), f"(not {places.text(node.test)})", "negated condition"
    elif isinstance(node, ast.stmt):
        yield from _statements(node, places)


def _arithmetic(node: ast.BinOp, places: _Places) -> Iterator[Change]:
    texts = (ast.JoinedStr, ast.List, ast.Tuple, ast.ListComp)
    for side in (node.left, node.right):
        if isinstance(side, texts) or (isinstance(side, ast.Constant) and isinstance(side.value, str | bytes | None)):
            return
    if isinstance(node.op, ast.MatMult) and _one_line(node):
        left, right = places.text(node.left), places.text(node.right)
        yield *places.of(node), f"({right}) @ ({left})", "swapped product"
        yield *places.of(node), f"({left})", "dropped factor"
    tokens = {**SIGNS, **LOGIC}.get(type(node.op))
    if tokens is None or ast.unparse(node).startswith(("str |", "Sequence[")):
        return
    where = places.token(node.left, node.right, tokens[0])
    if where is not None:
        yield *where, tokens[1], "operator"
    if _one_line(node) and not isinstance(node.op, ast.Pow):
        kind = "dropped term" if isinstance(node.op, ast.Add | ast.Sub) else "dropped factor"
        yield *places.of(node), f"({places.text(node.left)})", kind
        if isinstance(node.op, ast.Mult | ast.Add):
            yield *places.of(node), f"({places.text(node.right)})", kind


def _comparison(node: ast.Compare, places: _Places) -> Iterator[Change]:
    for left, op, right in zip([node.left, *node.comparators], node.ops, node.comparators, strict=False):
        token, others = COMPARISONS[type(op)]
        where = places.token(left, right, token)
        if where is not None:
            yield from ((*where, other, "comparison") for other in others)


def _constants(value: object) -> list[str]:
    if isinstance(value, bool):
        return [str(not value)]
    if isinstance(value, int):
        return [str(value + 1), *([str(value - 1)] if value > 0 else [])]
    if isinstance(value, float):
        if value == 0.0:
            return ["1.0"]
        return [repr(value * 1e5 if abs(value) < 1e-3 else value * 2.0)]
    return {"left": ["'right'"], "right": ["'left'"]}.get(value, []) if isinstance(value, str) else []


def _calls(node: ast.Call, places: _Places) -> Iterator[Change]:
    name = _called(node)
    if name in SIBLINGS:
        function = node.func
        end = places.of(function)[1]
        yield end - len(name), end, SIBLINGS[name], "sibling function"
    plain = [places.text(a) for a in node.args if not isinstance(a, ast.Starred)]
    if name in ORDERED and len(plain) == len(node.args) >= 2:
        first, second = (places.of(a) for a in node.args[:2])
        between = places.source[first[1] : second[0]].decode()
        yield first[0], second[1], f"{plain[1]}{between}{plain[0]}", "swapped arguments"
    if name in WRAPPERS and plain:
        yield *places.of(node), f"({plain[0]})", "dropped function"


def _statements(node: ast.stmt, places: _Places) -> Iterator[Change]:
    if isinstance(node, ast.Return) and isinstance(node.value, ast.BinOp | ast.Subscript):
        if isinstance(node.value, ast.Subscript) or not _one_line(node.value):
            return
        yield *places.of(node.value), f"-({places.text(node.value)})", "negated result"
    elif isinstance(node, ast.AugAssign):
        signs = {ast.Add: ("+=", "-="), ast.Sub: ("-=", "+="), ast.Mult: ("*=", "/="), ast.Div: ("/=", "*=")}
        tokens = signs.get(type(node.op))
        where = None if tokens is None else places.token(node.target, node.value, tokens[0])
        if tokens is not None and where is not None:
            yield *where, tokens[1], "operator"
        yield *places.of(node), "pass", "dropped statement"
    elif isinstance(node, ast.Continue | ast.Break) or _only_acts(node):
        yield *places.of(node), "pass", "dropped statement"


def _only_acts(node: ast.stmt) -> bool:
    """A call or an assignment to entries: without it every name is still defined."""
    if isinstance(node, ast.Expr):
        return isinstance(node.value, ast.Call)
    return isinstance(node, ast.Assign) and all(isinstance(target, ast.Subscript) for target in node.targets)


def _called(node: ast.Call) -> str:
    function = node.func
    return function.id if isinstance(function, ast.Name) else getattr(function, "attr", "")


def _one_line(node: ast.expr) -> bool:
    return node.lineno == node.end_lineno


def _reach(tree: ast.Module, first: int, last: int) -> tuple[tuple[int, int] | None, tuple[str, ...]]:
    """Lines whose execution runs the statement at these lines; None and the names it defines if it runs at import."""
    inside: ast.FunctionDef | ast.AsyncFunctionDef | None = None
    statement: ast.stmt | None = None
    for node in ast.walk(tree):  # outer nodes come before inner ones
        if isinstance(node, ast.stmt) and node.lineno <= first and last <= (node.end_lineno or node.lineno):
            statement = node
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.body[0].lineno <= first:
                inside = node
    if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef) and inside is not statement:
        return (statement.body[0].lineno, statement.end_lineno or first), ()  # a default argument
    if inside is None or statement is None:
        targets = getattr(statement, "targets", [getattr(statement, "target", None)])
        return None, tuple(target.id for target in targets if isinstance(target, ast.Name))
    body = getattr(statement, "body", None)
    end = body[0].lineno - 1 if isinstance(body, list) and body[0].lineno > first else statement.end_lineno
    return (statement.lineno, max(end or last, last)), ()
