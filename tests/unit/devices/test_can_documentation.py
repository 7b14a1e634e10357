"""What the manual shows of a DBC is valid, and fits what the file says."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from adaptdrive.config import load_configuration
from tests.unit.devices.bench import EXAMPLES

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "hardware.md").read_text(encoding="utf-8")
BLOCKS = [tomllib.loads(text) for text in re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)]


def merged(into: dict[str, Any], tables: dict[str, Any]) -> dict[str, Any]:
    """A document with keys of another laid over it, table by table."""
    laid = {
        key: merged(into[key], value)
        if isinstance(value, dict) and isinstance(into.get(key), dict)
        else value
        for key, value in tables.items()
    }
    return {**into, **laid}


def block_with(name: str) -> dict[str, Any]:
    return next(
        tables for tables in BLOCKS if name in str(tables.get("signals", {}).get("command", ""))
    )


def test_the_inverter_of_the_page_is_that_of_the_examples() -> None:
    example = load_configuration(EXAMPLES / "motor-inverter.toml").model_dump()
    tables = block_with("HOST_CMD")
    for section in ("bus", "signals"):
        assert merged(example[section], tables[section]).keys() == example[section].keys()
    assert tables["signals"]["command"]["constants"] == example["signals"]["command"]["constants"]
    integrity = example["bus"]["integrity"]["INV_STATE"]
    assert merged(integrity, tables["bus"]["integrity"]["INV_STATE"]) == integrity
