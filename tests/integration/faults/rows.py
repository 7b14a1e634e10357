"""Faults of sensors, plants, actuators, drives and links: one row each, with its bound.

A row puts its fault into a course. It says what must follow: a trip for one of some causes within
a bound, or a drive that rides through.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from adaptdrive.control.signals import Command
from adaptdrive.runtime.requests import Disable
from adaptdrive.safety.facts import Reading
from adaptdrive_sim.plants.bath import Bath
from adaptdrive_sim.plants.battery import Battery
from adaptdrive_sim.plants.boost import SAG_MAX_s
from adaptdrive_sim.plants.motor import Motor
from tests.integration.faults.course import Course, weaker
from tests.support import a_trip

MOTORS = ("motor, CAN", "motor, Modbus")
BATHS = ("bath, Modbus",)
BATTERY = ("battery, CAN",)
EVERY = (*MOTORS, *BATHS, *BATTERY)
QUICK = ("motor, CAN", "motor, Modbus", "battery, CAN")

Put = Callable[[Course], None]

UNPLUGGED_s = 0.25
"""Longer than the time-out of the simulated drives on CAN, 0.1 s."""


@dataclass(frozen=True, slots=True)
class Row:
    """One fault.

    Attributes:
        group: Part of the plant that fails.
        fault: What happens.
        put: Puts it into a course.
        loads: Where it can happen.
        bound_s: Longest time to the trip by kind of load; without a load none is promised.
        causes: Beginnings of the trips that name it; empty for a drive that must ride through.
        step: Whether the set-point moves after the fault.
        mends: Whether the fault can be ended, so that the drive must run again.
        sticks_on: Whether the load stays on whatever is commanded.
        from_start: Whether it is there before the drive is enabled.
        stale_s: `interlocks.stale_s` where it is not that of the example.
    """

    group: str
    fault: str
    put: Put
    loads: tuple[str, ...] = EVERY
    bound_s: dict[str, float] | None = None
    causes: tuple[str, ...] = ()
    step: bool = True
    mends: bool = True
    sticks_on: bool = False
    from_start: bool = False
    stale_s: float | None = None


def _sensor(read: Callable[[Course, float, float], float]) -> Put:
    def put(course: Course) -> None:
        course.sensor = lambda age_s, output: read(course, age_s, output)

    return put


def _stuck(course: Course) -> None:
    held = course.drive.world.true_output
    course.sensor = lambda *_: held
    course.sigma = 0.0


def _coarse(course: Course) -> None:
    digit = 0.01 * course.span
    course.sensor = lambda _, output: round(output / digit) * digit


def _late(readings: int) -> Put:
    def put(course: Course) -> None:
        course.lags = readings

    return put


def _spikes(course: Course) -> None:
    def read(_: float, output: float) -> float:
        height = 0.1 * course.span if course.draw.random() < 0.02 else 0.0
        return output + course.draw.choice([-1.0, 1.0]) * height

    course.sensor = read


def _seized(course: Course) -> None:
    load = course.drive.world.load
    assert isinstance(load, Motor)
    load.torque_Nm = 100.0


def _brake(course: Course) -> None:
    load = course.drive.world.load
    assert isinstance(load, Motor)
    load.torque_Nm = 4.0


def _broken_heater(course: Course) -> None:
    course.drive.world.load.resistance_Ohm = 1e6


def _empty_bath(course: Course) -> None:
    load = course.drive.world.load
    assert isinstance(load, Bath)
    load.fill(0.05)


def _torrent(course: Course) -> None:
    load = course.drive.world.load
    assert isinstance(load, Bath)
    load.inflow_L_per_min = 5.0


def _shorted_cell(course: Course) -> None:
    load = course.drive.world.load
    assert isinstance(load, Battery)
    load.parameters = replace(load.parameters, cells=load.parameters.cells - 1)


def _actuator(take: Callable[[Command], Command | None]) -> Put:
    def put(course: Course) -> None:
        course.actuator = take

    return put


def _stuck_on(course: Course) -> None:
    course.actuator = lambda command: replace(command, bridge=True)
    course.daemon.accepts(Disable())


def _losing(share: float, in_a_row: float) -> Put:
    """Lose a share of the readings, never more than some of them in a row."""

    def put(course: Course) -> None:
        lost = 0

        def keep(reading: Reading) -> Reading | None:
            nonlocal lost
            lost = lost + 1 if lost < in_a_row and course.draw.random() < share else 0
            return None if lost else reading

        course.frame = keep

    return put


def _frame(change: Callable[[Course, Reading], Reading | None]) -> Put:
    def put(course: Course) -> None:
        course.frame = lambda reading: change(course, reading)

    return put


def _boost_stuck(course: Course) -> None:
    held_V = course.drive.world.boost.voltage_V
    course.frame = lambda reading: replace(reading, boost_voltage_V=held_V)


def _scaled(name: str, factor: float) -> Put:
    """Return the wrong scale of one measured quantity of the drive."""
    return _frame(lambda _, r: replace(r, **{name: factor * getattr(r, name)}))


def _line(course: Course) -> None:
    course.drive.world.line.sag(0.75, SAG_MAX_s)


def _frozen(course: Course) -> None:
    end_s = course.daemon.now + 1.0
    while course.daemon.now < end_s:
        course.daemon.sleep(course.daemon.now + course.drive.world.line.half_cycle_s)
        course.drive.tick(course.daemon.now)


def _unplugged(course: Course) -> None:
    """Nothing passes either way for a while that makes no measurement stale."""
    end_s = course.daemon.now + UNPLUGGED_s
    course.frame = lambda reading: reading if course.daemon.now > end_s else None
    course.actuator = lambda command: command if course.daemon.now > end_s else None


def _stalled(course: Course) -> None:
    course.decides = False


def _complaint(course: Course) -> None:
    course.daemon.port.trip_cause = a_trip("another sender commands this drive")


NO_RESPONSE = ("no response", "stuck", "output", "load", "error")
STALE = ("stale", "overslept", "drive stopped")

WRONG_BOOST = (*NO_RESPONSE, "drive fault", "over-voltage", "v_bst: ")
WRONG_SUPPLY = (*WRONG_BOOST, "output above its limit")

ROWS: tuple[Row, ...] = (
    Row("sensor", "stuck, then a step", _stuck, EVERY, {"motor": 45.0, "bath": 250.0}, NO_RESPONSE),
    Row("sensor", "drifts up by 1 % of the range per second",
        _sensor(lambda c, t, y: y + 0.01 * c.span * t), EVERY, None, NO_RESPONSE),
    Row("sensor", "decays with 3 s", _sensor(lambda _, t, y: y * math.exp(-t / 3.0)), EVERY,
        {"motor": 60.0, "bath": 60.0, "battery": 10.0}, NO_RESPONSE),
    Row("sensor", "reversed", _sensor(lambda _, __, y: -y), EVERY,
        {"motor": 1.0, "bath": 1.0, "battery": 10.0}, NO_RESPONSE),
    Row("sensor", "open: reads 0", _sensor(lambda *_: 0.0), EVERY,
        {"motor": 1.0, "bath": 1.0, "battery": 5.0}, NO_RESPONSE),
    Row("sensor", "last digit of 1 % of the range, from the start", _coarse, from_start=True),
    Row("sensor", "last digit becomes 1 % of the range", _coarse,
        causes=(*NO_RESPONSE, "limit cycle")),
    Row("sensor", "scale × 0.8", _sensor(lambda _, __, y: 0.8 * y)),
    Row("sensor", "1 reading late", _late(1)),
    Row("sensor", "3 readings late", _late(3)),
    Row("sensor", "5 readings late", _late(5)),
    Row("sensor", "spikes of 10 % of the range in 2 % of the readings", _spikes),
    Row("sensor", "v_bst stuck, then a step", _boost_stuck, EVERY, None, WRONG_BOOST, mends=False),
    Row("sensor", "v_bst reads 0", _scaled("boost_voltage_V", 0.0), EVERY, None, WRONG_BOOST,
        mends=False),
    Row("sensor", "scale of v_bst × 0.8", _scaled("boost_voltage_V", 0.8), EVERY, None,
        WRONG_BOOST, mends=False),
    Row("sensor", "scale of the line voltage × 0.5", _scaled("line_voltage_V", 0.5), EVERY, None,
        WRONG_SUPPLY),
    Row("sensor", "scale of the load power × 3", _scaled("load_power_W", 3.0), EVERY, None,
        WRONG_SUPPLY),
    Row("sensor", "load power reads 0", _scaled("load_power_W", 0.0), EVERY, None, WRONG_SUPPLY),
    Row("plant", "seized shaft", _seized, MOTORS, {"motor": 75.0}, NO_RESPONSE, mends=False),
    Row("plant", "load beyond the drive: 4 N m", _brake, MOTORS, mends=False),
    Row("plant", "broken heater", _broken_heater, BATHS, {"bath": 900.0}, NO_RESPONSE, mends=False),
    Row("plant", "empty bath", _empty_bath, BATHS, mends=False),
    Row("plant", "inflow × 7: beyond the heater", _torrent, BATHS, mends=False),
    Row("plant", "shorted cell", _shorted_cell, BATTERY, mends=False),
    Row("actuator", "deaf, stops by its own time-out", _actuator(lambda _: None), EVERY,
        dict.fromkeys(("motor", "bath", "battery"), 2.5), STALE),
    Row("actuator", "half as strong", _actuator(weaker(0.5)), EVERY, None, WRONG_BOOST),
    Row("actuator", "bridge stuck on, at a disable", _stuck_on, EVERY,
        dict.fromkeys(("motor", "bath", "battery"), 1.5), ("the drive does not stop",),
        step=False, sticks_on=True),
    Row("drive", "reports a fault", _frame(lambda _, r: replace(r, fault=2)), EVERY,
        dict.fromkeys(("motor", "bath", "battery"), 0.15), ("drive fault",)),
    Row("drive", "output is no number", _frame(lambda _, r: replace(r, output=math.nan)), EVERY,
        dict.fromkeys(("motor", "bath", "battery"), 0.15), ("invalid",)),
    Row("drive", "line at a quarter", _line, EVERY,
        dict.fromkeys(("motor", "bath", "battery"), 0.5), ("drive fault",), mends=False),
    Row("link", "one reading in ten lost, at most two in a row", _losing(0.1, 2)),
    Row("link", "one reading in ten lost", _losing(0.1, math.inf), causes=STALE),
    Row("link", "silent", _frame(lambda *_: None), EVERY,
        dict.fromkeys(("motor", "bath", "battery"), 0.6), STALE),
    Row("link", "cable out for less than stale_s, longer than the drive's own time-out", _unplugged,
        ("motor, CAN", *BATTERY), dict.fromkeys(("motor", "battery"), 0.35), ("drive stopped",),
        stale_s=0.5),
    Row("link", "another sender commands", _complaint, EVERY,
        dict.fromkeys(("motor", "bath", "battery"), 0.15), ("another sender",)),
    Row("clock", "daemon frozen for 1 s", _frozen, EVERY,
        dict.fromkeys(("motor", "bath", "battery"), 1.15), STALE),
    Row("clock", "slow loop stalled", _stalled, ("motor, CAN", "motor, Modbus", *BATTERY),
        {"motor": 5.0, "battery": 45.0}, ("slow loop",)),
)  # fmt: skip

GROUPS = tuple(dict.fromkeys(row.group for row in ROWS))
