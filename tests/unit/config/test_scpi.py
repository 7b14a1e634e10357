"""Supplies that speak SCPI: what the page and the example say, and what is refused."""

from __future__ import annotations

import math
import re
import tomllib
from pathlib import Path

import pytest

from adaptdrive.app.examine import examine_text
from adaptdrive.config import load_configuration
from adaptdrive.config.bus import Signals
from adaptdrive.config.polled import ScpiBus, ScpiValue
from adaptdrive.config.references import scpi_flaws
from adaptdrive.devices.polled.mapping import map_drive
from adaptdrive.util.errors import ConfigurationError

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT / "deploy" / "examples" / "motor-scpi.toml"


def test_the_values_of_the_page_are_valid_and_set_in_two_lines() -> None:
    page = (ROOT / "docs" / "hardware.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    (shown,) = [tomllib.loads(text) for text in blocks if "[bus.values]" in text]
    bus = ScpiBus.model_validate({"type": "scpi", "host": "drive", **shown["bus"]})
    command = {"boost_reference_V": "set_voltage", "bridge": "output"}
    tables = {"boost_voltage_V": "voltage", "fault": "error", "bridge": "output"}
    signals = Signals.model_validate({**tables, "command": command})
    assert list(scpi_flaws(bus, signals)) == []
    whole = load_configuration(EXAMPLE)
    ends = {"boost_reference_min_V": 10.0, "boost_reference_max_V": 50.0}
    limits = whole.drive.limits.model_copy(update=ends)
    trips = whole.interlocks.model_copy(update={"boost_voltage_max_V": 60.0})
    drive = whole.drive.model_copy(update={"limits": limits})
    changes = {"signals": signals, "drive": drive, "interlocks": trips}
    small = whole.model_copy(update=changes)
    poll = map_drive(small, bus.as_registers(), EXAMPLE, passive=False)
    assert (len(poll.reads), len(poll.writes)) == (3, 2)


@pytest.mark.parametrize(
    ("reply", "line", "number"),
    [
        ("(.*)V", "12.000V", 12.0),
        ("V1 (.*)", "V1 12.000", 12.0),
        ("(?:[^,]*,){1}([^,]*).*", "+1.5E+00,+2.50E+00,10.0", 2.5),
        ("V1 (.*)", "V2 12.000", math.nan),
        ("(.*)V", "---V", math.nan),
    ],
)
def test_the_value_is_a_part_of_the_reply(reply: str, line: str, number: float) -> None:
    value = ScpiValue(query="V1?", reply=reply)
    assert value.number(line) == pytest.approx(number, nan_ok=True)


def test_a_stop_that_nothing_confirms_is_refused() -> None:
    text = EXAMPLE.read_text(encoding="utf-8").replace("port = 5025 ", 'done = ""\nport = 5025 ')
    examine_text(text, EXAMPLE)
    with pytest.raises(ConfigurationError, match="is empty: signals"):
        examine_text(text.replace('bridge = "output"     ', "#", 1), EXAMPLE)
