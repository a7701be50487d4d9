"""Small faults that can be put into a source file, as edits of its text.

Where they stand is read from the syntax tree. Texts in quotes, annotations, decorators, imports and tolerances of
rounding (constants below 1e-5) stay as they are, and so do exchanges that no run could survive (a text for a number).
"""

import ast
import copy
from collections.abc import Iterator
from typing import Any, NamedTuple

OPERATORS = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.And: ast.Or, ast.Or: ast.And,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult,
    ast.Pow: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
}  # fmt: skip
PAIRS = (
    "min max", "minimum maximum", "argmin argmax", "nanmin nanmax", "any all", "floor ceil", "sin cos", "sum mean",
    "cumsum cumprod", "zeros ones",
)  # fmt: skip
NAMES = {a: b for pair in PAIRS for a, b in (pair.split(), reversed(pair.split()))} | {"median": "max"}
SMALLEST = 1e-5
UNTOUCHED = ("annotation", "returns", "decorator_list", "bases", "ctx")


class Fault(NamedTuple):
    """One edit: `text[start:end]` of the file at `path` (its lines `line` to `last`) becomes `new`."""

    path: str
    line: int
    last: int
    kind: str
    start: int
    end: int
    new: str

    def put_into(self, text: str) -> str:
        return text[: self.start] + self.new + text[self.end :]

    def is_one(self, text: str) -> bool:
        """With it the file is Python still, and not the same as before."""
        try:
            return ast.dump(ast.parse(self.put_into(text))) != ast.dump(ast.parse(text))
        except SyntaxError:
            return False


def faults_of(path: str, text: str) -> list[Fault]:
    """Every fault that can be put into this file, in the order of the text; a few are not Python (see `is_one`)."""
    starts, lines = [0], text.splitlines(keepends=True)
    for line in lines:
        starts.append(starts[-1] + len(line))

    def offset(line: int, column: int) -> int:  # columns of the tree count bytes
        return starts[line - 1] + len(lines[line - 1].encode()[:column].decode())

    found = []
    for node in _visited(ast.parse(text)):
        for kind, new in _changes(node):
            start, end = offset(node.lineno, node.col_offset), offset(node.end_lineno, node.end_col_offset)
            bare = isinstance(new, ast.stmt | ast.Constant | ast.keyword)
            said = ast.unparse(new) if bare else f"({ast.unparse(new)})"
            found.append(Fault(path, node.lineno, node.end_lineno, kind, start, end, said))
    return sorted(found, key=lambda f: (f.start, f.end, f.new))


def _visited(tree: ast.Module) -> Iterator[Any]:
    stack: list[ast.AST] = list(tree.body)
    while stack:
        node = stack.pop()
        said = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if said or isinstance(node, ast.JoinedStr | ast.Import | ast.ImportFrom | ast.Assert | ast.arg):
            continue
        yield node
        for name, value in ast.iter_fields(node):
            below = value if isinstance(value, list) else [value]
            stack += [child for child in below if isinstance(child, ast.AST) and name not in UNTOUCHED]


def _with(node: ast.AST, **fields: Any) -> ast.AST:
    new = copy.copy(node)
    for name, value in fields.items():
        setattr(new, name, value)
    return new


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


def _of_another_kind(node: ast.AST) -> bool:
    return _is_text(node) or isinstance(node, ast.Tuple | ast.Lambda | ast.Starred)


def _changes(node: Any) -> Iterator[tuple[str, ast.AST]]:
    match node:
        case ast.Compare(ops=[op, *rest]) if type(op) in OPERATORS:
            yield "comparison", _with(node, ops=[OPERATORS[type(op)](), *rest])
        case ast.BinOp(op=op) if type(op) in OPERATORS and not _is_text(node.left) and not _is_text(node.right):
            yield "arithmetic", _with(node, op=OPERATORS[type(op)]())
        case ast.BoolOp(op=op):
            yield "and, or", _with(node, op=OPERATORS[type(op)]())
        case ast.UnaryOp(op=ast.USub() | ast.Not() | ast.Invert(), operand=operand):
            yield "sign, not", operand
        case ast.Constant(value=bool(value)):
            yield "constant", _with(node, value=not value)
        case ast.Constant(value=int(value)):
            yield "constant", _with(node, value=value + 1)
        case ast.Constant(value=float(value)) if value == 0.0 or abs(value) >= SMALLEST:
            yield "constant", _with(node, value=2.0 * value or 1.0)
        case ast.keyword(arg="axis", value=ast.Constant(value=0 | 1 as axis)):
            yield "axis", _with(node, value=ast.Constant(1 - axis))
        case ast.Name(id=name, ctx=ast.Load()) if name in NAMES:
            yield "name", _with(node, id=NAMES[name])
        case ast.Attribute(attr=name, ctx=ast.Load()) if name in NAMES:
            yield "name", _with(node, attr=NAMES[name])
        case ast.Call(args=[a, b, *rest]) if not (_of_another_kind(a) or _of_another_kind(b)):
            yield "arguments", _with(node, args=[b, a, *rest])
        case (
            ast.Assign(targets=[ast.Attribute() | ast.Subscript()])
            | ast.AugAssign()
            | ast.Expr()
            | ast.Raise()
            | ast.Continue()
            | ast.Break()
            | ast.Return()
        ):
            yield "statement", ast.Pass()
