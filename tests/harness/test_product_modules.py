"""The product has no module that only tests and pages use."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
PUBLIC = {"adaptdrive.lab"}
"""Modules for the programs of users."""

COMMANDS = "adaptdrive.cli."
"""The command line imports its modules by names that it puts together."""


def modules() -> dict[str, Path]:
    """Return the files of the product by the names of their modules, without packages."""
    folders = (ROOT / "src", ROOT / "simulators")
    return {
        ".".join(path.relative_to(folder).with_suffix("").parts): path
        for folder in folders
        for path in folder.rglob("*.py")
        if not path.stem.startswith("__")
    }


def named_in(text: str) -> Iterator[str]:
    """Yield the names that a file imports, and those in its texts, such as of `python -m`."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            yield from (one.name for one in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{one.name}" for one in node.names)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value.partition(":")[0]


def test_each_module_is_used_by_another_of_the_product() -> None:
    files = [*(ROOT / "src").rglob("*.py"), *(ROOT / "simulators").rglob("*.py")]
    named = {path: set(named_in(path.read_text(encoding="utf-8"))) for path in files}
    unused = {
        name
        for name, own in modules().items()
        if not name.startswith(COMMANDS)
        and not any(name in names for path, names in named.items() if path != own)
    }
    assert unused == PUBLIC
