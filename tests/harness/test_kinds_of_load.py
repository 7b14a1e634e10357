"""A new kind of load is entered where loads are chosen, and nowhere else."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

from adaptdrive.config.load import LoadName

ROOT = Path(__file__).parents[2]
OPTIONAL = {"hardware/proposal.py"}
"""Names and units of outputs that `init` recognises in a DBC; a load without a row is left out."""


def tables_of_loads(text: str) -> Iterator[int]:
    """Yield the lines of dicts with keys for two kinds of load."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Dict):
            keys = {one.value for one in node.keys if isinstance(one, ast.Constant)}
            if len(keys & set(get_args(LoadName))) > 1:
                yield node.lineno


def test_no_table_has_a_row_for_each_kind_of_load() -> None:
    source = ROOT / "src" / "adaptdrive"
    found = {
        str(path.relative_to(source))
        for path in source.rglob("*.py")
        for _ in tables_of_loads(path.read_text(encoding="utf-8"))
    }
    assert found == OPTIONAL
