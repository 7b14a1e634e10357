"""A battery that is enabled while the boost capacitor is still full from the run before."""

from __future__ import annotations

import pytest

from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import Enable, SetSetpoint
from tests.faults.course import Course


@pytest.mark.parametrize("boost_V", [250.0, 300.0, 365.0])
def test_a_full_capacitor_is_no_voltage_to_begin_charging_with(boost_V: float) -> None:
    course = Course("battery, CAN", 3)
    world = course.drive.world
    course.run(0.7)
    world.boost.settle(boost_V, 0.0)
    world.load.relaxed_V = [0.0, 0.0]  # type: ignore[attr-defined]
    assert course.daemon.accepts(Enable())
    assert course.daemon.accepts(SetSetpoint(0.1))
    course.run(1.0)
    assert course.daemon.state is State.RUNNING, course.daemon.trip
    limit = course.configuration.interlocks.output_max
    assert course.highest < limit
    assert world.true_output < 0.2 * limit
    held_V = world.load.emf_V / world.coupling.ratio
    assert world.boost.voltage_V < 1.05 * held_V
