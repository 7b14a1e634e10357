"""A drive may be commanded, and give, another quantity than a voltage."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
from msgspec.structs import replace
from rich.console import Console

from adaptdrive.app.examine import advice, examine_text
from adaptdrive.app.ports import build_port, bus_kind
from adaptdrive.app.settings import machine_limits, operator_profile, trip_limits
from adaptdrive.cli.display import describe
from adaptdrive.config import Configuration
from adaptdrive.control.signals import Command, Reach
from adaptdrive.mqtt.client import DriveStatus
from adaptdrive.mqtt.service import discovery
from adaptdrive.recording.tables import table_schema
from adaptdrive.safety.facts import Reading
from adaptdrive.safety.guard import Guard
from adaptdrive.safety.interlocks import find_cause
from adaptdrive.safety.trips import remedy
from adaptdrive.tui.record import WatchRecord
from adaptdrive.tui.view import screen
from adaptdrive.util.errors import RefusedError
from tests.unit.config.modbus_documents import flaws, parse
from tests.unit.recording.material import INFO

HZ: dict[str, str | None] = {
    "drive__manipulated__name": '"frequency"',
    "drive__manipulated__unit": '"Hz"',
    "drive__limits__boost_reference_min_V": "0.0",
    "drive__limits__boost_reference_max_V": "50.0",
    "interlocks__boost_voltage_max_V": "55.0",
    "bus__registers__voltage": "{ address = 0, table = 'input', scale = 0.01, unit = 'Hz' }",
    "bus__registers__wanted": "{ address = 0, table = 'holding', scale = 0.01, unit = 'Hz' }",
    "signals__line_voltage_V": None,
    "signals__load_power_W": None,
    "load__model__gain": "0.2",
}


def test_an_inverter_that_takes_a_frequency_needs_no_untrue_number() -> None:
    assert flaws(**HZ) == {}
    profile = operator_profile(parse(**HZ))
    assert (profile.manipulated.name, profile.manipulated.unit) == ("frequency", "Hz")


def test_texts_have_its_name_and_unit() -> None:
    configuration = parse(**HZ)
    reading = Reading(0.0, 0.0, None, 56.0, math.nan, math.nan, 1.0, 0, bridge=True)
    cause = find_cause(reading, 0.01, trip_limits(configuration), 0.05)
    assert cause is not None
    assert cause.text == "drive above its limit: frequency = 56.0 Hz, limit 55 Hz"
    assert "scale" in remedy(cause.kind)
    with pytest.raises(RefusedError, match=r"60 Hz is outside 0…50 Hz"):
        machine_limits(configuration).require_voltage(60.0, None)


UNTRUE = re.compile(r"V_c|v_bst|boost voltage|(?<!_)\bV\b|/V\b")


def leaving(configuration: Configuration) -> Iterator[str]:
    """Yield what operators, figures, records and other programs are told of a drive."""
    machine, profile = machine_limits(configuration), operator_profile(configuration)
    for refuse in (
        lambda: machine.require_voltage(1e3, None),
        lambda: machine.require_reach("setpoint", 1e3, Reach(0.0, 5.0)),
        lambda: Guard(configuration.drive).check(Command(0, math.nan, True)),
    ):
        with pytest.raises((RefusedError, ValueError)) as refusal:
            refuse()
        yield str(refusal.value)
    yield str(machine.precharge_cause(1.0))
    broken = Reading(0.0, 0.0, None, 1e3, math.nan, math.nan, 1.0, 0, bridge=True)
    yield str(find_cause(broken, 0.01, trip_limits(configuration), 0.05))
    for component in discovery(profile, "homeassistant")[1]["components"].values():
        yield f"{component['name']} in {component.get('unit_of_measurement')}"
    state = {"manipulated": msgspec.to_builtins(profile.manipulated)}
    load = {"estimates": {"gain": {"value": 1.0}, "input_offset": {"value": 1.0}}}
    status = DriveStatus("online", state, {"load": load, "drive": {}}, live=True)
    yield describe("bench", status)
    record = WatchRecord("bench", lambda: 0.0)
    record.take("state", state)
    record.take("telemetry/load", load)
    console = Console(width=120, height=40)
    with console.capture() as capture:
        console.print(screen(record, (120, 40)))
    yield capture.get()
    yield from (f"{one.place}: {one.message}" for one in advice(configuration))
    yield profile.manipulated.axis


@pytest.mark.parametrize(
    ("name", "unit"), [("frequency", "Hz"), ("torque", "Nm"), ("opening", "%"), ("share", "")]
)
def test_no_value_leaves_as_a_voltage_that_is_none(name: str, unit: str) -> None:
    named = {**HZ, "drive__manipulated__name": f'"{name}"', "drive__manipulated__unit": f'"{unit}"'}
    for register in ("voltage", "wanted"):
        written = str(HZ[f"bus__registers__{register}"])
        named[f"bus__registers__{register}"] = written.replace("'Hz'", f"'{unit}'")
    configuration = parse(**named, load__output_unit='"rad/s"')
    told = list(leaving(configuration))
    assert [text for text in told if UNTRUE.search(text.replace("line_voltage", ""))] == []
    assert name in told[0]
    info = replace(INFO, manipulated=configuration.drive.given)
    for table in ("ticks", "slow"):
        for field in table_schema(table, info):
            if field.name.endswith("_V") and field.name != "line_voltage_V":
                assert field.metadata[b"unit"].decode() in {unit, "unit of the load's input"}


def test_a_drive_without_a_switch_is_stopped_by_its_set_point() -> None:
    none: dict[str, str | None] = {**HZ, "signals__command__bridge": None}
    assert "enable_bit = 'bridge-and-boost'" in flaws(**none)["signals.command.bridge"]
    one_bit: dict[str, str | None] = {**none, "drive__enable_bit": '"bridge-and-boost"'}
    assert flaws(**one_bit) == {}
    cautions = {flaw.place: flaw.message for flaw in advice(parse(**one_bit))}
    assert "a set-point of 0 is its only stop" in cautions["signals.command.bridge"]


TORQUE = """[drive]
name = "trac"
enable_bit = "bridge"
manipulated = { name = "torque", unit = "Nm" }
[drive.limits]
boost_reference_min_V = -100.0
boost_reference_max_V = 100.0
[bus]
type = "can"
interface = "socketcan"
channel = "can0"
database = "inv.dbc"
clock = "Motion"
command_timeout_s = 0.5
[signals]
boost_voltage_V = "Torque.Torque_Feedback"
output = { signal = "Motion.Motor_Speed", unit = "rpm" }
bridge = "States.Inverter_Enable_State"
fault = ["Faults.Post_Fault_Lo", "Faults.Run_Fault_Lo"]
[signals.command]
boost_reference_V = "Command.Torque_Command"
bridge = "Command.Inverter_Enable"
[voltage_loop]
where = "drive"
lag_s = 0.05
[load]
type = "motor"
period_s = 1.0
pole = 0.7
output_name = "speed"
output_unit = "rad/s"
reference_min = -200.0
reference_max = 200.0
[load.model]
gain = 2.5
tau_motor_s = 5.0
tau_filter_s = 1.0
[interlocks]
output_max = 250.0
boost_voltage_max_V = 130.0
"""

DBC = """VERSION ""
BS_: 500000 : 1,2
BU_: INV VCU
BO_ 165 Motion: 8 INV
 SG_ Motor_Speed : 16|16@1- (1,0) [-32768|32767] "RPM" VCU
BO_ 170 States: 8 INV
 SG_ Inverter_Enable_State : 48|1@1+ (1,0) [0|1] "On/Off" VCU
BO_ 171 Faults: 8 INV
 SG_ Post_Fault_Lo : 0|16@1+ (1,0) [0|65535] "" VCU
 SG_ Run_Fault_Lo : 32|16@1+ (1,0) [0|65535] "" VCU
BO_ 172 Torque: 8 INV
 SG_ Torque_Feedback : 16|16@1- (0.1,0) [-3276.8|3276.7] "N.m" VCU
BO_ 192 Command: 8 VCU
 SG_ Torque_Command : 0|16@1- (0.1,0) [-3276.8|3276.7] "Nm" INV
 SG_ Inverter_Enable : 40|1@1+ (1,0) [0|1] "On/Off" INV
 SG_ 5V_Rail : 41|30@1+ (1,0) [0|0] "" INV
"""


def test_a_torque_inverter_on_can_is_described_by_a_file_with_flaws(tmp_path: Path) -> None:
    (tmp_path / "inv.dbc").write_text(DBC)
    path = tmp_path / "torque.toml"
    path.write_text(TORQUE)
    configuration = examine_text(TORQUE, path)
    cautions = [flaw.message for flaw in advice(configuration)]
    assert "line 16: a name that begins with a digit" in cautions
    assert any(one.startswith("line 16: signal '_5V_Rail' does not fit") for one in cautions)
    limits = {name for name, _, _ in bus_kind("can").time_limits(configuration, path)}
    assert {"stale output", "stale fault.0", "stale fault.1"} <= limits
    probed = build_port(configuration, lambda: 0.0, path, passive=True)
    assert probed.monitor.slack_s is not None
