"""Constants of the controller that are given other values while a program runs.

Compiled modules have the values of their constants in their code: only the sources can be turned.
"""

from __future__ import annotations

import ast
import inspect
import sys
from dataclasses import dataclass
from functools import cache
from types import ModuleType

from adaptdrive import build_name
from tools.builds.run import PURE
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


def turn(dial: Dial, value: Number) -> None:
    """Give a constant another value, and those that are computed from it theirs.

    Raises:
        RuntimeError: The modules are compiled.
    """
    if build_name() != PURE:
        raise RuntimeError("the constants of compiled modules cannot be turned: ADAPTDRIVE_PURE=1")
    _set(dial, value)
    for _ in _FOLLOWING:  # one may be computed from another
        if not _follow():
            return


def _follow() -> bool:
    """Compute the constants that follow from others; whether any has changed."""
    changed = False
    for dial in _FOLLOWING:
        names = vars(sys.modules[dial.module])
        value = eval(dial.constant.value, dict(names))  # an expression of the project's own source
        if value != names[dial.name]:
            _set(dial, value)
            changed = True
    return changed


def _set(dial: Dial, value: Number) -> None:
    """Give a constant a value in every module that knows it."""
    for name, module in list(sys.modules.items()):
        if name == dial.module or _imports(module, dial):
            setattr(module, dial.name, value)


def _imports(module: ModuleType, dial: Dial) -> bool:
    known = (getattr(module, "__package__", None) or "").startswith("adaptdrive")
    return known and _origins(module).get(dial.name) == dial.module


@cache
def _origins(module: ModuleType) -> dict[str, str]:
    """Return where the imported names of a module come from."""
    tree = ast.parse(inspect.getsource(module)) if module.__file__ else ast.Module([], [])
    return {
        alias.asname or alias.name: str(node.module)
        for node in tree.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
