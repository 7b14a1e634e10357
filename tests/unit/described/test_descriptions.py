"""What each description of a device says of itself, and how `init` hands it over."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from adaptdrive.app.examine import advice, load_examined
from adaptdrive.app.starter import device_names, of_device
from adaptdrive.cli import main
from adaptdrive.config import load_configuration
from adaptdrive.config.file import validate_configuration
from adaptdrive.config.polled import ModbusRtu
from adaptdrive.safety.timing import timing_of
from adaptdrive.util.errors import ConfigurationError
from tests.unit.described.described import DEVICES, NAMES


def test_there_are_devices_of_every_kind() -> None:
    assert len(NAMES) >= 12
    assert device_names() == NAMES
    tables = [tomllib.loads((DEVICES / f"{name}.toml").read_text()) for name in NAMES]
    assert {one["bus"]["type"] for one in tables} >= {"can", "canopen", "modbus-rtu"}
    assert {one["load"]["type"] for one in tables} == {"motor", "bath", "battery"}


@pytest.mark.parametrize("name", NAMES)
def test_each_names_its_source_and_what_was_tried(name: str) -> None:
    text = (DEVICES / f"{name}.toml").read_text()
    assert re.search(r"(?m)^# Source: .{20}", text)
    assert re.search(r"(?m)^# Tried: .{20}", text)
    assert "\n# Checked, never on hardware.\n" in text
    tests = "".join(path.read_text() for path in Path(__file__).parent.glob("test_*_devices.py"))
    assert f'"{name}"' in tests


@pytest.mark.parametrize("name", NAMES)
def test_init_writes_a_configuration_that_check_accepts(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    load = tomllib.loads((DEVICES / f"{name}.toml").read_text())["load"]["type"]
    words = ["init", load, "--device", name, "--name", "mine", "--directory", str(tmp_path)]
    assert main(words) == 0
    assert load_examined(tmp_path / "mine.toml").drive.name == "mine"
    assert "next:" in capsys.readouterr().out


@pytest.mark.parametrize("name", NAMES)
def test_a_serial_line_bears_a_busy_machine(name: str) -> None:
    """A machine that others use delays a process by 0.2 s (docs/own-drive.md)."""
    bus = (configuration := load_configuration(DEVICES / f"{name}.toml")).bus
    if isinstance(bus, ModbusRtu):
        poll_s = timing_of(configuration).reading_s
        assert bus.timeout_s >= min(0.2, 0.7 * poll_s)
        assert timing_of(configuration).stale_s >= 0.999 * (1.5 * poll_s + 6.0 * bus.timeout_s)


def test_an_unknown_device_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="did you mean 'delta-ms300'"):
        of_device("motor", "delta-ms30", "mine")


def test_the_tachometer_and_the_rates_of_the_page_fit_an_inverter_without_encoder() -> None:
    page = (DEVICES.parents[1] / "docs" / "own-drive.md").read_text(encoding="utf-8")
    (tachometer,) = re.findall(r"```toml\n(\[\[sensor_bus\]\].*?)```", page, re.DOTALL)
    path = DEVICES / "siemens-v20.toml"
    tables = tomllib.loads(path.read_text(encoding="utf-8")) | tomllib.loads(tachometer)
    del tables["signals"]["output"]
    tables["bus"] |= {"baud": 19200}
    for row in re.findall(
        r"(?m)^(\| `(?:bus|load|interlocks)\..*) \| ([\d.]+) \| [\d. ]*\|$", page
    ):
        for table, key in re.findall(r"`(bus|load|interlocks)\.(\w+)`", row[0]):
            tables[table][key] = tomllib.loads(f"x = {row[1]}")["x"]
    configuration = validate_configuration(tables, path)
    assert (configuration.bus.ticks_per_reading, configuration.load.latency_ticks) == (20, 20)
    assert configuration.interlocks.stale_s == 1.2
    assert list(advice(configuration)) == []
