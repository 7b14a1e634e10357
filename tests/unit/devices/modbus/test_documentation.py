"""What the manual shows is valid, and fits on the links that it names."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from adaptdrive.app.ports import build_whole_port
from adaptdrive.config import load_configuration
from adaptdrive.config.file import validate_configuration
from adaptdrive.config.polled import ModbusBus, ModbusRtu
from adaptdrive.config.root import Derived
from adaptdrive.devices.polled.mapping import map_drive
from adaptdrive.devices.polled.registers import (
    Exchange,
    cycle_flaws,
    exchange_bytes,
    exchange_s,
    plan_blocks,
)

ROOT = Path(__file__).parents[4]
PAGE = (ROOT / "docs" / "hardware.md").read_text(encoding="utf-8")
EVERY = [tomllib.loads(text) for text in re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)]
BLOCKS = [tables for tables in EVERY if tables.get("bus", {}).get("type") == "modbus-rtu"]
HALF_CYCLE_s = 1.0 / 120.0


@pytest.mark.parametrize("tables", BLOCKS, ids=range(len(BLOCKS)))
def test_every_map_is_valid_and_can_be_polled(tables: dict[str, dict[str, object]]) -> None:
    bus = ModbusRtu.model_validate(tables["bus"])
    blocks = plan_blocks(bus.registers.values(), bus.max_gap, bus.max_block)
    exchanges = [Exchange(read=block) for block in blocks]
    wanted = (bus.poll_ticks * HALF_CYCLE_s, "bus.poll_ticks", HALF_CYCLE_s)
    assert list(cycle_flaws(bus, exchanges, *wanted)) == []


def test_the_sensors_of_the_page_make_a_whole_configuration_with_an_example() -> None:
    path = ROOT / "deploy" / "examples" / "bath-thermocouples.toml"
    shown = next(tables for tables in EVERY if "sensor_bus" in tables)
    tables = tomllib.loads(path.read_text(encoding="utf-8")) | shown
    port = build_whole_port(validate_configuration(tables, path), float, path)
    assert "sensors thermocouples on modbus-tcp 192.168.0.10:502" in port.description


def test_the_derived_values_of_the_page_are_rules() -> None:
    (shown,) = [tables for tables in EVERY if set(tables) == {"derived"}]
    rules = [Derived.model_validate(given).rule for given in shown["derived"].values()]
    assert rules == ["product", "largest"]


@pytest.mark.parametrize("kind", ["tcp", "rtu"])
def test_the_figures_of_the_examples_are_those_of_the_page(kind: str) -> None:
    name = f"motor-modbus-{kind}.toml"
    whole = load_configuration(ROOT / "deploy" / "examples" / name)
    assert isinstance(whole.bus, ModbusBus)
    exchanges = list(map_drive(whole, whole.bus, name, passive=False).exchanges())
    total = sum(exchange_bytes(whole.bus, exchange) for exchange in exchanges)
    time_ms = 1e3 * sum(exchange_s(whole.bus, exchange) for exchange in exchanges)
    row = next(line for line in PAGE.splitlines() if line.startswith(f"| `{name}`"))
    assert f"{len(exchanges)} exchanges, {total} bytes" in row
    assert f"{time_ms:.0f} ms" in row


@pytest.mark.parametrize("load", ["motor", "bath"])
def test_two_lost_replies_on_the_serial_line_of_an_example_do_not_trip(load: str) -> None:
    """Each keeps the line busy for three time-outs, the silence included."""
    whole = load_configuration(ROOT / "deploy" / "examples" / f"{load}-modbus-rtu.toml")
    assert isinstance(whole.bus, ModbusRtu)
    poll_s = 0.5 * whole.bus.poll_ticks / whole.drive.line_frequency_Hz
    oldest_s = poll_s + 2.0 * 3.0 * whole.bus.timeout_s + 0.5 * poll_s
    assert oldest_s < whole.interlocks.stale_s
