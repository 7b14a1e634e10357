"""The unit in which people see and type the output: shown and typed everywhere, SI inside."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.app.settings import machine_limits, operator_profile, trip_limits
from adaptdrive.cli.display import describe, site_table
from adaptdrive.cli.options import typed
from adaptdrive.config import Configuration
from adaptdrive.config.load import OutputDisplay
from adaptdrive.connected import Published
from adaptdrive.control.signals import UNKNOWN, Waveform
from adaptdrive.mqtt import contract
from adaptdrive.mqtt.client import DriveStatus
from adaptdrive.mqtt.commands import Payload, display_in
from adaptdrive.mqtt.contract import Output
from adaptdrive.mqtt.service import discovery
from adaptdrive.runtime import requests
from adaptdrive.runtime.program import in_own_unit
from adaptdrive.runtime.requests import RunProgram, SetSetpoint, SetWaveform
from adaptdrive.safety.interlocks import find_cause
from adaptdrive.tui.record import WatchRecord
from adaptdrive.tui.terminal import KeyReader
from adaptdrive.util.errors import RefusedError
from adaptdrive.util.quantity import Display
from tests.unit.config.documents import flaws, parse
from tests.unit.mqtt.peers import STANDBY, drive_report, load_report, profile
from tests.unit.mqtt.test_connected import NOW, STANDING, decoded
from tests.unit.mqtt.test_home_assistant import rendered
from tests.unit.safety.test_interlocks import GOOD, NOW_S, STALE_S

RPM = Display("rpm", 30.0 / math.pi)
LEVELS = st.floats(-1e4, 1e4)
SCALES = st.floats(1e-3, 1e3)


def shaft(**changes: str | None) -> Configuration:
    """A motor in rad/s, shown in rpm."""
    given_ = {"load__output_unit": '"rad/s"', "load__output_display": '"rpm"'}
    limits = {"load__reference_max": "157.08", "interlocks__output_max": "180.0"}
    return parse(**(given_ | limits | changes))


@given(LEVELS, SCALES, LEVELS)
def test_what_is_shown_and_typed_again_is_the_same(value: float, scale: float, zero: float) -> None:
    display = Display("x", scale, zero)
    near = 1e-9 * (1.0 + abs(value) + abs(zero) / scale)
    assert display.typed(display.shown(value)) == pytest.approx(value, abs=near)
    step = display.change.shown(value)
    assert step == pytest.approx(display.shown(value) - zero, abs=1e-9 * (1 + abs(zero)))


@pytest.mark.parametrize(
    ("inside", "chosen", "value", "text"),
    [
        ("rad/s", '"rpm"', math.pi, "30 rpm"),
        ("rad/s", '"Hz"', 4.0 * math.pi, "2 Hz"),
        ("K", '"degC"', 300.0, "26.85 °C"),
        ("K", '"°F"', 273.15, "32 °F"),
        ("K", '{ unit = "degC", offset = 15.0 }', 40.0, "55 °C"),
        ("V", '{ unit = "rpm", scale = 400.0 }', 3.0, "1200 rpm"),
        ("V", None, 3.0, "3 V"),
    ],
)
def test_a_key_names_the_unit(inside: str, chosen: str | None, value: float, text: str) -> None:
    found = parse(load__output_unit=f'"{inside}"', load__output_display=chosen).load.display
    assert found.text(value, ".6g") == text


@pytest.mark.parametrize("unit", ["rpm", "furlong"])
def test_a_unit_that_nobody_can_convert_to_is_refused(unit: str) -> None:
    found = flaws(load__output_display=f'"{unit}"')
    assert f"{unit!r} is no unit that 'V' converts to" in str(found)


def asked(verb: str, **content: Any) -> requests.Request:
    return Payload(json.dumps({"id": "a", **content}).encode()).request(verb)[0]


def test_a_command_is_in_the_unit_that_it_names() -> None:
    load = shaft().load
    assert in_own_unit(asked("setpoint", value=150.0, slope=2.0), load) == SetSetpoint(150.0, 2.0)
    assert in_own_unit(asked("setpoint", value=9, unit="rad/s"), load) == asked(
        "setpoint", value=9, unit="rad/s"
    )
    found = in_own_unit(asked("setpoint", value=300, slope=30, unit="RPM"), load)
    assert isinstance(found, SetSetpoint)
    assert (found.value, found.slope) == pytest.approx((10 * math.pi, math.pi))
    wave = {"shape": "sine", "low": 30, "high": 60, "period_s": 9}
    held = in_own_unit(asked("waveform", value=wave, unit="rpm"), load)
    assert isinstance(held, SetWaveform)
    assert isinstance(held.value, Waveform)
    levels = held.value.low, held.value.high, held.value.period_s
    assert levels == pytest.approx((math.pi, 2 * math.pi, 9.0))
    with pytest.raises(RefusedError, match=r"unit = '°C': the output is in rpm or rad/s"):
        in_own_unit(asked("setpoint", value=9, unit="°C"), load)


def test_a_program_is_in_the_unit_that_it_names() -> None:
    steps: list[dict[str, Any]] = [
        {"do": "ramp", "to": 300, "slope": 30},
        {"do": "hold", "within": 3, "for_s": 9},
        {"do": "waveform", "shape": "square", "low": 30, "high": 60, "period_s": 9, "for_s": 9},
        {"do": "hold", "for_s": 9},
    ]
    program = {"name": "run", "steps": steps, "unit": "rpm"}
    found = in_own_unit(asked("program", value=program), shaft().load)
    assert isinstance(found, RunProgram)
    assert isinstance(found.value, requests.Program)
    *levels, hold = msgspec.to_builtins(found.value.steps)
    assert levels == [
        {"do": "ramp", "to": pytest.approx(10 * math.pi), "slope": pytest.approx(math.pi)},
        {"do": "hold", "within": pytest.approx(math.pi / 10), "for_s": 9},
        steps[2] | {"low": pytest.approx(math.pi), "high": pytest.approx(2 * math.pi)},
    ]
    assert hold == steps[3] | {"within": None}


@given(st.floats(1.0, 1e4), st.floats(1e-2, 1e3), st.floats(-500.0, 500.0))
def test_a_limit_that_is_typed_as_it_is_shown_is_within(
    highest: float, scale: float, zero: float
) -> None:
    shown = OutputDisplay(unit="x", scale=scale, offset=zero)
    load = shaft().load.model_copy(update={"reference_max": highest, "output_display": shown})
    for limit in (load.reference_min, highest):
        request = SetSetpoint(load.display.shown(limit), unit="x")
        found = in_own_unit(request, load)
        assert isinstance(found, SetSetpoint)
        assert load.reference_min <= found.value <= highest


def test_refusals_and_trips_are_in_the_unit() -> None:
    configuration = shaft()
    limits = machine_limits(configuration)
    with pytest.raises(RefusedError, match=r"setpoint = 3000 rpm is outside 0…1500.* rpm$"):
        limits.require_setpoint("setpoint", RPM.typed(3000.0), UNKNOWN)
    reading = replace(GOOD, output=RPM.typed(2000.0))
    trip = find_cause(reading, NOW_S, trip_limits(configuration), STALE_S)
    assert "speed = 2000 rpm, limit 1718.87 rpm" in str(trip)


def published() -> dict[str, dict[str, Any]]:
    """The messages of a drive at π rad/s and an output of 3.1 rad/s, as they are published."""
    about = replace(profile("pump"), output=operator_profile(shaft()).output)
    state = replace(STANDBY, setpoint=math.pi)
    return {
        "state": decoded(contract.state_message(state, STANDING, about)),
        "load": decoded(contract.load_message(load_report(7), NOW, about.output)),
        "drive": decoded(contract.drive_message(drive_report(600), NOW, about.output)),
    }


def test_telemetry_stays_in_the_unit_of_the_output() -> None:
    found = published()
    assert display_in(found["state"]) == RPM
    assert (found["drive"]["output"], found["drive"]["output_unit"]) == (3.1, "rad/s")


def test_the_command_line_shows_it() -> None:
    messages = published()
    telemetry = {"load": messages["load"], "drive": messages["drive"]}
    status = DriveStatus("online", messages["state"], telemetry, live=True)
    lines = describe("pump", status).splitlines()
    assert "  set-point   30 rpm" in lines
    assert "  speed       29.603 rpm" in lines
    assert "29.603 rpm" in site_table({"pump": status})


@pytest.mark.parametrize(
    ("text", "number", "unit"),
    [("150", 150, ""), ("1500rpm", 1500, "rpm"), ("-1e3", -1e3, ""), ("60 °C", 60, "°C")],
)
def test_a_number_is_typed_with_a_unit_or_without(text: str, number: float, unit: str) -> None:
    found = typed(text)
    assert (float(found), found.unit) == (number, unit)


@pytest.mark.parametrize("text", ["rpm", "", "1 2 3"])
def test_what_is_no_number_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="is not a number"):
        typed(text)


def test_a_key_of_the_live_view_moves_it_by_a_share_of_its_range() -> None:
    record = WatchRecord("pump", lambda: 0.0)
    record.take("state", published()["state"])
    command = KeyReader(record).press("+")
    assert command is not None
    assert command.unit == "rpm"
    assert command.value == pytest.approx(RPM.shown(math.pi + 0.01 * 4.0))


def test_a_drive_of_python_has_it() -> None:
    made = Published("pump", lambda: 0.0)
    made.take("availability", {"availability": "online"})
    for topic, content in published().items():
        made.take(topic if topic == "state" else f"telemetry/{topic}", content)
    assert repr(made.value("output")) == "29.6028 rpm"
    assert repr(made.value("setpoint_asked")) == "30 rpm"
    assert made.value("innovation").unit == "rpm"


def test_home_assistant_shows_and_types_it() -> None:
    display = Display("°C", 1.0, 15.0)
    about = replace(profile("bath"), output=Output("rise", "K", display))
    components = discovery(about, "homeassistant")[1]["components"]
    output, setpoint = components["output"], components["setpoint"]
    shown = rendered(output["value_template"], value_json={"output": 40.0})
    assert (shown, output["unit_of_measurement"]) == ("55.0", "°C")
    assert rendered(output["value_template"], value_json={"output": None}) == "None"
    assert (setpoint["min"], setpoint["max"], setpoint["unit_of_measurement"]) == (15, 19, "°C")
    sent = rendered(setpoint["command_template"], value="17.5")
    assert Payload(sent.encode()).request("setpoint")[0] == SetSetpoint(17.5, unit="°C")
