"""Copies of the project's own modules in a form that numba compiles.

Every function and method of a module becomes a compiled function of the same name (methods with
their class in front); classes stay the originals. Five things change on the way:

* lists of floats become vectors: a literal, a repeated value, a sum of lists, a slice (a copy, as
  with lists);
* a comprehension or generator expression becomes a function with a loop;
* `x in {a, b}` becomes comparisons;
* members of integer enumerations become their numbers;
* imports between translated modules lead to the copies.

The copies are files in a cache directory whose name depends on their content, so that numba's own
cache on disk works for them, and never serves the code of an older source.
"""

from __future__ import annotations

import ast
import enum
import hashlib
import importlib
import os
import sys
from collections.abc import Container, Iterable, Iterator
from pathlib import Path
from types import ModuleType

import numba

_HELPERS = "adaptdrive_sim.compiled.vectors"
_HEADER = f"""from __future__ import annotations
from {_HELPERS} import compiled as _compiled
from {_HELPERS} import copied as _copied, filled as _filled, joined as _joined, part as _part
from {_HELPERS} import inlined as _inlined, new_vector as _new, overwrite as _overwrite
"""

_EACH = """
@_inlined
def {name}({given}):
    _over = {over}
    _values, _n = _new(len(_over)), 0
    for {entry} in _over:
        _values[_n] = {value}
        _n += 1
    return _values
"""
_UNTIL = """
@_inlined
def {name}({given}):
    for {entry} in {over}:
        if bool({value}) is {found}:
            return {found}
    return not {found}
"""


def translate(names: Iterable[str], inlined: Container[str] = ()) -> dict[str, ModuleType]:
    """Compilable copies of modules.

    Args:
        names: Full names; imports among them are redirected.
        inlined: Those of them whose functions are compiled into their callers.

    Returns:
        The copies, by the name of the original.
    """
    originals = {name: importlib.import_module(name) for name in names}
    copies = {name: name.replace(".", "__") for name in originals}
    texts = {name: _translated(module, copies) for name, module in originals.items()}
    texts |= {name: _inlined(texts[name]) for name in texts if name in inlined}
    folder = _write(texts, copies)
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    return {name: importlib.import_module(copy) for name, copy in copies.items()}


def _inlined(text: str) -> str:
    """Return a copy whose functions are compiled into their callers."""
    plain = f"from {_HELPERS} import compiled as"
    return text.replace(plain, plain.replace("import compiled", "import inlined"), 1)


def _write(texts: dict[str, str], copies: dict[str, str]) -> Path:
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    for name in sorted(texts):
        digest.update(texts[name].encode())
    folder = cache_folder() / digest.hexdigest()[:16]
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        path = folder / f"{copies[name]}.py"
        if not path.exists():
            partial = path.with_suffix(f".{os.getpid()}")
            partial.write_text(text, encoding="utf-8")
            partial.replace(path)
    return folder


def cache_folder() -> Path:
    """Return the folder of translated sources and compiled code, kept between runs."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "adaptdrive" / "compiled"


def _source(module: ModuleType) -> str:
    """Return the Python source of a module, which lies next to a compiled module."""
    path = Path(str(module.__file__))
    return path.with_name(f"{path.name.partition('.')[0]}.py").read_text(encoding="utf-8")


def _translated(module: ModuleType, copies: dict[str, str]) -> str:
    tree = ast.parse(_source(module))
    body = [copy for node in tree.body for copy in _top_level(node, module, copies)]
    text = ast.unparse(ast.fix_missing_locations(ast.Module(body, [])))
    return f"{_HEADER}{text}\n"


def _top_level(node: ast.stmt, module: ModuleType, copies: dict[str, str]) -> Iterator[ast.stmt]:
    match node:
        case ast.ImportFrom(module="__future__"):
            pass
        case ast.ImportFrom():
            yield from _imports(node, copies)
        case ast.FunctionDef():
            yield from _function(node, node.name, module)
        case ast.ClassDef():
            yield ast.ImportFrom(module.__name__, [ast.alias(node.name)], 0)
            for part in node.body:
                if isinstance(part, ast.FunctionDef) and _is_compilable(part):
                    yield from _function(part, f"{node.name}__{part.name}", module)
        case ast.If() | ast.Expr():
            pass  # imports for type checkers, and descriptions
        case _:
            yield node


def _is_compilable(method: ast.FunctionDef) -> bool:
    """Methods and properties, but nothing that the class itself calls."""
    plain = all(
        isinstance(decorator, ast.Name) and decorator.id == "property"
        for decorator in method.decorator_list
    )
    return plain and not method.name.startswith("__")


def _imports(node: ast.ImportFrom, copies: dict[str, str]) -> Iterator[ast.stmt]:
    """`from package import module` and `from module import name`, redirected where translated."""
    for alias in node.names:
        whole = f"{node.module}.{alias.name}"
        if whole in copies:
            yield ast.Import([ast.alias(copies[whole], alias.asname or alias.name)])
        else:
            yield ast.ImportFrom(copies.get(str(node.module), node.module), [alias], node.level)


def _function(node: ast.FunctionDef, name: str, module: ModuleType) -> list[ast.stmt]:
    arguments = node.args
    for argument in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs):
        argument.annotation = None
    arguments.args, arguments.kwonlyargs = [*arguments.args, *arguments.kwonlyargs], []
    arguments.defaults = [*arguments.defaults, *(d for d in arguments.kw_defaults if d)]
    arguments.kw_defaults = []
    if ast.get_docstring(node) is not None:
        del node.body[0]  # another description is no reason to compile again
        node.body = node.body or [ast.Pass()]
    body = _Body(module, node, name)
    copy: ast.FunctionDef = body.visit(node)
    copy.name, copy.returns = name, None
    copy.decorator_list = [ast.Name("_compiled", ast.Load())]
    return [*body.loops, copy]


class _Body(ast.NodeTransformer):
    """Rewrites lists and enumerations in one function.

    Attributes:
        loops: Functions that its comprehensions have become.
    """

    def __init__(self, module: ModuleType, node: ast.FunctionDef, name: str) -> None:
        self.loops: list[ast.stmt] = []
        self._module, self._name = module, name
        self._locals = {one.arg for one in node.args.args} | _names(node, ast.Store)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        if node.value is None:
            return ast.Pass()
        return ast.Assign([node.target], self.visit(node.value))

    def visit_List(self, node: ast.List) -> ast.AST:
        if not isinstance(node.ctx, ast.Load):
            return self.generic_visit(node)
        parts = [self._part(part) for part in _runs(node.elts)]
        result = parts[0]
        for part in parts[1:]:
            result = _call("_joined", result, part)
        return result

    def _part(self, part: list[ast.expr]) -> ast.expr:
        if isinstance(part[0], ast.Starred):
            return _call("_copied", self.visit(part[0].value))
        return _call("_copied", ast.Tuple([self.visit(one) for one in part], ast.Load()))

    def visit_ListComp(self, node: ast.ListComp | ast.GeneratorExp) -> ast.AST:
        return self._loop(_EACH, node)

    def visit_GeneratorExp(self, node: ast.GeneratorExp) -> ast.AST:
        return self._loop(_EACH, node)

    def _loop(self, text: str, node: ast.ListComp | ast.GeneratorExp, found: str = "") -> ast.AST:
        """Make a function of a comprehension, and return its call."""
        self.generic_visit(node)
        (over,) = node.generators
        given = sorted((self._locals & _names(node, ast.Load)) - _names(over.target, ast.Store))
        name = f"{self._name}_{len(self.loops)}"
        parts = {"entry": over.target, "over": over.iter, "value": node.elt}
        shown = {part: ast.unparse(tree) for part, tree in parts.items()}
        text = text.format(name=name, given=", ".join(given), found=found, **shown)
        self.loops.append(ast.parse(text).body[0])
        return _call(name, *(ast.Name(one, ast.Load()) for one in given))

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        self.generic_visit(node)
        match node.ops, node.comparators:
            case [ast.In()], [ast.Set(members) | ast.Tuple(members)]:
                same = [ast.Compare(node.left, [ast.Eq()], [member]) for member in members]
                return ast.BoolOp(ast.Or(), [*same])
        return node

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        left, right = node.left, node.right
        if isinstance(node.op, ast.Mult):
            if isinstance(right, ast.List):
                left, right = right, left
            if isinstance(left, ast.List) and len(left.elts) == 1:
                return _call("_filled", self.visit(left.elts[0]), self.visit(right))
        if isinstance(node.op, ast.Add) and (_is_list(left) or _is_list(right)):
            return _call("_joined", self.visit(left), self.visit(right))
        return self.generic_visit(node)

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        self.generic_visit(node)
        if isinstance(node.slice, ast.Slice) and isinstance(node.ctx, ast.Load):
            return _call("_part", node.value, *_ends(node.slice))
        return node

    def visit_Assign(self, node: ast.Assign) -> ast.AST:
        self.generic_visit(node)
        match node.targets:
            case [ast.Subscript(values, ast.Slice() as place)]:
                return ast.Expr(_call("_overwrite", values, *_ends(place), node.value))
        return node

    def visit_Call(self, node: ast.Call) -> ast.AST:
        match node:
            case ast.Call(ast.Name("any" | "all" as name), [ast.GeneratorExp() as each]):
                return self._loop(_UNTIL, each, str(name == "any"))
        self.generic_visit(node)
        if isinstance(node.func, ast.Name) and node.func.id == "list" and len(node.args) == 1:
            return _call("_copied", node.args[0])
        return node

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        member = self._resolve(node)
        if isinstance(member, enum.IntEnum):
            return ast.Constant(int(member))
        return self.generic_visit(node)

    def _resolve(self, node: ast.expr) -> object:
        """The object that a dotted name of the module stands for, None if it is not one."""
        if isinstance(node, ast.Name):
            return vars(self._module).get(node.id)
        if isinstance(node, ast.Attribute):
            return getattr(self._resolve(node.value), node.attr, None)
        return None


def _runs(elements: list[ast.expr]) -> Iterator[list[ast.expr]]:
    """Elements of a list display, starred ones apart."""
    run: list[ast.expr] = []
    for element in elements:
        if isinstance(element, ast.Starred):
            if run:
                yield run
            yield [element]
            run = []
        else:
            run.append(element)
    if run:
        yield run


def _is_list(node: ast.expr) -> bool:
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult | ast.Add):
        return _is_list(node.left) or _is_list(node.right)
    return isinstance(node, ast.List | ast.ListComp)


def _ends(place: ast.Slice) -> Iterator[ast.expr]:
    return (end or ast.Constant(None) for end in (place.lower, place.upper))


def _names(tree: ast.AST, use: type[ast.expr_context]) -> set[str]:
    """Names that are read, or written, somewhere in a tree."""
    found = (node for node in ast.walk(tree) if isinstance(node, ast.Name))
    return {node.id for node in found if isinstance(node.ctx, use)}


def _call(name: str, *arguments: ast.expr) -> ast.Call:
    return ast.Call(ast.Name(name, ast.Load()), list(arguments), [])
