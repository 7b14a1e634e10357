"""Names of estimates for people, of each kind of load."""

from __future__ import annotations

from types import ModuleType

import pytest

from adaptdrive.control.loads import bath, battery, motor
from adaptdrive.mqtt.commands import quantity_and_unit

UNITS = {
    motor: ["V/V", "s", "s²", "V"],
    bath: ["K/W", "s", "W"],
    battery: ["S", "S", "s", "V"],
}


@pytest.mark.parametrize("load", UNITS, ids=lambda load: load.__name__.rpartition(".")[2])
def test_each_estimate_has_its_unit_once(load: ModuleType) -> None:
    names = (*load.NAMES, "input_offset")
    found = [quantity_and_unit(name, names, "V") for name in names]
    assert [unit for _, unit in found] == UNITS[load]
    assert not any("_" in quantity for quantity, _ in found)


@pytest.mark.parametrize(
    ("output_unit", "unit"), [("V", "V/V"), ("Hz", "Hz/V"), ("rad/s", "(rad/s)/V"), ("", "1/V")]
)
def test_a_gain_is_so_much_of_the_output_for_each_volt(output_unit: str, unit: str) -> None:
    assert quantity_and_unit("gain", motor.NAMES, output_unit) == ("gain", unit)
