"""Sensors beside the drive: what gives which quantity, and every contradiction by its place."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.config import Configuration, parse_configuration
from adaptdrive.config.root import ModbusRtuSensors, in_order, moved_inputs, needed_names
from adaptdrive.util.errors import ConfigurationError
from tests.unit.config import modbus_documents
from tests.unit.config.documents import SOURCE, document

THERMOCOUPLES = """
[[sensor_bus]]
name = "thermocouples"
type = "modbus-rtu"
device = "thermo.tty"
cycle_s = 0.25
registers.hot = { address = 0, table = "input", type = "int16", scale = 0.1, unit = "degC" }
registers.cold = { address = 1, table = "input", type = "int16", scale = 0.1, unit = "degC" }
signals.hot = { signal = "hot", unit = "degC" }
signals.cold = { signal = "cold", unit = "degC" }
"""
DIFFERENCE = '[derived.output]\nrule = "difference"\nof = ["hot", "cold"]\n'


def whole(text: str, **changes: str | None) -> Configuration:
    """The small configuration on CAN, without an output of its own, and more sections."""
    given = {"signals__output__signal": None, **changes}
    return parse_configuration(f"{document(**given)}\n{text}", SOURCE)


def flaws(text: str, **changes: str | None) -> dict[str, str]:
    try:
        whole(text, **changes)
    except ConfigurationError as error:
        return {flaw.place: flaw.message for flaw in error.flaws}
    return {}


def test_a_derived_output_from_sensors_beside_the_drive() -> None:
    configuration = whole(THERMOCOUPLES + DIFFERENCE)
    (bus,) = configuration.sensor_bus
    assert isinstance(bus, ModbusRtuSensors)
    assert bus.device == SOURCE.parent / "thermo.tty"
    assert bus.oldest_s == 0.75
    hot = bus.signals["hot"]
    assert (hot.scale, hot.offset) == (1.0, 273.15)
    assert {"hot", "cold", "output"} <= needed_names(configuration.derived)


VOLTMETER = """
[[sensor_bus]]
name = "meter"
type = "modbus-tcp"
host = "127.0.0.1"
cycle_s = 0.1
registers.dc_link = { address = 0, table = "input" }
signals.dc_link = { signal = "dc_link" }
[derived.boost_voltage_V]
rule = "mean"
of = ["dc_link"]
"""
"""v_bst of a meter beside the drive."""


def voltmeter_flaws(times: str) -> dict[str, str]:
    """Flaws of the daemon's voltage loop with this meter, by their place."""
    text = VOLTMETER.replace("cycle_s = 0.1", times)
    output = '"DriveLoad.Tachometer"'
    return flaws(text, signals__boost_voltage_V=None, signals__output__signal=output)


@pytest.mark.parametrize(("cycle_s", "refused"), [("0.1", True), ("0.026", True), ("0.025", False)])
def test_a_boost_voltage_that_comes_seldom_needs_a_drive_that_holds_it(
    cycle_s: str, refused: bool
) -> None:
    found = voltmeter_flaws(f"cycle_s = {cycle_s}")
    assert ("sensor_bus.0.cycle_s" in found) is refused
    assert not refused or "voltage_loop.where = 'daemon': at most 0.025 s" in str(found)


@pytest.mark.parametrize(("stale_s", "refused"), [("0.08", True), ("0.04", False)])
def test_a_boost_voltage_for_the_daemons_loop_is_held_no_longer_than_the_drives_values(
    stale_s: str, refused: bool
) -> None:
    found = voltmeter_flaws(f"cycle_s = 0.01\nstale_s = {stale_s}")
    assert ("sensor_bus.0.stale_s" in found) is refused
    assert not refused or "at most interlocks.stale_s = 0.05 s" in found["sensor_bus.0.stale_s"]


def test_two_buses_need_two_names_and_two_lines() -> None:
    second = THERMOCOUPLES.replace("signals.hot", "signals.a").replace("signals.cold", "signals.b")
    found = flaws(THERMOCOUPLES + second + DIFFERENCE)
    assert set(found) == {"sensor_bus.1.name", "sensor_bus.1.device"}
    assert "a device_id for each register" in found["sensor_bus.1.device"]


@pytest.mark.parametrize("line", ["thermo.tty", str(SOURCE.parent.absolute() / "thermo.tty")])
def test_a_line_of_the_drive_is_no_line_for_sensors(line: str) -> None:
    rtu: dict[str, str | None] = {"bus__type": '"modbus-rtu"', "bus__host": None}
    drive = modbus_documents.document(**rtu, bus__device=f'"{line}"', signals__output=None)
    with pytest.raises(ConfigurationError) as caught:
        parse_configuration(drive + THERMOCOUPLES + DIFFERENCE, SOURCE)
    assert [flaw.place for flaw in caught.value.flaws] == ["sensor_bus.0.device"]
    assert "the line of bus already" in str(caught.value)


def test_derived_values_are_made_in_an_order_in_which_they_can_be() -> None:
    chain = """
[derived.output]
rule = "largest"
of = ["mean", "hot"]
[derived.mean]
rule = "mean"
of = ["hot", "cold"]
"""
    assert in_order(whole(THERMOCOUPLES + chain).derived) == ["mean", "output"]


@pytest.mark.parametrize(
    ("rules", "inputs"),
    [
        ('rule = "difference"\nof = ["hot", "cold"]', ("hot",)),
        ('rule = "difference"\nof = ["hot", "cold"]\nfollows = ["cold"]', ("cold",)),
        ('rule = "largest"\nof = ["hot", "cold"]', ("hot", "cold")),
        ('rule = "difference"\nof = ["both", "cold"]', ("hot", "cold")),
    ],
)
def test_of_a_derived_output_those_inputs_are_watched(rules: str, inputs: tuple[str, ...]) -> None:
    both = '[derived.both]\nrule = "mean"\nof = ["hot", "cold"]\n'
    derived = whole(f"{THERMOCOUPLES}\n[derived.output]\n{rules}\n{both}").derived
    assert moved_inputs("output", derived) == inputs
    assert moved_inputs("hot", derived) == ()


@pytest.mark.parametrize(
    ("unit", "value", "si"),
    [
        ("degC", 25.0, 298.15),
        ("degF", 77.0, 298.15),
        ("rpm", 60.0, 2.0 * math.pi),
        ("Hz", 1.0, 2.0 * math.pi),
        ("kW", 1.2, 1200.0),
        ("mV", 7.0, 0.007),
        ("K", 300.0, 300.0),
    ],
)
def test_units_are_converted_to_si(unit: str, value: float, si: float) -> None:
    source = whole(
        THERMOCOUPLES + DIFFERENCE,
        signals__load_power_W=f"{{ signal = 'A.B', unit = '{unit}' }}",
    ).signals.load_power_W
    assert source is not None
    assert value * source.scale + source.offset == pytest.approx(si)


@given(
    raw=st.floats(-1e4, 1e4),
    scale=st.floats(-1e3, 1e3).filter(lambda scale: abs(scale) > 1e-6),
    offset=st.floats(-1e3, 1e3).map(lambda offset: round(offset, 6)),
)
def test_scale_and_offset_lead_to_the_unit(raw: float, scale: float, offset: float) -> None:
    given = f"{{ signal = 'A.B', scale = {scale!r}, offset = {offset!r}, unit = 'degF' }}"
    configuration = whole(THERMOCOUPLES + DIFFERENCE, signals__load_power_W=given)
    source = configuration.signals.load_power_W
    assert source is not None
    kelvin = (raw * scale + offset + 459.67) / 1.8
    assert raw * source.scale + source.offset == pytest.approx(kelvin, abs=1e-6)


def test_a_path_that_is_absolute_stays() -> None:
    text = THERMOCOUPLES.replace("thermo.tty", "/dev/ttyUSB1") + DIFFERENCE
    (bus,) = whole(text).sensor_bus
    assert isinstance(bus, ModbusRtuSensors)
    assert bus.device == Path("/dev/ttyUSB1")
