"""A drive that holds its own voltage needs no mains: what is absent is absent."""

from __future__ import annotations

import math

import pytest

from adaptdrive.app.examine import advice
from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings, trip_limits
from adaptdrive.config.consistency import consistency_flaws
from adaptdrive.config.root import DriveLimits
from adaptdrive.control.controller import Controller
from adaptdrive.control.signals import Measurement, Mode, Order, Stage
from adaptdrive.safety.facts import Reading
from adaptdrive.safety.interlocks import find_cause
from tests.unit.config import documents
from tests.unit.config.modbus_documents import flaws, parse

ABSENT: dict[str, str | None] = {"signals__line_voltage_V": None, "signals__load_power_W": None}
LOW: dict[str, str | None] = {"drive__limits__boost_reference_min_V": "0.0"}


def reading(line_voltage_V: float = math.nan, load_power_W: float = math.nan) -> Reading:
    return Reading(0.0, 0.0, None, 200.0, line_voltage_V, load_power_W, 1.0, 0, bridge=True)


def test_line_and_power_may_be_absent_and_the_lowest_voltage_zero() -> None:
    assert flaws(**ABSENT, **LOW) == {}
    assert flaws(drive__line_voltage_V="400.0") == {}
    cautions = {flaw.place: flaw.message for flaw in advice(parse(**ABSENT, **LOW))}
    assert "holds nothing back" in cautions["signals.load_power_W"]
    assert "signals.load_power_W" not in {flaw.place for flaw in advice(parse())}


def test_a_drive_that_holds_its_voltage_need_not_report_it() -> None:
    absent: dict[str, str | None] = {**ABSENT, "signals__boost_voltage_V": None}
    assert flaws(**absent) == {}
    cautions = {flaw.place: flaw.message for flaw in advice(parse(**absent))}
    assert "V_c stands for it" in cautions["signals.boost_voltage_V"]
    assert "boost_voltage_V" in trip_limits(parse(**absent)).absent
    assert "signals.boost_voltage_V" in documents.flaws(signals__boost_voltage_V=None)


def test_a_voltage_below_zero_is_for_a_motor() -> None:
    signed = "{ address = 0, table = 'holding', type = 'int16', scale = 0.1 }"
    limit: dict[str, str | None] = {"drive__limits__boost_reference_min_V": "-200.0"}
    assert flaws(**limit, bus__registers__wanted=signed) == {}
    assert "cannot carry -200" in flaws(**limit)["signals.command.boost_reference_V"]
    below = DriveLimits(boost_reference_min_V=-1.0)
    load = parse().load.model_copy(update={"type": "bath"})
    drive = parse().drive.model_copy(update={"limits": below})
    configuration = parse().model_copy(update={"load": load, "drive": drive})
    (flaw,) = consistency_flaws(configuration, {"drive", "voltage_loop", "load"})
    assert (flaw.place, flaw.message) == (
        "drive.limits.boost_reference_min_V",
        "-1.0 must not be below 0: a bath has no direction",
    )


@pytest.mark.parametrize("name", ["line_voltage_V", "load_power_W"])
def test_an_absent_value_trips_nothing_and_a_lost_one_does(name: str) -> None:
    other = {"line_voltage_V": 230.0, "load_power_W": 100.0}
    del other[name]
    absent: dict[str, str | None] = {f"signals__{name}": None}
    assert find_cause(reading(**other), 0.01, trip_limits(parse(**absent)), 0.05) is None
    cause = find_cause(reading(**other), 0.01, trip_limits(parse()), 0.05)
    assert cause is not None
    assert f"invalid: {name} = nan" in cause.text


@pytest.mark.parametrize(("lowest_V", "target"), [(0.0, 0.5), (-300.0, -3.0)])
def test_the_loop_settles_without_line_and_power(lowest_V: float, target: float) -> None:
    configuration = parse(
        **ABSENT,
        drive__limits__boost_reference_min_V=str(lowest_V),
        load__reference_min="-4.0",
        load__period_s="1.0",
    )
    settings, load = controller_settings(configuration), build_load(configuration)
    controller = Controller(settings, load)
    order = Order(Stage.RUN, target, Mode.FIXED, configuration.load.pole)
    voltage = max(0.0, lowest_V)
    speed = output = 0.0
    for tick in range(1, 180 * 120):
        now = Measurement(tick, 1.0 / 120.0, voltage, math.nan, math.nan, output)
        voltage = controller.tick(now, order).boost_reference_V
        snapshot = controller.take_snapshot()
        if snapshot is not None:
            controller.apply(controller.decide(snapshot))
        speed += (0.02 * voltage - speed) / 9.0 / 120.0
        output += (speed - output) / 3.0 / 120.0
        assert lowest_V <= voltage <= 400.0
    assert output == pytest.approx(target, abs=0.02)
