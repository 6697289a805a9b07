"""What may be changed in a source file: one expression or statement at a time."""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeVar

Node = TypeVar("Node", bound=ast.AST)

_COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
_ARITHMETIC: dict[type[ast.operator], tuple[type[ast.operator], ...]] = {
    ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,),
    ast.Mult: (ast.Div, ast.Add),
    ast.Div: (ast.Mult,),
    ast.FloorDiv: (ast.Mult,),
    ast.Mod: (ast.Add,),
    ast.Pow: (ast.Mult,),
    ast.BitAnd: (ast.BitOr,),
    ast.BitOr: (ast.BitAnd,),
}
_PAIRS = (
    ("min", "max"), ("minimum", "maximum"), ("argmin", "argmax"), ("any", "all"), ("floor", "ceil"), ("zeros", "ones"),
)  # fmt: skip
_SWAPPED = {one: other for pair in _PAIRS for one, other in (pair, pair[::-1])}
_WRAPPERS = {
    "abs", "clip", "copy", "exp", "log", "log1p", "max", "maximum", "min", "minimum", "nan_to_num", "remainder",
    "reversed", "round", "sign", "sorted", "sqrt", "tanh",
}  # fmt: skip
_WITHOUT_EFFECT = {"strict", "optimize"}  # keywords that check or hasten a call of numpy or zip that is right
_NOT_CODE = {"annotation", "returns", "decorator_list", "type_comment"}


@dataclass(frozen=True, order=True, kw_only=True)
class Mutant:
    """A fault: the text from ``start`` to before ``stop`` of a file, in bytes, reads ``new`` instead of ``old``.

    ``lines`` are those from the beginning of the statement to the end of that text.
    """

    path: str
    lines: tuple[int, int]
    line: int
    start: int
    stop: int
    old: str
    new: str

    def applied(self, source: str) -> str:
        """The file's text with the fault."""
        data = source.encode()
        return (data[: self.start] + self.new.encode() + data[self.stop :]).decode()


def mutants(path: str, source: str) -> list[list[Mutant]]:
    """All faults of a file, those at the same place of it together."""
    starts = [0]
    for line in source.encode().splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    found = []
    for first, node, changed in _changes(ast.parse(source), 1):
        begin, end = starts[node.lineno - 1] + node.col_offset, starts[node.end_lineno - 1] + node.end_col_offset
        place = {"path": path, "lines": (first, node.end_lineno), "line": node.lineno, "start": begin, "stop": end}
        old = source.encode()[begin:end].decode()
        texts = dict.fromkeys(text for text in changed if text not in (old, f"({old})"))
        if texts:
            found.append([Mutant(**place, old=old, new=text) for text in texts])
    return found


def _changes(tree: ast.AST, first: int) -> Iterator[tuple[int, ast.AST, list[str]]]:
    """Every node that may be changed, with the ``first`` line of its statement and the texts that may stand in its
    place."""
    first = tree.lineno if isinstance(tree, ast.stmt) else first
    for name, value in ast.iter_fields(tree):
        if name in _NOT_CODE:
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.JoinedStr) or not isinstance(child, ast.AST) or _is_left_out(child):
                continue
            if isinstance(child, ast.stmt):
                yield child.lineno, child, _statements(child)
            elif isinstance(child, ast.expr):
                texts = [_text(other) for other in (*_conditions(child), *_values(child))]
                if name == "test" and not isinstance(child, ast.UnaryOp):
                    texts.append(f"(not ({ast.unparse(child)}))")
                yield first, child, texts
            if not isinstance(child, ast.Raise):
                yield from _changes(child, first)


def _text(node: ast.expr) -> str:
    """In brackets, as it stands among other operators."""
    text = ast.unparse(node)
    return text if isinstance(node, ast.Slice | ast.Name | ast.Attribute) else f"({text})"


def _is_left_out(node: ast.AST) -> bool:
    if isinstance(node, ast.keyword):
        return node.arg in _WITHOUT_EFFECT
    if isinstance(node, ast.AnnAssign):
        return node.value is None or ast.unparse(node.annotation) == "TypeAlias"
    return isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__"


def _statements(node: ast.stmt) -> list[str]:
    """What may stand in the place of a statement."""
    if isinstance(node, ast.Return) and node.value is not None:
        return [] if isinstance(node.value, ast.Constant) else ["return None"]
    is_text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    on_a_part = isinstance(node, ast.Assign) and not isinstance(node.targets[0], ast.Name | ast.Tuple)
    if isinstance(node, ast.AugAssign):
        swapped = [_with(node, op=other()) for other in _ARITHMETIC.get(type(node.op), ())]
        return ["pass", *(ast.unparse(other) for other in swapped)]
    removable = isinstance(node, ast.Expr | ast.Raise | ast.Continue | ast.Break | ast.Delete) and not is_text
    return ["pass"] if removable or on_a_part else []


def _conditions(node: ast.expr) -> Iterator[ast.expr]:
    """What may stand in the place of a condition."""
    match node:
        case ast.Compare(ops=[op]):
            yield from (_with(node, ops=[other()]) for other in _COMPARISONS[type(op)])
        case ast.Compare(ops=ops):
            for place, op in enumerate(ops):
                yield _with(node, ops=[*ops[:place], _COMPARISONS[type(op)][0](), *ops[place + 1 :]])
        case ast.BoolOp(op=op):
            yield _with(node, op=ast.Or() if isinstance(op, ast.And) else ast.And())
        case ast.UnaryOp(op=ast.Not() | ast.Invert(), operand=operand):
            yield operand
        case ast.Constant(value=bool() as value):
            yield ast.Constant(not value)
        case ast.GeneratorExp() | ast.ListComp() | ast.SetComp() | ast.DictComp():
            for place, part in enumerate(node.generators):
                if part.ifs:
                    rest = [*node.generators[:place], _with(part, ifs=[]), *node.generators[place + 1 :]]
                    yield _with(node, generators=rest)


def _values(node: ast.expr) -> Iterator[ast.expr]:
    """What may stand in the place of a number, a slice or a call."""
    match node:
        case ast.BinOp(op=op):
            yield from (_with(node, op=other()) for other in _ARITHMETIC.get(type(op), ()))
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            yield operand
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            yield from (ast.Constant(other) for other in (2 * value, value + 1, 0 * value, -value) if other != value)
        case ast.Slice(lower=lower, upper=upper):
            one = ast.Constant(1)
            if lower is not None and not isinstance(lower, ast.Constant):
                yield _with(node, lower=ast.BinOp(lower, ast.Add(), one))
            if upper is not None and not isinstance(upper, ast.Constant):
                yield _with(node, upper=ast.BinOp(upper, ast.Sub(), one))
        case ast.Call():
            yield from _calls(node)


def _calls(node: ast.Call) -> Iterator[ast.expr]:
    """Another function of the same kind, or its argument alone."""
    function = node.func
    name = function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")
    if name in _SWAPPED:
        renamed = {"attr": _SWAPPED[name]} if isinstance(function, ast.Attribute) else {"id": _SWAPPED[name]}
        yield _with(node, func=_with(function, **renamed))
    if name in _WRAPPERS:
        is_method = isinstance(function, ast.Attribute) and ast.unparse(function.value) != "np"
        yield from [function.value] if is_method else node.args[:2] if name in _SWAPPED else node.args[:1]


def _with(node: Node, **fields: object) -> Node:
    """A copy of a node with other fields."""
    result = copy.copy(node)
    for name, value in fields.items():
        setattr(result, name, value)
    return result
