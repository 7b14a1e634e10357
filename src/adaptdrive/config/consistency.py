"""Checks between the sections of a configuration: paces, supplied quantities, commands, limits."""

import math
from collections.abc import Callable, Collection, Iterable, Iterator
from graphlib import CycleError
from operator import attrgetter

from adaptdrive.config import references, root, section
from adaptdrive.config.bus import WORDS, CanBus, CanOpenBus
from adaptdrive.config.load import MotorSection
from adaptdrive.config.polled import ModbusBus, ModbusLink, PolledBus, RtuLink
from adaptdrive.util.errors import Flaw
from adaptdrive.util.quantity import MEASURED

LATE_READINGS = 1.5
"""Readings until one that is late has come: a stand-in tick is half a reading late."""


def pace_flaws(whole: root.Configuration) -> Iterator[Flaw]:
    """Yield what does not fit a drive that gives a reading every so many half cycles.

    Args:
        whole: The configuration.
    """
    bus, stride = whole.bus, whole.bus.ticks_per_reading
    reading_s = stride * whole.drive.half_cycle_s
    late_s = LATE_READINGS * reading_s
    if isinstance(bus, PolledBus):
        reading = f"one poll of bus.poll_ticks = {stride} half cycles"
        poll = f"{reading} ({reading_s * 1e3:.4g} ms)"
        yield from section.misfit("bus.timeout_s", bus.timeout_s, "below", reading_s, poll)
    elif isinstance(bus, CanBus):
        reading = f"bus.clock_ticks = {stride}"
    else:
        reading = "a half cycle, from one SYNC to the next"
    latest = f"{late_s:.4g} s, {LATE_READINGS} times {reading} ({reading_s * 1e3:.4g} ms)"
    stale_s = whole.interlocks.stale_s
    yield from section.misfit("interlocks.stale_s", stale_s, "at least", late_s, latest)
    if not isinstance(bus, CanOpenBus) and bus.command_timeout_s is not None:
        stops = f"{latest}: the drive would stop between two commands"
        yield from section.misfit(
            "bus.command_timeout_s", bus.command_timeout_s, "at least", late_s, stops
        )
    yield from _loop_flaws(whole, reading)
    if isinstance(bus, ModbusBus):
        yield from _write_flaws(bus, whole, late_s)


def _loop_flaws(whole: root.Configuration, reading: str) -> Iterator[Flaw]:
    """The loops of the daemon act with the readings of the drive."""
    stride, signals, load = whole.bus.ticks_per_reading, whole.signals, whole.load
    polled = isinstance(whole.bus, PolledBus)
    if whole.voltage_loop.where == "daemon":
        if polled or stride > 1:
            seldom = f"with {reading} it must hold its own boost voltage: 'drive'"
            needed = f"'daemon' needs a drive that sends each half cycle; {seldom}"
            yield Flaw("voltage_loop.where", needed)
    elif polled and signals.command.current_scale_S is not None:
        yield Flaw("signals.command.current_scale_S", "a drive that is polled takes V_c only")
    if stride > 1 and isinstance(whole.bus, CanBus) and signals.counter is not None:
        yield Flaw("signals.counter", "counts half cycles, which needs bus.clock_ticks = 1")
    for name, ticks, multiple in (
        ("latency_ticks", load.latency_ticks, "a multiple"),
        ("period_s", whole.ticks_per_period, "a whole multiple"),
    ):
        if ticks % stride:
            wanted = f"its {ticks} ticks must be {multiple} of {reading}"
            yield Flaw(f"load.{name}", f"{wanted}: a decision reaches the drive with a command")


def _write_flaws(bus: ModbusBus, whole: root.Configuration, late_s: float) -> Iterator[Flaw]:
    """Yield why a command that is not written with each poll would not do."""
    place, interval_s = "bus.command_interval_s", bus.command_interval_s
    longest_s = max(0.0, (bus.command_timeout_s or math.inf) - late_s)
    in_time = f"{longest_s:.4g} s, that the drive sees a command in time"
    yield from section.misfit(place, interval_s, "at most", longest_s, in_time)
    places = [place] if interval_s else []
    for name, register in bus.registers.items():
        if register.write_limit is not None:
            places.append(f"bus.registers.{name}.write_limit")
            yield from _limit_flaws(places[-1], name, register.write_limit, whole)
    if bus.write == "with-read":
        problem = "bus.write = 'with-read' writes with each poll: leave it out"
        yield from (Flaw(place, problem) for place in places)


def _limit_flaws(place: str, name: str, limit: int, whole: root.Configuration) -> Iterator[Flaw]:
    """Yield why a register that wears out is written too often, or too late."""
    if whole.bus.command_timeout_s is not None:
        yield Flaw(place, "bus.command_timeout_s is the time-out of a drive that needs writes")
    reference = whole.signals.command.boost_reference_V
    holds_back = whole.load.traits.charges or whole.signals.load_power_W
    if holds_back and reference is not None and reference.signal == name:
        why = "delays what holds V_c back for the power of the load or the voltage of a battery"
        yield Flaw(place, why)
    least_s = references.DAY_S / limit
    if whole.load.period_s < least_s:
        longer = f"let load.period_s be {least_s:.4g} s or longer"
        yield Flaw(place, f"{limit} writes a day are one in {least_s:.4g} s: {longer}")


_DRIVE = (*MEASURED, *WORDS, "heartbeat")


def _derived_flaws(whole: root.Configuration, given: Collection[str]) -> Iterator[Flaw]:
    """Yield units and rules that do not fit, and values made of nothing or of themselves."""
    unit = whole.drive.manipulated.unit
    wanted = {**section.WANTED, "boost_voltage_V": unit, "output": whole.load.output_unit}
    for name, one in whole.derived.items():
        place = f"derived.{name}"
        if problem := section.stated_problem(one, wanted.get(name, "")):
            yield Flaw(place, problem)
        if one.rule in root.PAIRS and len(one.of) != 2:
            yield Flaw(f"{place}.of", f"{one.rule!r} takes two values, not {len(one.of)}")
        for part in one.follows or ():
            if part not in one.of:
                yield Flaw(f"{place}.follows", f"{part!r} is not one of {place}.of")
        for part in one.of:
            if part not in given:
                yield Flaw(f"{place}.of", f"no source gives {part!r}")
    try:
        root.in_order(whole.derived)
    except CycleError as cycle:
        names = cycle.args[1]
        yield Flaw(f"derived.{names[-1]}.of", f"is made of itself: {' from '.join(names[::-1])}")


def supply_flaws(whole: root.Configuration) -> Iterator[Flaw]:
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
        yield from section.misfit(f"{place}.cycle_s", bus.cycle_s, "at most", period_s, period)
        if isinstance(bus, ModbusLink):
            cycle_s, cycle = bus.cycle_s, f"cycle_s = {bus.cycle_s}"
            yield from section.misfit(f"{place}.timeout_s", bus.timeout_s, "below", cycle_s, cycle)


def _optional(whole: root.Configuration) -> tuple[str, ...]:
    """Return the quantities that nobody needs to give."""
    if whole.voltage_loop.where == "daemon":
        return ()
    battery = whole.load.type == "battery"
    return ("line_voltage_V",) if battery else MEASURED[:-1]


def absent_names(whole: root.Configuration) -> frozenset[str]:
    """Return the quantities that nobody gives.

    Args:
        whole: The configuration.
    """
    return frozenset(MEASURED) - {name for name, _ in _givers(whole)}


def voltage_flaws(whole: root.Configuration) -> Iterator[Flaw]:
    """Yield the sensor buses whose v_bst is too old for a voltage loop in the daemon.

    Args:
        whole: The configuration.
    """
    if whole.voltage_loop.where == "drive":
        return
    parts = root.needed_names(whole.derived, ("boost_voltage_V",))
    stale_s = whole.interlocks.stale_s
    longest_s = root.VOLTAGE_TICKS * whole.drive.half_cycle_s
    problem = "is too long for boost_voltage_V with voltage_loop.where = 'daemon': at most"
    for number, bus in enumerate(whole.sensor_bus):
        if parts.isdisjoint(bus.signals):
            continue
        if bus.cycle_s > longest_s:
            limit = f"{longest_s:.4g} s, {root.VOLTAGE_TICKS:g} half cycles"
            yield Flaw(f"sensor_bus.{number}.cycle_s", f"{bus.cycle_s:g} s {problem} {limit}")
        elif bus.oldest_s > stale_s:
            limit = f"interlocks.stale_s = {stale_s:g} s"
            yield Flaw(f"sensor_bus.{number}.stale_s", f"{bus.oldest_s:.4g} s {problem} {limit}")


def _givers(whole: root.Configuration) -> Iterator[tuple[str, str]]:
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


def link_flaws(whole: root.Configuration) -> Iterator[Flaw]:
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


def _repeated(given: Iterable[tuple[object, str]], key: str, text: str) -> Iterator[Flaw]:
    """Yield what another place has already; `{}` in the text stands for that place."""
    seen: dict[object, str] = {}
    for one, place in given:
        if seen.setdefault(one, place) != place:
            yield Flaw(f"{place}{key}", f"'{one}' is {text.format(seen[one])}")


def _rate_flaws(whole: root.Configuration) -> Iterator[Flaw]:
    load, ticks = whole.load, whole.ticks_per_period
    half_cycle_s = whole.drive.half_cycle_s
    if ticks < 1 or not math.isclose(load.period_s, ticks * half_cycle_s, rel_tol=1e-6):
        rule = f"must be a whole number of half cycles of {half_cycle_s:.6g} s"
        yield Flaw("load.period_s", f"{load.period_s} {rule}")
    period = f"the {ticks} ticks of one period"
    if load.samples > ticks:
        yield Flaw("load.samples", f"{load.samples} exceeds {period}")
    yield from section.misfit("load.latency_ticks", load.latency_ticks, "below", ticks, period)


def _command_flaws(whole: root.Configuration) -> Iterator[Flaw]:
    where = whole.voltage_loop.where
    needed = ["current_scale_S" if where == "daemon" else "boost_reference_V"]
    stopped = where == "drive" and whole.drive.boost_needs_bridge  # by a set-point of 0
    if not (stopped or whole.bus.has_bridge_words):
        needed.append("bridge")
    for name in needed:
        why = f"voltage_loop.where = {where!r} needs it"
        if name == "bridge" and where == "drive":
            why = "nothing would switch the drive off; a drive that a set-point of 0 stops needs "
            why += "drive.enable_bit = 'bridge-and-boost'"
        if getattr(whole.signals.command, name) is None:
            yield Flaw(f"signals.command.{name}", f"is missing: {why}")


def _lowest_flaws(whole: root.Configuration) -> Iterator[Flaw]:
    """The lowest V_c is one that the stage can make, and the load bears."""
    unit = whole.drive.manipulated.unit
    if whole.voltage_loop.where == "daemon" and unit != "V":
        yield Flaw("drive.manipulated.unit", f"{unit!r} needs voltage_loop.where = 'drive'")
    drive, lowest_V = whole.drive, whole.drive.limits.boost_reference_min_V
    place = "drive.limits.boost_reference_min_V"
    peak = drive.line_voltage_V * 2**0.5
    if whole.voltage_loop.where == "daemon" and lowest_V <= peak:
        yield Flaw(place, f"{lowest_V} must be above the line's peak of {peak:.1f} V")
    elif lowest_V < 0.0 and whole.load.type != "motor":
        kind = whole.load.type
        yield Flaw(place, f"{lowest_V} must not be below 0: a {kind} has no direction")


def _lag_flaws(whole: root.Configuration) -> Iterator[Flaw]:
    lag_s, period_s = whole.voltage_loop.lag_s, whole.load.period_s
    if lag_s is None:
        return
    if whole.voltage_loop.where == "daemon":
        problem = "is for where = 'drive': the delay of the daemon's own loop is known"
        yield Flaw("voltage_loop.lag_s", problem)
    else:
        longest = f"load.period_s = {period_s} s: choose a longer period"
        yield from section.misfit("voltage_loop.lag_s", lag_s, "at most", period_s, longest)
    impulse = isinstance(whole.load, MotorSection) and whole.load.boost_course == "impulse"
    if impulse and lag_s > 0.25 * period_s:
        yield Flaw("load.boost_course", f"'impulse' needs voltage_loop.lag_s = {lag_s} s shorter")


def _trip_flaws(whole: root.Configuration) -> Iterator[Flaw]:
    for place, relation, limit in (
        ("interlocks.boost_voltage_max_V", "above", "drive.limits.boost_reference_max_V"),
        ("interlocks.output_max", "above", "load.reference_max"),
        ("interlocks.output_min", "below", "load.reference_min"),
    ):
        trip, highest = attrgetter(place)(whole), attrgetter(limit)(whole)
        if trip is not None:
            yield from section.misfit(place, trip, relation, highest, f"{limit} = {highest}")


_CHECKS: dict[Callable[[root.Configuration], Iterator[Flaw]], str] = {
    _rate_flaws: "drive load",
    lambda whole: references.reference_flaws(whole.bus, whole.signals): "bus signals",
    link_flaws: "bus sensor_bus",
    pace_flaws: "drive bus signals load interlocks voltage_loop",
    supply_flaws: "drive bus signals sensor_bus derived load voltage_loop",
    _lowest_flaws: "drive voltage_loop load",
    voltage_flaws: "drive voltage_loop interlocks sensor_bus derived",
    _command_flaws: "bus signals voltage_loop drive",
    _lag_flaws: "voltage_loop load",
    _trip_flaws: "drive load interlocks",
}
"""Checks between sections, and the sections that each one reads."""


def consistency_flaws(configuration: root.Configuration, valid: Collection[str]) -> Iterator[Flaw]:
    """Find what contradicts each other between sections.

    Args:
        configuration: The sections.
        valid: Names of those that are there; checks of others are left out.
    """
    for check, needed in _CHECKS.items():
        if set(needed.split()).issubset(valid):
            yield from check(configuration)
