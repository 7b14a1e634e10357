"""A boost capacitor that is still full from the run before must not move the load."""

from __future__ import annotations

import math

import pytest

from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import Enable
from tests.integration.faults.course import Course


@pytest.mark.parametrize(
    ("name", "for_s"), [("motor, CAN", 60.0), ("motor, Modbus", 60.0), ("bath, Modbus", 600.0)]
)
def test_a_full_capacitor_moves_no_load_that_is_to_hold_still(name: str, for_s: float) -> None:
    """The model of the daemon is wrong by up to 1.3, which moves V_c as well."""
    course = Course(name, 3)
    course.sigma = 0.0
    world, (low, high) = course.drive.world, course.reach
    world.settle(world.boost_voltage_for(low + 0.3 * (high - low)))
    world.shut()
    course.run(3.0)
    world.boost.settle(400.0, 0.0)
    course.highest = -math.inf
    assert course.daemon.accepts(Enable())
    setpoint = course.daemon.daemon._machine.asked.setpoint
    course.run(for_s)
    assert course.daemon.state is State.RUNNING, course.daemon.trip
    assert course.highest < setpoint + 0.02 * course.span
