"""What a charger must not do to a battery, or to terminals without one."""

from __future__ import annotations

import pytest

from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import Enable, SetSetpoint
from tests.integration.faults.course import Course, example

pytestmark = pytest.mark.proof

BATTERY_V_MAX = 82.0


@pytest.mark.parametrize("boost_V", [250.0, 300.0, 365.0])
def test_a_full_capacitor_is_no_voltage_to_begin_charging_with(boost_V: float) -> None:
    """It may be full from the run before."""
    course = Course("battery, CAN", 3)
    world = course.drive.world
    course.run(0.7)
    world.boost.settle(boost_V, 0.0)
    world.load.relaxed_V = [0.0, 0.0]  # type: ignore[union-attr]
    assert course.daemon.accepts(Enable())
    assert course.daemon.accepts(SetSetpoint(0.1))
    course.run(1.0)
    assert course.daemon.state is State.RUNNING, course.daemon.trip
    limit = course.configuration.interlocks.output_max
    assert course.highest < limit
    assert world.true_output < 0.2 * limit
    held_V = world.load.emf_V / world.coupling.ratio
    assert world.boost.voltage_V < 1.05 * held_V


def test_terminals_whose_battery_is_disconnected_stay_near_their_limit() -> None:
    """V_c looks for the current that is gone; what the capacitor takes up at once stays in it."""
    course = Course("battery, CAN", 3)
    world, ratio = course.drive.world, course.drive.world.coupling.ratio
    course.run(0.7)
    assert course.daemon.accepts(Enable())
    assert course.daemon.accepts(SetSetpoint(6.0))
    course.run(30.0)
    assert world.true_output == pytest.approx(6.0, abs=1.0)
    course.highest_V = 0.0
    for _ in range(100):
        world.load.relaxed_V = [60.0, 60.0]  # type: ignore[union-attr]
        course.run(0.2)
    assert world.true_output == 0.0
    assert ratio * course.highest_V < 1.08 * BATTERY_V_MAX
    assert (course.daemon.trip or "").startswith("no current: ")


@pytest.mark.parametrize(("factor", "offset_A"), [(1.5, 0.0), (1.0, 3.0)])
def test_a_current_that_reads_too_high_takes_the_terminals_no_further(
    factor: float, offset_A: float
) -> None:
    """What the reading has too much would look like a voltage that the output stage drops."""
    course = Course("battery, CAN", 0)
    load = course.drive.world.load
    load.charge = 0.85  # type: ignore[union-attr]
    course.sensor = lambda _, output: factor * output + offset_A
    course.fault_s = 0.0
    course.run(0.7)
    assert course.daemon.accepts(Enable())
    assert course.daemon.accepts(SetSetpoint(10.0))
    highest_V = 0.0
    for _ in range(600):
        course.run(1.0)
        highest_V = max(highest_V, load.terminal_voltage_V)  # type: ignore[union-attr]
    assert course.daemon.state is State.RUNNING, course.daemon.trip
    assert BATTERY_V_MAX < highest_V < 1.021 * BATTERY_V_MAX


@pytest.mark.parametrize("offset_A", [0.0, 1.5])
def test_a_charge_whose_current_reads_too_high_ends_at_its_longest_time(offset_A: float) -> None:
    """It tapers to 0 A, which reads as more than `end_current_A`, here 1 A."""
    tables = example("battery, CAN")
    tables["load"]["charge"]["longest_h"] = 0.25
    course = Course("battery, CAN", 3, tables)
    course.drive.world.load.charge = 0.97  # type: ignore[union-attr]
    course.sensor = lambda _, output: output + offset_A
    course.fault_s = 0.0
    course.run(0.7)
    assert course.daemon.accepts(Enable())
    assert course.daemon.accepts(SetSetpoint(8.0))
    course.run(850.0)
    still_on = offset_A > 0.0
    assert (course.daemon.state is State.RUNNING) is still_on, course.daemon.trip
    course.run(70.0)
    assert (course.daemon.trip or "").startswith("charge time: ") is still_on
    assert course.off
