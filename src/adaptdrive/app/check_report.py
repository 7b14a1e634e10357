"""The limits of a configuration as `adaptdrive check` shows them: tables, or JSON for programs."""

import math
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from adaptdrive.app import loads, ports
from adaptdrive.app.examine import advice
from adaptdrive.app.settings import machine_limits
from adaptdrive.config import Configuration
from adaptdrive.config.root import DriveSection
from adaptdrive.control.signals import Command, Reach
from adaptdrive.devices.bus import Row
from adaptdrive.runtime.accounts import WINDOW_S
from adaptdrive.runtime.settings import MachineLimits
from adaptdrive.safety.facts import Reading
from adaptdrive.safety.guard import CapacitorBalance
from adaptdrive.safety.plausibility import ResponseLimits
from adaptdrive.util.errors import ConfigurationError, escaped

# Highest v_bst that a report which fails can lead to, as `adaptdrive check` states it.

_FOLLOWED_TICKS: Final = 240
"""Half cycles after which every report that fails has tripped."""


def highest_voltages(drive: DriveSection, trip_V: float) -> tuple[float, float]:
    """Return the highest v_bst, in V, that a silent and a frozen report can lead to.

    Either begins at the highest V_c with the largest k on its way that is allowed there, and the
    largest k is asked for from then on. The load stops as the report does; a silent drive seems to
    take its power further on. A report that is frozen at rest is asked when the energy that it does
    not show could have led to the limit.

    Args:
        drive: The drive.
        trip_V: The limit.
    """
    load_W, tick_s = drive.limits.load_power_max_W, drive.half_cycle_s
    silent_V = _highest_V(drive, trip_V, (load_W, load_W), 0.0)
    frozen_V = _highest_V(drive, trip_V, (load_W, 0.0), tick_s)
    return silent_V, max(frozen_V, trip_V)


def _highest_V(
    drive: DriveSection, trip_V: float, load_W: tuple[float, float], step_s: float
) -> float:
    """Return the highest true v_bst of a drive on a line of 1 V, for which k is a power in W.

    Args:
        drive: The drive.
        trip_V: The limit.
        load_W: Reported power of the load before and after it stops.
        step_s: Time from a report of v_bst to the next after that.
    """
    balance, tick_s = CapacitorBalance(drive, trip_V), drive.half_cycle_s
    reference_V = drive.limits.boost_reference_max_V
    asked = Command(drive.largest_W, reference_V, bridge=True)
    coming_W, squared_V2, cause = 0.0, reference_V**2, None
    for tick in range(-1, _FOLLOWED_TICKS):
        time_s, power_W = tick * (tick_s if tick < 0 else step_s), load_W[tick >= 0]
        reading = Reading(time_s, time_s, None, reference_V, 1.0, power_W, 0.0, 0, bridge=True)
        cause = cause or balance.find_cause(reading, 1, tick_s, running=True)
        squared_V2 += 2.0 * tick_s / drive.boost_capacitance_F * coming_W
        coming_W = 0.0 if cause else balance.bound(asked).current_scale_S
        balance.sent(coming_W)
    return math.sqrt(squared_V2)


# The limits of a configuration as `adaptdrive check` shows them: tables, or JSON for programs.

Fact = tuple[str, str, str]
"""What is limited, its limit, and the keys that set it."""

_WHOLE_TICKS = 1e4
"""Number of half cycles from which on all digits are printed."""


def tables(configuration: Configuration, source: Path) -> str:
    """Return the limits of a configuration that can be used as lines of text.

    Args:
        configuration: The configuration.
        source: Its file.
    """
    head = f"{'trips after':36} {'ms':>9} {'ticks':>8}  by"
    tick_s = configuration.drive.half_cycle_s
    limits = (_limit(*row, tick_s) for row in time_limits(configuration, source))
    facts = (f"{what:36} {value:>18}  {keys}" for what, value, keys in _facts(configuration))
    return "\n".join((head, *limits, *facts))


def time_limits(configuration: Configuration, source: Path | str) -> list[Row]:
    """Return the limits of time that are in force, 0 for none.

    Args:
        configuration: The drive.
        source: The configuration's file.
    """
    interlocks, supervisor = configuration.interlocks, configuration.supervisor
    refused_s = WINDOW_S if interlocks.refused_share else 0.0
    return [
        *ports.bus_kind(configuration.bus.type, source).time_limits(configuration, source),
        *_sensor_rows(configuration),
        ("daemon not running", interlocks.stale_s, "interlocks.stale_s"),
        ("starting", interlocks.precharge_timeout_s, "interlocks.precharge_timeout_s"),
        ("share of refused frames", refused_s, "interlocks.refused_share"),
        ("output standing still", interlocks.stuck_s, "interlocks.stuck_s"),
        ("input at its limit, no response", supervisor.response_s, "supervisor.response_s"),
    ]


def _limit(what: str, limit_s: float, keys: str, tick_s: float) -> str:
    if not limit_s:
        return f"{what:36} {'never':>9} {'':>8}  {keys} = 0"
    ticks = limit_s / tick_s
    number = f"{ticks:.4g}" if ticks < _WHOLE_TICKS else f"{ticks:.0f}"
    return f"{what:36} {limit_s * 1e3:9.9g} {number:>8}  {keys}"


def _sensor_rows(configuration: Configuration) -> Iterator[Row]:
    for bus in configuration.sensor_bus:
        keys = "sensor_bus.cycle_s" if bus.stale_s is None else "sensor_bus.stale_s"
        for name in bus.signals:
            yield f"stale {bus.name}.{name}", bus.oldest_s, keys


def _facts(configuration: Configuration) -> Iterator[Fact]:
    """Yield the limits that are no times."""
    machine = machine_limits(configuration)
    yield from _watched(configuration)
    yield from _start(configuration, machine)
    yield from _capacitor(configuration)
    yield from _reach(configuration, machine.reach)
    poles = f"{machine.pole_min:g}…{machine.pole_max:g}"
    yield "poles an operator may ask for", poles, "load.pole, load.model"
    yield from _response(loads.response_limits(configuration))


def _watched(configuration: Configuration) -> Iterator[Fact]:
    """Yield the words whose faults trip, and those whose warnings are events."""
    for key, one in configuration.signals.watched():
        verb = "tells warnings of" if key.startswith("warning") else "trips on faults of"
        bits = "all bits" if one.mask is None else f"bits {one.mask:#x}"
        but = ", ".join(str(value) for value in one.healthy)
        yield f"{verb} {one.signal}", f"all but {but}" if but else bits, f"signals.{key}"


def _start(configuration: Configuration, machine: MachineLimits) -> Iterator[Fact]:
    """Yield what a drive gives before its load is fed, and whether its enable bit is on then."""
    given = configuration.drive.given
    if machine.precharges:
        bit = "on" if machine.drive.boost_needs_bridge else "off"
        keys = f"drive.limits.boost_reference_min_V; its enable bit is {bit} before"
        yield f"starts at {given.name} of", given.text(machine.floor_V, "g"), keys


def _capacitor(configuration: Configuration) -> Iterator[Fact]:
    """Yield the highest v_bst that a failing report can lead to."""
    if configuration.voltage_loop.where == "drive":
        return
    found = highest_voltages(configuration.drive, configuration.interlocks.boost_voltage_max_V)
    for report, voltage_V in zip(("silent", "frozen"), found, strict=True):
        keys = "drive.limits, drive.boost_capacitance_F, interlocks.boost_voltage_max_V"
        yield f"highest v_bst, its report {report}", f"{voltage_V:.0f} V", keys


def _reach(configuration: Configuration, reach: Reach) -> Iterator[Fact]:
    """Yield the reachable set-points."""
    load, held = configuration.load, f"set-points held by {configuration.drive.given.symbol}"
    if load.output_display is not None:
        shown = load.display.range_text(load.reference_min, load.reference_max)
        yield "set-points as people see and type them", shown, "load.output_display"
    if not reach.is_known:
        yield held, "found while running", "the battery's EMF, which no key states"
        return
    low, high = max(reach.low, load.reference_min), min(reach.high, load.reference_max)
    yield held, load.display.range_text(low, high), "load.model"
    if load.reference_min < reach.low:
        yield "set-points below this range", "refused", "load.reference_min; 0 coasts"
    if load.reference_max > reach.high:
        yield "set-points above this range", "refused", "load.reference_max"


def _response(limits: ResponseLimits | None) -> Iterator[Fact]:
    """Yield when an output is too low."""
    factor = "interlocks.response_factor"
    if limits is None:
        yield "trips on a low output", "never", f"{factor} = 0"
        return
    keys = f"{factor}, in force: {limits.factor:g}"
    for inputs, share in (("largest input", 1.0), ("half of it", 0.5)):
        level = limits.at_rest(share * limits.input_max) - limits.margin
        what = f"trips at rest, {inputs}, below"
        yield what, limits.display.text(level, ".4g"), keys
    if not limits.by_power:
        slowest_s = limits.factor * sum(limits.lags_s)
        yield "this level rises with a lag of", f"{slowest_s:.4g} s", keys
        fastest = f"{limits.fastest_s:.4g} s"
        yield "trips on a fall faster than a lag of", fastest, f"{factor} > 0"


Report = dict[str, Any]


def sound_report(configuration: Configuration, source: Path) -> Report:
    """Return the report of a configuration that can be used; a limit of 0 s is none.

    Args:
        configuration: The configuration.
        source: Its file.
    """
    load, machine = configuration.load, machine_limits(configuration)
    return {
        "config": escaped(str(source)),
        "valid": True,
        "flaws": [],
        "warnings": [str(one) for one in advice(configuration)],
        "drive": configuration.drive.name,
        "output": {
            "name": load.output_name,
            "unit": load.output_unit,
            "display": asdict(load.display) if load.output_display else None,
        },
        "manipulated": asdict(configuration.drive.given),
        "reach": [machine.reach.low, machine.reach.high],
        "poles": [machine.pole_min, machine.pole_max],
        "time_limits": [
            {"of": what, "limit_s": limit_s, "keys": keys}
            for what, limit_s, keys in time_limits(configuration, source)
        ],
    }


def flawed_report(problem: ConfigurationError) -> Report:
    """Return the report of a configuration that cannot be used.

    Args:
        problem: Its flaws.
    """
    flaws = [{"place": one.place, "message": one.message} for one in problem.flaws]
    return {"config": escaped(str(problem.source)), "valid": False, "flaws": flaws}
