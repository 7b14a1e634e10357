"""The simulated supply: its replies are those that the configuration finds a number in."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from adaptdrive.config.file import validate_configuration
from adaptdrive.config.scpi import ScpiBus
from adaptdrive_sim.device_main import build_drive
from adaptdrive_sim.device_settings import DeviceSettings
from adaptdrive_sim.devices.scpi_drive import ScpiDrive

EXAMPLE = Path(__file__).parents[2] / "deploy" / "examples" / "motor-scpi.toml"


@pytest.mark.parametrize(
    ("reply", "answer"),
    [("(.*)", "{}"), ("V1 (.*)V", "V1 {}V"), ("(?:[^,]*,){2}([^,]*).*", "{0},{0},{0},")],
)
def test_a_reply_has_the_words_of_the_supply_and_a_command_has_not(reply: str, answer: str) -> None:
    tables = tomllib.loads(EXAMPLE.read_text(encoding="utf-8"))
    tables["bus"]["values"]["voltage_set"]["reply"] = reply
    tables["bus"]["done"] = "*IDN?"
    configuration = validate_configuration(tables, EXAMPLE)
    assert isinstance(configuration.bus, ScpiBus)
    drive = build_drive(configuration, DeviceSettings(), lambda _, **__: None)
    supply = ScpiDrive(drive, configuration.bus, configuration.signals, lambda _, **__: None)
    assert supply.obey("VOLT 287.654") == []
    (line,) = supply.obey("VOLT?")
    assert line.startswith(answer.format("2.87654000E+02"))
    assert supply.obey("*IDN?") == ["1"]


def test_a_setting_in_whole_numbers_is_read_back_as_one() -> None:
    tables = tomllib.loads(EXAMPLE.read_text(encoding="utf-8"))
    protection = {"query": "OCP?", "write": "OCP {}", "names": {"OFF": 0, "ON": 1}}
    tables["bus"]["values"]["protection"] = protection
    configuration = validate_configuration(tables, EXAMPLE)
    assert isinstance(configuration.bus, ScpiBus)
    drive = build_drive(configuration, DeviceSettings(), lambda _, **__: None)
    supply = ScpiDrive(drive, configuration.bus, configuration.signals, lambda _, **__: None)
    assert supply.obey("OCP?") == ["0"]
    assert supply.obey("OCP ON") == []
    assert supply.obey("OCP?") == ["1"]
