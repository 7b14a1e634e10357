"""Rules of the house: each kind of load has one place, modules have users, tests have no clock."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

from adaptdrive.config.load import LoadName

ROOT = Path(__file__).parents[4]

COMMANDS = "adaptdrive.cli."
"""The command line imports its modules by names that it puts together."""


def tables_of_loads(text: str) -> Iterator[int]:
    """Yield the lines of dicts with keys for two kinds of load."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Dict):
            keys = {one.value for one in node.keys if isinstance(one, ast.Constant)}
            if len(keys & set(get_args(LoadName))) > 1:
                yield node.lineno


def test_no_table_has_a_row_for_each_kind_of_load() -> None:
    """A new kind of load is entered where loads are chosen, and nowhere else.

    `devices/proposal.toml` may have the look of its output in a DBC; without it, that is left out.
    """
    source = ROOT / "src" / "adaptdrive"
    found = {
        str(path.relative_to(source))
        for path in source.rglob("*.py")
        for _ in tables_of_loads(path.read_text(encoding="utf-8"))
    }
    assert found == set()


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
    files = {
        ".".join(path.relative_to(folder).with_suffix("").parts): path
        for folder in (ROOT / "src", ROOT / "simulators")
        for path in folder.rglob("*.py")
    }
    named = {path: set(named_in(path.read_text("utf-8"))) for path in files.values()}
    unused = {
        name
        for name, own in files.items()
        if not own.stem.startswith("__") and not name.startswith(COMMANDS)
        if not any(name in names for path, names in named.items() if path != own)
    }
    assert not unused


CLOCKS = {"sleep", "monotonic", "monotonic_ns", "time", "time_ns", "perf_counter"}


def clocks_in(text: str) -> Iterator[int]:
    """Yield the lines that name a clock, or the sleep, of the module `time`."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Attribute):
            named = ast.unparse(node.value) == "time" and node.attr in CLOCKS
        else:
            named = isinstance(node, ast.ImportFrom) and node.module == "time"
        if named:
            yield getattr(node, "lineno", 0)


def test_only_system_tests_and_peers_look_at_the_clock_of_the_machine() -> None:
    """Time is that of the event loop, which costs nothing to pass."""
    tests = ROOT / "tests"
    frame = {tests / "conftest.py", tests / "virtual_time.py", tests / "support.py"}
    found = {
        str(path.relative_to(tests))
        for path in tests.rglob("*.py")
        if path not in frame and path.relative_to(tests).parts[0] not in {"system", "peers"}
        for _ in clocks_in(path.read_text(encoding="utf-8"))
    }
    assert found == set()
