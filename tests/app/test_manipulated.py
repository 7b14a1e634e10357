"""A drive may be commanded, and give, another quantity than a voltage."""

from __future__ import annotations

import math

import pytest

from adaptdrive.app.advice import advice
from adaptdrive.app.interlocks import trip_limits
from adaptdrive.app.profile import operator_profile
from adaptdrive.app.settings import daemon_settings
from adaptdrive.errors import RefusedError
from adaptdrive.hardware.port import Reading
from adaptdrive.runtime.interlocks import find_cause
from tests.config import documents
from tests.config.modbus_documents import flaws, parse

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


def test_a_signal_in_another_unit_is_a_flaw() -> None:
    volts = "{ address = 0, table = 'input', scale = 0.01, unit = 'V' }"
    found = flaws(**{**HZ, "bus__registers__voltage": volts})
    assert "the signal is in V, the quantity in Hz" in found["signals.boost_voltage_V"]


def test_texts_have_its_name_and_unit() -> None:
    configuration = parse(**HZ)
    reading = Reading(0.0, 0.0, None, 56.0, math.nan, math.nan, 1.0, 0, bridge=True)
    cause = find_cause(reading, 0.01, trip_limits(configuration))
    assert cause == "over-voltage: frequency = 56.0 Hz, limit 55 Hz"
    with pytest.raises(RefusedError, match=r"60 Hz is outside 0…50 Hz"):
        daemon_settings(configuration).machine.require_voltage(60.0, None)


def test_the_voltage_of_the_daemon_is_a_voltage() -> None:
    found = documents.flaws(drive__manipulated__unit='"Hz"')
    assert "needs voltage_loop.where = 'drive'" in found["drive.manipulated.unit"]


def test_a_drive_without_a_switch_is_stopped_by_its_set_point() -> None:
    none: dict[str, str | None] = {**HZ, "signals__command__bridge": None}
    assert "enable_bit = 'bridge-and-boost'" in flaws(**none)["signals.command.bridge"]
    one_bit: dict[str, str | None] = {**none, "drive__enable_bit": '"bridge-and-boost"'}
    assert flaws(**one_bit) == {}
    cautions = {flaw.place: flaw.message for flaw in advice(parse(**one_bit))}
    assert "a set-point of 0 is its only stop" in cautions["signals.command.bridge"]
