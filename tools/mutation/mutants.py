"""Small changes of a module's code, each of which a test should notice.

A mutant is one changed function, or one changed number of the module. Texts, annotations and
defaults stay as they are.
"""

from __future__ import annotations

import ast
import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass

COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
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
ARITHMETIC: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
}
OPPOSITE = {"min": "max", "max": "min", "any": "all", "all": "any"}

Function = ast.FunctionDef | ast.AsyncFunctionDef
Edit = Callable[[ast.AST], ast.AST | None]
"""Changes a copy of a node in place, or returns its replacement."""


Place = tuple[str, ast.stmt, ast.AST, Edit]
"""Function, statement, node, and its edit."""


@dataclass(frozen=True, slots=True)
class Mutant:
    """One change.

    Attributes:
        module: Name of the module.
        function: Qualified name of the changed function, empty for a number of the module.
        lines: First and last line of the statement that changes.
        change: What it was and what it is, in one line.
        tree: The changed module.
    """

    module: str
    function: str
    lines: tuple[int, int]
    change: str
    tree: ast.Module

    @property
    def name(self) -> str:
        """Names it, whatever line it is on."""
        return f"{self.module.removeprefix('adaptdrive.')}:{self.function}: {self.change}"


def mutants(module: str, source: str) -> list[Mutant]:
    """Return all mutants of a module, in the order of its lines."""
    tree = ast.parse(source)
    found = [_mutant(module, tree, place) for place in _places(tree)]
    unique = {(one.name, one.lines): one for one in found}
    return sorted(unique.values(), key=lambda one: one.lines)


def _places(tree: ast.Module) -> Iterator[Place]:
    """Yield function, statement, node and edit of each mutant."""
    for statement in tree.body:
        if isinstance(statement, ast.Assign | ast.AnnAssign) and statement.value is not None:
            for node in ast.walk(statement.value):
                yield from (("", statement, node, edit) for edit in _numbers(node))
    for name, function in _functions(tree, ""):
        for statement in _statements(function.body):
            for node, edit in _edits(statement):
                yield name, statement, node, edit


def _functions(node: ast.AST, prefix: str) -> Iterator[tuple[str, Function]]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.ClassDef):
            yield from _functions(child, f"{prefix}{child.name}.")
        elif isinstance(child, Function):
            yield prefix + child.name, child


def _statements(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    for statement in body:
        if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant):
            continue  # a docstring
        yield statement
        for child in ast.iter_child_nodes(statement):
            if isinstance(child, ast.ExceptHandler | ast.match_case):
                yield from _statements(child.body)
        for part in ("body", "orelse", "finalbody"):
            yield from _statements(getattr(statement, part, []))


def _edits(statement: ast.stmt) -> Iterator[tuple[ast.AST, Edit]]:
    yield from ((statement, edit) for edit in _removals(statement))
    for node in _expressions(statement):
        yield from ((node, edit) for edit in _swaps(node))
        yield from ((node, edit) for edit in _numbers(node))


def _expressions(statement: ast.stmt) -> Iterator[ast.expr]:
    """Yield the expressions of a statement, without those of the statements within it."""
    annotation = getattr(statement, "annotation", None)
    todo: list[ast.AST] = [statement]
    while todo:
        for child in ast.iter_child_nodes(todo.pop()):
            if isinstance(child, ast.withitem | ast.keyword | ast.comprehension):
                todo.append(child)
            elif isinstance(child, ast.expr) and child is not annotation:
                todo.append(child)
                yield child


def _removals(statement: ast.stmt) -> Iterator[Edit]:
    match statement:
        case ast.Expr() | ast.Raise() | ast.AugAssign():
            yield lambda _: ast.Pass()
        case ast.Assign(targets=[ast.Attribute() | ast.Subscript()]):
            yield lambda _: ast.Pass()
        case ast.Return(value=ast.expr() as value) if not _is_none(value):
            yield lambda _: ast.Return(ast.Constant(None))
        case ast.If(test=test) | ast.While(test=test) if not isinstance(test, ast.Compare):
            yield _negate_test


def _is_none(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and node.value is None


def _negate_test(node: ast.AST) -> None:
    assert isinstance(node, ast.If | ast.While)
    node.test = ast.UnaryOp(ast.Not(), node.test)


def _swaps(node: ast.expr) -> Iterator[Edit]:
    match node:
        case ast.Compare(ops=ops):
            for number, op in enumerate(ops):
                for other in COMPARISONS[type(op)]:
                    yield _set_item("ops", number, other())
        case ast.BoolOp(op=ast.And()):
            yield _set("op", ast.Or())
        case ast.BoolOp(op=ast.Or()):
            yield _set("op", ast.And())
        case ast.UnaryOp(op=ast.Not() | ast.USub(), operand=operand):
            yield lambda _, kept=operand: copy.deepcopy(kept)  # type: ignore[misc]
        case ast.BinOp(op=op) if type(op) in ARITHMETIC:
            yield _set("op", ARITHMETIC[type(op)]())
        case ast.Call(func=ast.Name(id=called)) if called in OPPOSITE:
            yield _set("func", ast.Name(OPPOSITE[called], ast.Load()))
        case ast.IfExp(body=body, orelse=other):
            yield lambda _, kept=body: copy.deepcopy(kept)  # type: ignore[misc]
            yield lambda _, kept=other: copy.deepcopy(kept)  # type: ignore[misc]


def _numbers(node: ast.AST) -> Iterator[Edit]:
    if not isinstance(node, ast.Constant):
        return
    value = node.value
    if isinstance(value, bool):
        yield _set("value", not value)
    elif isinstance(value, int | float):
        yield _set("value", value + 1)
        if value:
            yield _set("value", value * 2)


def _set(field: str, value: object) -> Edit:
    return lambda node: setattr(node, field, value)


def _set_item(field: str, number: int, value: object) -> Edit:
    return lambda node: getattr(node, field).__setitem__(number, value)


def _mutant(module: str, tree: ast.Module, place: Place) -> Mutant:
    function, statement, node, edit = place
    memo: dict[int, object] = {}
    changed = copy.deepcopy(tree, memo)
    twin = memo[id(node)]
    assert isinstance(twin, ast.AST)
    replacement = edit(twin)
    here = memo[id(statement)]
    assert isinstance(here, ast.stmt)
    if replacement is not None:
        _Replacer(twin, replacement).visit(changed)
        here = replacement if twin is here and isinstance(replacement, ast.stmt) else here
    change = f"{_head(statement)} -> {_head(here)}"
    lines = statement.lineno, _last_line(statement)
    return Mutant(module, function, lines, change, ast.fix_missing_locations(changed))


def _head(statement: ast.stmt) -> str:
    """A statement in one line, without the statements within it."""
    return " ".join(ast.unparse(statement).splitlines()[0].split())


def _last_line(statement: ast.stmt) -> int:
    body = getattr(statement, "body", None)
    last = statement.end_lineno or statement.lineno
    return max(statement.lineno, body[0].lineno - 1) if isinstance(body, list) and body else last


class _Replacer(ast.NodeTransformer):
    def __init__(self, old: ast.AST, new: ast.AST) -> None:
        self._old, self._new = old, new

    def visit(self, node: ast.AST) -> ast.AST:
        """Return the node, replaced where it is the one."""
        return self._new if node is self._old else self.generic_visit(node)
