"""Constants of the controller that a compiled campaign reads at run time.

Numba freezes the constants of a module when it compiles. Here each chosen constant of
`adaptdrive.control` becomes a load from memory instead, so that one compilation serves every value.
The copies refer to memory of this process: use a cache folder of its own.
"""

from __future__ import annotations

import ast
import sys
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from adaptdrive_sim.compiled import translate
from tools.pages.constants_page import Constant, constants, following, module_name, value_of

Number = int | float


@dataclass(frozen=True, slots=True)
class Dial:
    """One constant.

    Attributes:
        constant: What the page of the constants says.
        module: Full name of its module.
        value: What the code has.
    """

    constant: Constant
    module: str
    value: Number

    @property
    def name(self) -> str:
        """Name in its module."""
        return self.constant.name


def _dial(constant: Constant) -> Dial:
    value = value_of(constant)
    assert isinstance(value, int | float)
    return Dial(constant, module_name(constant), value)


DIALS = [_dial(one) for one in constants()]
_FOLLOWING = [_dial(one) for one in following() if isinstance(value_of(one), int | float)]
_ALL = [*DIALS, *_FOLLOWING]
_WORDS = np.zeros(len(_ALL), np.int64)
_FLOATS = _WORDS.view(np.float64)


def turn(place: int, value: Number) -> None:
    """Give a constant another value, and those that are computed from it theirs."""
    _set(place, value)
    for _ in _FOLLOWING:  # one may be computed from another
        if not _follow():
            return


def _follow() -> bool:
    """Compute the constants that follow from others; whether any has changed."""
    changed = False
    for place, dial in enumerate(_FOLLOWING, len(DIALS)):
        names = vars(sys.modules[dial.module])
        value = eval(dial.constant.value, dict(names))  # an expression of the project's own source
        if value != names[dial.name]:
            _set(place, value)
            changed = True
    return changed


def _set(place: int, value: Number) -> None:
    """Give a constant a value, in compiled copies and in every module that knows it."""
    dial = _ALL[place]
    (_WORDS if isinstance(dial.value, int) else _FLOATS)[place] = value
    for name, module in list(sys.modules.items()):
        if name == dial.module or _imports(module, dial):
            setattr(module, dial.name, value)


def _imports(module: ModuleType, dial: Dial) -> bool:
    known = (getattr(module, "__package__", None) or "").startswith("adaptdrive")
    return known and _origins(module).get(dial.name) == dial.module


def _origins(module: ModuleType) -> dict[str, str]:
    """Return where the imported names of a module come from."""
    tree = ast.parse(translate._source(module))
    return {
        alias.asname or alias.name: str(node.module)
        for node in tree.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }


def read(place: int) -> Any:
    """Return a compiled function that gives the present value of a constant."""
    whole = isinstance(_ALL[place].value, int)
    address = _WORDS.ctypes.data + 8 * place

    @intrinsic
    def load(_: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            word = ir.IntType(64) if whole else ir.DoubleType()
            return builder.load(ir.Constant(ir.IntType(64), address).inttoptr(word.as_pointer()))

        return (types.int64 if whole else types.float64)(), generate

    loaded: Any = load

    def value() -> Any:
        return loaded()

    return numba.njit(value)


def install() -> None:
    """Have the copies that are made from now on read their constants from memory."""
    plain = translate._translated

    def translated(module: ModuleType, copies: dict[str, str]) -> str:
        return _tunable(plain(module, copies), module)

    translate._translated = translated
    for place, dial in enumerate(_ALL):
        _set(place, dial.value)


def _tunable(text: str, module: ModuleType) -> str:
    origins = _origins(module)
    here = {
        dial.name: place
        for place, dial in enumerate(_ALL)
        if module.__name__ == dial.module or origins.get(dial.name) == dial.module
    }
    reads = _Reads(here, module)
    tree = ast.parse(text)
    tree.body = [reads.visit(one) if isinstance(one, ast.FunctionDef) else one for one in tree.body]
    lines = [f"_dial_{place} = _read({place})" for place in sorted(reads.used)]
    first = ["from __future__ import annotations", f"from {__name__} import read as _read"]
    return "\n".join([*first, *lines, ast.unparse(ast.fix_missing_locations(tree)), ""]).replace(
        "\nfrom __future__ import annotations", "", 1
    )


class _Reads(ast.NodeTransformer):
    """Turns the names of constants into calls."""

    def __init__(self, here: dict[str, int], module: ModuleType) -> None:
        self._here, self._module = here, module
        self._places = {(dial.module, dial.name): place for place, dial in enumerate(_ALL)}
        self.used: set[int] = set()

    def visit_Name(self, node: ast.Name) -> ast.AST:
        if node.id in self._here and isinstance(node.ctx, ast.Load):
            return self._call(self._here[node.id])
        return node

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        if isinstance(node.value, ast.Name):
            owner = vars(self._module).get(node.value.id)
            place = self._places.get((getattr(owner, "__name__", ""), node.attr))
            if place is not None:
                return self._call(place)
        return self.generic_visit(node)

    def _call(self, place: int) -> ast.Call:
        self.used.add(place)
        return ast.Call(ast.Name(f"_dial_{place}", ast.Load()), [], [])
