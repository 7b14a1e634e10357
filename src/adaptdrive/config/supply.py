"""Sources of values: every quantity needs exactly one source, and no name may have two."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from adaptdrive.config.bus import MEASURED, WORDS, Signals
from adaptdrive.config.derived import Derived, cycle_flaws, rule_flaws
from adaptdrive.config.modbus import RtuLink
from adaptdrive.config.section import Section
from adaptdrive.config.sensors import AnySensorBus
from adaptdrive.errors import Flaw

VOLTAGE_TICKS = 3.0
"""Half cycles from one value of v_bst to the next for a voltage loop in the daemon: it overshoots
by a fiftieth then, with 12 it charges the capacitor past the trip of `boost_voltage_max_V`."""

_DRIVE = (*MEASURED, *WORDS, "heartbeat")


def supply_flaws(
    signals: Signals,
    buses: Sequence[AnySensorBus],
    derived: Mapping[str, Derived],
    optional: Collection[str] = (),
) -> Iterator[Flaw]:
    """Names that are given twice, needed and not given, or derived from nothing.

    Args:
        signals: `[signals]`.
        buses: `[[sensor_bus]]`.
        derived: `[derived]`.
        optional: Quantities that nobody needs to give.
    """
    givers: dict[str, str] = {}
    for name, place in _givers(signals, buses, derived):
        if name in givers:
            yield Flaw(place, f"{name!r} is given by {givers[name]} already")
        givers.setdefault(name, place)
    for name in MEASURED:
        if name not in givers and name not in optional:
            yield Flaw(
                f"signals.{name}",
                "Field required: neither [signals], nor a [[sensor_bus]], nor [derived] gives it",
            )
    yield from _reserved(signals, derived)
    for name, one in derived.items():
        yield from rule_flaws(name, one)
        for part in one.of:
            if part not in givers:
                yield Flaw(f"derived.{name}.of", f"no source gives {part!r}")
    yield from cycle_flaws(derived)
    yield from _name_flaws(buses)


def absent_names(
    signals: Signals, buses: Sequence[AnySensorBus], derived: Mapping[str, Derived]
) -> frozenset[str]:
    """Return the quantities that nobody gives.

    Args:
        signals: `[signals]`.
        buses: `[[sensor_bus]]`.
        derived: `[derived]`.
    """
    return frozenset(MEASURED) - {name for name, _ in _givers(signals, buses, derived)}


def needed_names(derived: Mapping[str, Derived], names: Iterable[str] = MEASURED) -> set[str]:
    """Return every name that values are made of, and their own.

    Args:
        derived: `[derived]`.
        names: Names of the values, the quantities when left out.
    """
    needed: set[str] = set()
    wanted = list(names)
    while wanted:
        name = wanted.pop()
        if name not in needed:
            needed.add(name)
            wanted += derived[name].of if name in derived else []
    return needed


def voltage_flaws(
    half_cycle_s: float,
    stale_s: float,
    buses: Sequence[AnySensorBus],
    derived: Mapping[str, Derived],
) -> Iterator[Flaw]:
    """Yield the sensor buses whose v_bst is too old for a voltage loop in the daemon.

    Args:
        half_cycle_s: Half a line cycle.
        stale_s: `interlocks.stale_s`, in s.
        buses: `[[sensor_bus]]`.
        derived: `[derived]`.
    """
    parts = needed_names(derived, ("boost_voltage_V",))
    longest_s = VOLTAGE_TICKS * half_cycle_s
    problem = "is too long for boost_voltage_V with voltage_loop.where = 'daemon': at most"
    for number, bus in enumerate(buses):
        if parts.isdisjoint(bus.signals):
            continue
        if bus.cycle_s > longest_s:
            limit = f"{longest_s:.4g} s, {VOLTAGE_TICKS:g} half cycles"
            yield Flaw(f"sensor_bus.{number}.cycle_s", f"{bus.cycle_s:g} s {problem} {limit}")
        elif bus.oldest_s > stale_s:
            limit = f"interlocks.stale_s = {stale_s:g} s"
            yield Flaw(f"sensor_bus.{number}.stale_s", f"{bus.oldest_s:.4g} s {problem} {limit}")


def _givers(
    signals: Signals, buses: Sequence[AnySensorBus], derived: Mapping[str, Derived]
) -> Iterator[tuple[str, str]]:
    """Name and place of every value that is given."""
    for name in MEASURED:
        if getattr(signals, name) is not None:
            yield name, f"signals.{name}"
    for kind in ("other", "stated"):
        for name in getattr(signals, kind):
            yield name, f"signals.{kind}.{name}"
    for number, bus in enumerate(buses):
        for name in bus.signals:
            yield name, f"sensor_bus.{number}.signals.{name}"
    for name in derived:
        yield name, f"derived.{name}"


def _reserved(signals: Signals, derived: Mapping[str, Derived]) -> Iterator[Flaw]:
    """Names of quantities in places that cannot give them."""
    for name in signals.other:
        if name in _DRIVE:
            yield Flaw(f"signals.other.{name}", "is a name of the drive itself")
    for place, names in (("derived", derived), ("signals.stated", signals.stated)):
        for name in names:
            if name in WORDS:
                yield Flaw(f"{place}.{name}", "comes from the drive alone")


def _name_flaws(buses: Sequence[AnySensorBus]) -> Iterator[Flaw]:
    """Buses of the same name."""
    seen: dict[str, int] = {}
    for number, bus in enumerate(buses):
        if bus.name in seen:
            yield Flaw(
                f"sensor_bus.{number}.name",
                f"{bus.name!r} is the name of sensor_bus.{seen[bus.name]} already",
            )
        seen.setdefault(bus.name, number)


def line_flaws(bus: Section, buses: Sequence[AnySensorBus]) -> Iterator[Flaw]:
    """Yield the links on a serial line that another one has already: it has one master.

    Args:
        bus: `[bus]`, with its device from the folder of the file.
        buses: `[[sensor_bus]]`, with theirs.
    """
    links = [("bus", bus), *((f"sensor_bus.{number}", one) for number, one in enumerate(buses))]
    seen: dict[Path, str] = {}
    for place, link in links:
        if not isinstance(link, RtuLink):
            continue
        line = link.device.absolute()
        if line in seen:
            yield Flaw(
                f"{place}.device",
                f"'{link.device}' is the line of {seen[line]} already; modules on one line are one "
                "[[sensor_bus]], with a device_id for each register",
            )
        seen.setdefault(line, place)
