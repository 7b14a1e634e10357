"""A report of v_bst that fails never overcharges the capacitor, and a healthy one trips nothing."""

from __future__ import annotations

from dataclasses import replace

import pytest

from adaptdrive.app.check_report import highest_voltages
from adaptdrive.config import load_configuration
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import Enable, SetSetpoint
from adaptdrive.safety.facts import Reading
from adaptdrive_sim.plants.boost import Sample
from tests.integration.faults.course import Course, example, example_path
from tests.support import sample

LIMIT_V = 430.0


def stated() -> tuple[float, float]:
    """What `check` states for a silent and a frozen report, in V."""
    return highest_voltages(load_configuration(example_path("motor, CAN")).drive, LIMIT_V)


def rising(stale_s: float, capacitance_F: float = 1.0e-3) -> Course:
    """A motor whose capacitor has just begun to rise with a set-point."""
    tables = example("motor, CAN")
    tables.setdefault("interlocks", {})["stale_s"] = stale_s
    tables["drive"]["boost_capacitance_F"] = capacitance_F
    course = Course("motor, CAN", 1, tables)
    course.sigma = 0.0
    assert course.begin()
    course.daemon.accepts(SetSetpoint(course.reach[1]))
    voltage_V = course.drive.world.boost.voltage_V
    for _ in range(600):
        course.half_cycle()
        if course.drive.world.boost.voltage_V > voltage_V + 5.0:
            return course
    raise AssertionError("the capacitor does not rise")


def highest_V(course: Course, seconds: float) -> float:
    """Let the course go on until it trips; return the highest true voltage."""
    highest = 0.0
    for _ in range(round(seconds * 120)):
        course.half_cycle()
        highest = max(highest, course.drive.world.boost.voltage_V)
    return highest


def silence_voltage(course: Course) -> None:
    """Let the message with v_bst stop coming while that with the clock goes on."""
    last: list[Reading] = []

    def held(reading: Reading) -> Reading:
        last[:] = last or [reading]
        kept = last[0]
        return replace(
            reading,
            boost_voltage_V=kept.boost_voltage_V,
            oldest_s=kept.arrival_s,
            voltage_s=kept.arrival_s,
        )

    course.frame = held


def freeze_voltage(course: Course) -> None:
    """Let the message with v_bst come on time with the value of before."""
    last: list[Reading] = []

    def frozen(reading: Reading) -> Reading:
        last[:] = last or [reading]
        return replace(reading, boost_voltage_V=last[0].boost_voltage_V)

    course.frame = frozen


@pytest.mark.parametrize("stale_s", [0.05, 0.3])
def test_a_silent_report_leaves_the_capacitor_where_it_is(stale_s: float) -> None:
    course = rising(stale_s)
    before_V = course.drive.world.boost.voltage_V
    silence_voltage(course)
    reached_V = highest_V(course, 1.0)
    assert course.daemon.state is State.TRIPPED
    assert reached_V < min(before_V + 60.0, stated()[0])


def test_a_frozen_report_trips_before_the_limit() -> None:
    course = rising(0.05)
    freeze_voltage(course)
    reached_V = highest_V(course, 2.0)
    assert "frozen" in (course.daemon.trip or "")
    assert reached_V < min(LIMIT_V, stated()[1])


def test_a_drive_that_falls_silent_and_stops_is_not_overcharged() -> None:
    course = rising(0.3)
    course.frame = lambda _: None
    course.drive.world.shut()
    assert highest_V(course, 1.0) < LIMIT_V
    assert course.daemon.state is State.TRIPPED


def test_a_report_frozen_in_precharge_trips_before_the_limit() -> None:
    course = Course("motor, CAN", 1)
    course.run(0.7)
    freeze_voltage(course)
    assert course.daemon.accepts(Enable())
    assert highest_V(course, 5.0) < LIMIT_V
    assert course.daemon.state is State.TRIPPED


@pytest.mark.parametrize("wrong", [0.6, 1.0, 1.5])
def test_a_capacitance_wrong_by_half_trips_nothing(wrong: float) -> None:
    course = rising(0.05, 1.0e-3 * wrong)
    low, high = course.reach
    for share in (0.1, 0.9, 0.3, 1.0):
        course.daemon.accepts(SetSetpoint(low + share * (high - low)))
        course.run(20.0)
        assert course.daemon.state is State.RUNNING, course.daemon.trip


def draw_idle_power(course: Course, power_W: float) -> None:
    """Let fans and supplies of the drive discharge its capacitor, beside the load."""
    world, boost = course.drive.world, course.drive.world.boost
    step, taken_V2 = world.step, 2.0 * power_W * 0.5 / 60.0 / 1.0e-3

    def drawn(current_scale_S: float, bridge: bool) -> Sample:
        sample = step(current_scale_S, bridge)
        squared_V2 = boost.squared_V2 - (taken_V2 if world.bridge else 0.0)
        boost.settle(max(0.0, squared_V2) ** 0.5, boost.mean_load_W)
        return sample._replace(boost_voltage_V=boost.voltage_V)

    world.step = drawn  # type: ignore[method-assign, assignment]


@pytest.mark.parametrize("power_W", [60.0, 100.0])
def test_a_report_that_falls_while_the_load_takes_nothing_is_not_frozen(power_W: float) -> None:
    course = Course("battery, CAN", 1)
    draw_idle_power(course, power_W)
    assert course.begin(), course.daemon.trip


@pytest.mark.parametrize("share", sample([0.3, 0.7], 1))
@pytest.mark.parametrize(
    ("name", "settle_s", "seconds"), [("motor, CAN", 30.0, 10.0), ("bath, CAN", 300.0, 60.0)]
)
def test_a_report_frozen_at_rest_never_overcharges(
    name: str, settle_s: float, seconds: float, share: float
) -> None:
    """The drive's own protection is off, and the loop integrates a small constant error."""
    course = Course(name, 2)
    assert course.begin()
    low, high = course.reach
    course.daemon.accepts(SetSetpoint(low + share * (high - low)))
    course.run(settle_s)
    course.drive._trip_V = 1e6
    freeze_voltage(course)
    assert highest_V(course, seconds) < LIMIT_V + 2.0


@pytest.mark.parametrize("late_ticks", [5, 15, 60, 120])
def test_a_drive_that_comes_on_late_is_charged_and_runs(late_ticks: int) -> None:
    tables = example("motor, CAN")
    tables.setdefault("interlocks", {})["start_s"] = 1.5
    course = Course("motor, CAN", 1, tables)
    course.drive.world.boost.settle(170.0, 0.0)
    step, asked = course.drive.world.step, [0]

    def late(current_scale_S: float, bridge: bool) -> Sample:
        asked[0] = asked[0] + 1 if bridge or current_scale_S > 0.0 else 0
        return step(current_scale_S, bridge) if asked[0] > late_ticks else step(0.0, False)

    course.drive.world.step = late  # type: ignore[method-assign, assignment]
    assert course.begin(), course.daemon.trip


@pytest.mark.parametrize("lost_ticks", [5, 20, 40, 80])
@pytest.mark.parametrize("share", [0.4, 1.0])
def test_a_capacitor_that_has_fallen_to_the_peak_of_the_line_is_charged_again(
    lost_ticks: int, share: float
) -> None:
    """There v_bst cannot fall any further, whatever asks its report."""
    course = Course("motor, CAN", 1)
    course.drive.world.boost.settle(170.0, 0.0)
    assert course.begin(), course.daemon.trip
    low, high = course.reach
    course.daemon.accepts(SetSetpoint(low + share * (high - low)))
    step, left = course.drive.world.step, [lost_ticks]

    def lost(current_scale_S: float, bridge: bool) -> Sample:
        left[0] -= 1
        return step(0.0, bridge)

    course.drive.world.step = lost  # type: ignore[method-assign, assignment]
    while left[0] > 0:
        course.half_cycle()
    course.drive.world.step = step  # type: ignore[method-assign]
    course.run(5.0)
    assert course.daemon.state is State.RUNNING, course.daemon.trip
    assert course.drive.world.boost.voltage_V > 200.0
