"""Sources of values: every quantity needs exactly one source, and no name may have two.

`[derived.NAME]`: values that are computed from measured ones, by a rule that is data.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from itertools import chain
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from adaptdrive.config.bus import MEASURED, WORDS
from adaptdrive.config.polled import ModbusLink, RtuLink
from adaptdrive.config.section import WANTED, Converted, misfit, stated_problem
from adaptdrive.util.errors import Flaw

if TYPE_CHECKING:
    from adaptdrive.config.root import Configuration

VOLTAGE_TICKS = 3.0
"""Half cycles from one value of v_bst to the next for a voltage loop in the daemon: it overshoots
by a fiftieth then, with 12 it charges the capacitor past the trip of `boost_voltage_max_V`."""

_DRIVE = (*MEASURED, *WORDS, "heartbeat")

Rule = Literal["sum", "mean", "difference", "product", "ratio", "smallest", "largest"]

_PAIRS = ("difference", "ratio")


class Derived(Converted):
    """`[derived.NAME]`: a quantity of `[signals]`, or any other name, from measured values."""

    rule: Rule
    of: list[str] = Field(min_length=1)
    follows: list[str] | None = None

    @property
    def moved(self) -> list[str]:
        """Names of those values that the load moves."""
        if self.follows is not None:
            return self.follows
        return self.of[:1] if self.rule in _PAIRS else self.of


def moved_inputs(name: str, derived: Mapping[str, Derived]) -> tuple[str, ...]:
    """Return the measured values that the load moves a derived one by; none for a measured one.

    Args:
        name: The value.
        derived: `[derived]`, without cycles.
    """
    if name not in derived:
        return ()
    found = (moved_inputs(part, derived) or (part,) for part in derived[name].moved)
    return tuple(dict.fromkeys(chain.from_iterable(found)))


def in_order(derived: Mapping[str, Derived]) -> list[str]:
    """Names, each after those that it is made of.

    Raises:
        CycleError: A value is made of itself.
    """
    order = TopologicalSorter({name: one.of for name, one in derived.items()}).static_order()
    return [name for name in order if name in derived]


def _derived_flaws(whole: Configuration, given: Collection[str]) -> Iterator[Flaw]:
    """Yield units and rules that do not fit, and values made of nothing or of themselves."""
    unit = whole.drive.manipulated.unit
    wanted = {**WANTED, "boost_voltage_V": unit, "output": whole.load.output_unit}
    for name, one in whole.derived.items():
        place = f"derived.{name}"
        if problem := stated_problem(one, wanted.get(name, "")):
            yield Flaw(place, problem)
        if one.rule in _PAIRS and len(one.of) != 2:
            yield Flaw(f"{place}.of", f"{one.rule!r} takes two values, not {len(one.of)}")
        for part in one.follows or ():
            if part not in one.of:
                yield Flaw(f"{place}.follows", f"{part!r} is not one of {place}.of")
        for part in one.of:
            if part not in given:
                yield Flaw(f"{place}.of", f"no source gives {part!r}")
    try:
        in_order(whole.derived)
    except CycleError as cycle:
        names = cycle.args[1]
        yield Flaw(f"derived.{names[-1]}.of", f"is made of itself: {' from '.join(names[::-1])}")


def supply_flaws(whole: Configuration) -> Iterator[Flaw]:
    """Yield the names that are given twice, needed and not given, or derived from nothing.

    Args:
        whole: The configuration.
    """
    given = [*_givers(whole)]
    names = {name for name, _ in given}
    yield from _repeated(given, "", "given by {} already")
    for name, place in given:
        if name in _DRIVE and place.startswith("signals.other."):
            yield Flaw(place, "is a name of the drive itself")
        elif name in WORDS:
            yield Flaw(place, "comes from the drive alone")
    for name in MEASURED:
        if name not in names and name not in _optional(whole):
            yield Flaw(
                f"signals.{name}",
                "Field required: neither [signals], nor a [[sensor_bus]], nor [derived] gives it",
            )
    yield from _derived_flaws(whole, names)
    period_s = whole.load.period_s
    for number, bus in enumerate(whole.sensor_bus):
        place, period = f"sensor_bus.{number}", f"load.period_s = {period_s}"
        yield from misfit(f"{place}.cycle_s", bus.cycle_s, "at most", period_s, period)
        if isinstance(bus, ModbusLink):
            cycle = f"cycle_s = {bus.cycle_s}"
            yield from misfit(f"{place}.timeout_s", bus.timeout_s, "below", bus.cycle_s, cycle)


def _optional(whole: Configuration) -> tuple[str, ...]:
    """Return the quantities that nobody needs to give."""
    if whole.voltage_loop.where == "daemon":
        return ()
    battery = whole.load.type == "battery"
    return ("line_voltage_V",) if battery else MEASURED[:-1]


def absent_names(whole: Configuration) -> frozenset[str]:
    """Return the quantities that nobody gives.

    Args:
        whole: The configuration.
    """
    return frozenset(MEASURED) - {name for name, _ in _givers(whole)}


def needed_names(derived: Mapping[str, Derived], names: Iterable[str] = MEASURED) -> set[str]:
    """Return every name that values are made of, and their own.

    Args:
        derived: `[derived]`.
        names: Names of the values, the quantities when left out.
    """
    needed = set(names)
    while more := {part for name in needed & derived.keys() for part in derived[name].of} - needed:
        needed |= more
    return needed


def voltage_flaws(whole: Configuration) -> Iterator[Flaw]:
    """Yield the sensor buses whose v_bst is too old for a voltage loop in the daemon.

    Args:
        whole: The configuration.
    """
    if whole.voltage_loop.where == "drive":
        return
    parts, stale_s = needed_names(whole.derived, ("boost_voltage_V",)), whole.interlocks.stale_s
    longest_s = VOLTAGE_TICKS * whole.drive.half_cycle_s
    problem = "is too long for boost_voltage_V with voltage_loop.where = 'daemon': at most"
    for number, bus in enumerate(whole.sensor_bus):
        if parts.isdisjoint(bus.signals):
            continue
        if bus.cycle_s > longest_s:
            limit = f"{longest_s:.4g} s, {VOLTAGE_TICKS:g} half cycles"
            yield Flaw(f"sensor_bus.{number}.cycle_s", f"{bus.cycle_s:g} s {problem} {limit}")
        elif bus.oldest_s > stale_s:
            limit = f"interlocks.stale_s = {stale_s:g} s"
            yield Flaw(f"sensor_bus.{number}.stale_s", f"{bus.oldest_s:.4g} s {problem} {limit}")


def _givers(whole: Configuration) -> Iterator[tuple[str, str]]:
    """Name and place of every value that is given."""
    signals = whole.signals
    for name in MEASURED:
        if getattr(signals, name) is not None:
            yield name, f"signals.{name}"
    tables: dict[str, Iterable[str]] = {
        "signals.other": signals.other,
        "signals.stated": signals.stated,
        **{f"sensor_bus.{i}.signals": bus.signals for i, bus in enumerate(whole.sensor_bus)},
        "derived": whole.derived,
    }
    for place, table in tables.items():
        yield from ((name, f"{place}.{name}") for name in table)


def link_flaws(whole: Configuration) -> Iterator[Flaw]:
    """Yield the names and the serial lines that another bus has already: a line has one master.

    Args:
        whole: The configuration, with its devices from the folder of the file.
    """
    sensors = [(f"sensor_bus.{number}", bus) for number, bus in enumerate(whole.sensor_bus)]
    named = ((bus.name, place) for place, bus in sensors)
    yield from _repeated(named, ".name", "the name of {} already")
    links = [("bus", whole.bus), *sensors]
    lines = ((bus.device.absolute(), place) for place, bus in links if isinstance(bus, RtuLink))
    remedy = "modules on one line are one [[sensor_bus]], with a device_id for each register"
    yield from _repeated(lines, ".device", f"the line of {{}} already; {remedy}")


def _repeated(given: Iterable[tuple[object, str]], key: str, told: str) -> Iterator[Flaw]:
    """Yield what another place has already; `{}` in the text stands for that place."""
    seen: dict[object, str] = {}
    for one, place in given:
        if seen.setdefault(one, place) != place:
            yield Flaw(f"{place}{key}", f"'{one}' is {told.format(seen[one])}")
