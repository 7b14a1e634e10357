"""What the manual shows of a DBC is valid, and fits what the file says."""

from __future__ import annotations

import re
import time
import tomllib
from pathlib import Path
from typing import Any

import pytest

from adaptdrive.app.ports import build_port
from adaptdrive.config import Configuration, load_configuration
from adaptdrive.control.signals import Command
from adaptdrive.hardware.dbc.port import CanPort
from tests.hardware.bench import EXAMPLES

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "hardware.md").read_text(encoding="utf-8")
BLOCKS = [tomllib.loads(text) for text in re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)]

RUN = Command(current_scale_S=0.0, boost_reference_V=350.0, bridge=True)

# Ids, places, factors and ranges of the charger's messages, as far as the manual names them.
CHARGER = """VERSION ""

BO_ 1553 NLG5_ACT_I: 8 NLG5
 SG_ NLG5_MC_ACT : 7|16@0+ (0.01,0) [0|50] "A" X
 SG_ NLG5_MV_ACT : 23|16@0+ (0.1,0) [0|500] "V" X
 SG_ NLG5_OV_ACT : 39|16@0+ (0.1,0) [0|1000] "V" X
 SG_ NLG5_OC_ACT : 55|16@0- (0.01,0) [0|150] "A" X

BO_ 1552 NLG5_ST: 4 NLG5
 SG_ NLG5_S_ERR : 6|1@0+ (1,0) [0|1] "" X

BO_ 1560 NLG5_CTL: 7 X
 SG_ NLG5_C_C_EN : 7|1@0+ (1,0) [0|1] "" NLG5
 SG_ NLG5_MC_MAX : 15|16@0+ (0.1,0) [0|50] "A" NLG5
 SG_ NLG5_OV_COM : 31|16@0+ (0.1,0) [0|1000] "V" NLG5
 SG_ NLG5_OC_COM : 47|16@0+ (0.1,0) [0|150] "A" NLG5
"""


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


def test_the_charger_of_the_page_is_valid_and_mapped(tmp_path: Path) -> None:
    database = tmp_path / "nlg5.dbc"
    database.write_text(CHARGER)
    tables = block_with("NLG5")
    document = tomllib.loads((EXAMPLES / "battery.toml").read_text(encoding="utf-8"))
    document = merged({**document, "bus": {}, "signals": {}}, tables)
    document["bus"]["database"] = str(database)
    port = build_port(Configuration.model_validate(document), time.monotonic, "page")
    assert isinstance(port, CanPort)
    sources = [source for status in port._mapping.statuses for source in status.sources]
    slack_s = {source.quantity: source.slack_s for source in sources}
    assert slack_s["output"] == pytest.approx(0.0)  # 2.5 cycles of 100 ms
    assert slack_s["fault"] == pytest.approx(0.0)  # no cycle time is known: those of the clock
    frames = [order.encode(RUN) for order in port._mapping.orders]
    assert frames == [bytes((0x80, 0x00, 0xA0, 0x0D, 0xAC, 0x00, 0x78))]


def test_the_inverter_of_the_page_is_that_of_the_examples() -> None:
    example = load_configuration(EXAMPLES / "motor-inverter.toml").model_dump()
    tables = block_with("HOST_CMD")
    for section in ("bus", "signals"):
        assert merged(example[section], tables[section]).keys() == example[section].keys()
    assert tables["signals"]["command"]["constants"] == example["signals"]["command"]["constants"]
    integrity = example["bus"]["integrity"]["INV_STATE"]
    assert merged(integrity, tables["bus"]["integrity"]["INV_STATE"]) == integrity
