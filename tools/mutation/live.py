"""Puts a mutant into the modules of this process; no file is changed."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from functools import cached_property
from types import CodeType, FunctionType, ModuleType

from tools.mutation.mutants import Mutant


def put(mutant: Mutant) -> None:
    """Change this process as the mutant says."""
    code = compile(mutant.tree, importlib.import_module(mutant.module).__file__ or "", "exec")
    if mutant.function:
        _function(mutant).__code__ = _code(code, mutant.function)
    else:
        _put_numbers(mutant.module, code)


def _function(mutant: Mutant) -> FunctionType:
    owner: object = importlib.import_module(mutant.module)
    *path, last = mutant.function.split(".")
    for name in path:
        owner = getattr(owner, name)
    found = vars(owner)[last]
    match found:
        case property(fget=FunctionType() as inner):
            found = inner
        case staticmethod() | classmethod():
            found = found.__func__
        case cached_property():
            found = found.func
    found = getattr(found, "__wrapped__", found)
    assert isinstance(found, FunctionType), mutant.function
    return found


def _code(module: CodeType, function: str) -> CodeType:
    return next(code for code in _nested(module) if code.co_qualname == function)


def _nested(code: CodeType) -> Iterator[CodeType]:
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield constant
            yield from _nested(constant)


def _put_numbers(name: str, code: CodeType) -> None:
    """Set the module's plain values anew, wherever they were imported to."""
    module = importlib.import_module(name)
    changed = dict(vars(module))
    exec(code, changed)
    for key, value in list(vars(module).items()):
        new = changed[key]
        if isinstance(value, int | float) and type(new) is type(value) and new != value:
            for other in _own_modules():
                if vars(other).get(key) is value:
                    setattr(other, key, new)


def _own_modules() -> list[ModuleType]:
    packages = ("adaptdrive", "tests")
    return [one for name, one in sys.modules.items() if name.partition(".")[0] in packages]
