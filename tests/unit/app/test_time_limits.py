"""What `check` says of limits of time, against the examples and against the loop itself."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from adaptdrive.app.check_report import tables, time_limits
from adaptdrive.cli.configuration import check
from adaptdrive.config import load_configuration
from tests.unit.config.modbus_documents import parse as modbus_parse
from tests.unit.devices.bench import EXAMPLES


def limits(example: str) -> dict[str, float]:
    path = EXAMPLES / f"{example}.toml"
    return {what: limit_s for what, limit_s, _ in time_limits(load_configuration(path), path)}


def test_a_message_that_comes_seldom_has_its_slack() -> None:
    found = limits("motor-inverter")
    assert found["stale output"] == pytest.approx(0.1)
    assert found["stale boost_voltage_V"] == pytest.approx(0.3)  # 4 cycles of 25 ms, 3 pages


def test_a_message_without_a_cycle_time_comes_as_often_as_the_clock(tmp_path: Path) -> None:
    database = (EXAMPLES / "inverter.dbc").read_text(encoding="utf-8")
    unsaid = re.sub(r'(?m)^BA_ "GenMsgCycleTime".*\n', "", database)
    (tmp_path / "inverter.dbc").write_text(unsaid, encoding="utf-8")
    path = tmp_path / "motor-inverter.toml"
    shutil.copy(EXAMPLES / path.name, path)
    rows = {what: row for what, *row in time_limits(load_configuration(path), path)}
    limit_s, keys = rows["stale boost_voltage_V"]
    assert limit_s == pytest.approx(0.3)  # 4 cycles of 25 ms, 3 pages
    assert keys == "bus.stale_cycles, bus.clock_ticks"


def test_a_sensor_has_the_limit_of_its_bus() -> None:
    assert limits("bath-thermocouples")["stale thermocouples.bath_temperature"] == 1.0


def test_the_words_that_are_watched_are_listed() -> None:
    configuration = modbus_parse(
        signals__fault="['power', { signal = 'state', mask = 0x0F }]",
        signals__warning="{ signal = 'state', mask = 0xF0 }",
    )
    shown = [" ".join(line.split()) for line in tables(configuration, EXAMPLES).splitlines()]
    assert "trips on faults of power all bits signals.fault.0" in shown
    assert "trips on faults of state bits 0xf signals.fault.1" in shown
    assert "tells warnings of state bits 0xf0 signals.warning" in shown


def test_the_table_has_milliseconds_and_half_cycles() -> None:
    path = EXAMPLES / "motor.toml"
    table = tables(load_configuration(path), path)
    rows = {" ".join(line.split()) for line in table.splitlines()}
    assert "stale output 50 6 interlocks.stale_s" in rows
    assert "starting 5000 600 interlocks.precharge_timeout_s" in rows
    assert "output standing still never interlocks.stuck_s = 0" in rows


def test_check_prints_the_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert check(EXAMPLES / "battery.toml") == 0
    assert "stale output" in capsys.readouterr().out
