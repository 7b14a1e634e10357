"""What is imported is declared, and what is declared is imported."""

from __future__ import annotations

import ast
import sys
import tomllib
from collections.abc import Iterable
from functools import cache
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[3]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT = PYPROJECT["project"]
OURS = {"adaptdrive", "adaptdrive_sim", "tests", "tools"}
EXTRAS = {
    "src": ("analysis", "canopen", "control", "desk", "export", "shell"),
    "simulators": ("sim", "cluster"),
    "tests": tuple(PROJECT["optional-dependencies"]),
    "tools": tuple(PROJECT["optional-dependencies"]),
}
NOT_IMPORTED = {
    "build": "makes the wheel",
    "coverage": "a program",
    "hatch-mypyc": "compiles modules of the wheel",
    "hatchling": "builds the wheel",
    "import-linter": "a program",
    "msgpack": "python-can imports it for multicast",
    "mypy": "a program",
    "pytest-asyncio": "a plug-in",
    "pytest-timeout": "a plug-in",
    "pytest-xdist": "a plug-in",
    "ruff": "a program",
    "uv": "a program",
}


@cache
def modules(folder: str) -> dict[str, Path]:
    """The packages of others that a folder imports, each with one place."""
    found: dict[str, Path] = {}
    for path in (ROOT / folder).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            for name in _imported(node):
                top = name.partition(".")[0]
                if top not in sys.stdlib_module_names and top not in OURS:
                    found[top] = path
    return found


def _imported(node: ast.AST) -> Iterable[str]:
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
        return [node.module]
    return []


def declared(extras: Iterable[str]) -> set[str]:
    """The distributions that the project asks for, with these extras."""
    texts = [*PROJECT["dependencies"]]
    for extra in extras:
        texts += PROJECT["optional-dependencies"][extra]
    return {canonicalize_name(Requirement(text).name) for text in texts}


installed = cache(packages_distributions)


def distributions(module: str) -> set[str]:
    return {canonicalize_name(name) for name in installed().get(module, [])}


@pytest.mark.parametrize("folder", EXTRAS)
def test_what_is_imported_is_declared(folder: str) -> None:
    wanted = declared(EXTRAS[folder])
    missing = {
        f"{module} in {path.relative_to(ROOT)}"
        for module, path in modules(folder).items()
        if module != "_typeshed" and not distributions(module) & wanted
    }
    assert not missing


def test_what_is_declared_is_imported() -> None:
    imported = {module for folder in EXTRAS for module in modules(folder)}
    used = set().union(*(distributions(module) for module in imported))
    assert declared(PROJECT["optional-dependencies"]) - used - NOT_IMPORTED.keys() == set()


def test_an_extra_holds_what_its_folder_imports() -> None:
    own = {name: path for name, path in modules("src").items() if path.name == "processes.py"}
    imported = modules("simulators") | own  # and what starts its processes
    used = set().union(*(distributions(module) for module in imported))
    assert declared(("sim", "cluster")) - declared(()) - used == set()


HOOK = PYPROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["hooks"]["mypyc"]
SIMULATORS = PYPROJECT["tool"]["adaptdrive"]["compiled-simulators"]
COMPILED = [*HOOK["include"], *(f"/simulators/{path}" for path in SIMULATORS)]


def named(pattern: str) -> str:
    """The module or the package that a pattern of files stands for."""
    path = pattern.removeprefix("/src/").removeprefix("/simulators/")
    return path.removesuffix("/**/*.py").removesuffix(".py").replace("/", ".")


def test_every_compiled_module_is_held_to_what_a_compiled_module_may_import() -> None:
    contracts = {one["id"]: one for one in PYPROJECT["tool"]["importlinter"]["contracts"]}
    held = set(contracts["compiled"]["source_modules"])
    assert set(map(named, COMPILED)) == held
    for pattern in (*COMPILED, *HOOK["exclude"]):
        assert list(ROOT.glob(pattern.removeprefix("/"))), f"{pattern} names no file"


def test_no_compiled_module_awaits() -> None:
    """From Python 3.12 on, a coroutine of mypyc warns where it is cancelled while it awaits."""
    paths = [path for pattern in COMPILED for path in ROOT.glob(pattern.lstrip("/"))]
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in paths}
    nodes = [(path, node) for path, tree in trees.items() for node in ast.walk(tree)]
    assert paths
    assert not [path for path, node in nodes if isinstance(node, ast.Await)]
