"""What is wrong with a configuration, or probably not meant, before a bus is opened."""

import functools
import ipaddress
import math
import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from adaptdrive.app import loads, ports, recording
from adaptdrive.app.settings import controller_settings
from adaptdrive.config import Configuration, consistency, file, polled
from adaptdrive.config.bus import CanDescription, SignalSource
from adaptdrive.config.load import BathSection, BatterySection
from adaptdrive.control.loads.load import to_input, to_voltage
from adaptdrive.control.supervision.setpoints import nominal_reach
from adaptdrive.devices.description import NO_DEMANDS, demands_of
from adaptdrive.safety.timing import timing_of
from adaptdrive.util.clock import now_s
from adaptdrive.util.errors import ConfigurationError, Flaw, nearest

_OF_PORT = frozenset({"drive", "bus", "signals", "voltage_loop", "load", "interlocks"})


def load_examined(path: Path) -> Configuration:
    """Read a configuration and hold it against its DBC, EDS or register map.

    Raises:
        ConfigurationError: There are flaws; those of every kind are listed.
    """
    return examine_text(file.read_text(path), path)


def examine_text(text: str, path: Path) -> Configuration:
    """Hold the text of a configuration against its DBC, EDS or register map.

    Args:
        text: The text.
        path: The file that it came from.

    Raises:
        ConfigurationError: There are flaws; those of every kind are listed.
    """
    configuration, _, flaws = findings = file.find_flaws(text, path)
    found = file.added(flaws, _description_flaws(findings, path))
    if not flaws:
        found = (*found, *implausible(configuration))
    if found:
        raise ConfigurationError(path, found)
    return configuration


def _description_flaws(findings: file.Findings, path: Path) -> Iterator[Flaw]:
    """Yield the errors in the files and maps that describe drive and sensors."""
    configuration, valid, flaws = findings
    whole = valid >= _OF_PORT
    if whole and not (
        # names in `[signals]` can be looked up in a valid register map alone
        isinstance(configuration.bus, polled.ModbusBus | polled.ScpiBus)
        and any(flaw.place.startswith(("bus", "signals")) for flaw in flaws)
    ):
        yield from _flaws_of(lambda: ports.build_port(configuration, now_s, path))
    if "sensor_bus" not in valid:
        return
    demands = demands_of(configuration) if whole else NO_DEMANDS
    for number, bus in enumerate(configuration.sensor_bus):
        place = f"sensor_bus.{number}"
        build = functools.partial(ports.build_sensor_port, bus, place, now_s, path, demands)
        yield from _flaws_of(build)


def _flaws_of(build: Callable[[], object]) -> tuple[Flaw, ...]:
    try:
        build()
    except ConfigurationError as error:
        return error.flaws
    return ()


_LONGEST_PERIODS, _SHORTEST_PERIODS = 5000.0, 0.02
"""Slow periods in the longest time constant: the examples have 10 to 30."""

_LOWEST_TELEMETRY_HZ = 1.0
"""Page, `status` and `watch` take a drive for gone that is not heard for 3 s."""

_LOWEST_CHARGE = 0.5
"""Share of its highest voltage to which no battery that can be charged is empty."""


def implausible(configuration: Configuration) -> Iterator[Flaw]:
    """Find values that contradict each other, with the figures that show it."""
    power = _battery_flaws, _reach_flaws, _pace_flaws, _capacitor_flaws
    for check in (_telemetry_flaws, _health_flaws, *power):
        yield from check(configuration)


def _health_flaws(configuration: Configuration) -> Iterator[Flaw]:
    """The bounds are of quantities that the load has."""
    known = recording.health_names(configuration)
    names = ", ".join(known) or "none, as its estimates are no physical parameters"
    for name in configuration.health.bounds:
        if name not in known:
            problem = f"no quantity of this load{nearest(name, known)}; known: {names}"
            yield Flaw(f"health.bounds.{name}", problem)


def _telemetry_flaws(configuration: Configuration) -> Iterator[Flaw]:
    """Telemetry comes often enough to be taken for live."""
    rate_Hz = configuration.mqtt.telemetry_Hz
    if rate_Hz < _LOWEST_TELEMETRY_HZ:
        problem = f"{rate_Hz:g}: below {_LOWEST_TELEMETRY_HZ:g} an old output is shown as live"
        yield Flaw("mqtt.telemetry_Hz", f"{problem}, and commands are refused as expired")


def _reach_flaws(configuration: Configuration) -> Iterator[Flaw]:
    """The voltages that may be asked for lead to outputs among the set-points."""
    section, limits = configuration.load, configuration.drive.limits
    unit, given = section.output_unit, configuration.drive.given
    stage = controller_settings(configuration).stage
    reach = nominal_reach(loads.build_load(configuration), stage)
    if reach.low > section.reference_max or reach.high < section.reference_min:
        yield Flaw(
            "load.model",
            f"{given.symbol} = {limits.boost_reference_min_V:g}…"
            f"{given.text(limits.boost_reference_max_V, 'g')} gives "
            f"{section.output_name} = {reach.low:g}…{reach.high:g} {unit}, which "
            f"misses every set-point of {section.reference_min:g}…{section.reference_max:g} {unit}:"
            " compare the model's gain, load.reference_min and _max, and [drive.limits]",
        )


def _battery_flaws(configuration: Configuration) -> Iterator[Flaw]:
    """The dc/dc stage makes voltages at which the battery can be charged, and not charged."""
    section, limits = configuration.load, configuration.drive.limits
    if not isinstance(section, BatterySection):
        return
    if configuration.drive.kind == "bidirectional":
        problem = "'bidirectional': every start, at the lowest V_c, would discharge the battery"
        yield Flaw("drive.kind", f"{problem}; a charger is 'unidirectional'")
    ratio, highest_V = section.model.turns_ratio, section.charge.voltage_max_V
    low_V = ratio * limits.boost_reference_min_V
    high_V = ratio * limits.boost_reference_max_V
    if low_V <= highest_V and high_V >= _LOWEST_CHARGE * highest_V:
        return
    problem = f"V_c times turns_ratio = {ratio:g} gives {low_V:.4g}…{high_V:.4g} V"
    yield Flaw("load.model.turns_ratio", f"{problem}, the battery has up to {highest_V:g} V")


def _pace_flaws(configuration: Configuration) -> Iterator[Flaw]:
    """The slow period fits the load, and the load can be controlled with it."""
    period_s, total_s = configuration.load.period_s, loads.build_load(configuration).lag_s
    if _SHORTEST_PERIODS <= total_s / period_s <= _LONGEST_PERIODS:
        yield from _pole_flaws(configuration)
    else:
        problem = f"its time constants add up to {total_s:.4g} s, {total_s / period_s:.3g} slow "
        limits = f"{_SHORTEST_PERIODS:g}…{_LONGEST_PERIODS:g}"
        yield Flaw("load.model", f"{problem}periods of {period_s:g} s; {limits} can be controlled")


def _pole_flaws(configuration: Configuration) -> Iterator[Flaw]:
    """The fixed controller stands an error of the model with the pole of the file."""
    section, load = configuration.load, loads.build_load(configuration)
    standing = loads.standing_poles(controller_settings(configuration), load, section)
    if section.pole in standing:
        return
    problem = (
        f"{section.pole:g}: the fixed controller must keep a load stable whose parameters are "
        f"{100.0 * loads.MODEL_ERROR:g} % off load.model"
    )
    if standing:
        remedy = f"poles of {standing[0]:g}…{standing[-1]:g} do"
    else:
        remedy = "no pole does: compare load.period_s and load.model"
    yield Flaw("load.pole", f"{problem}; {remedy}")


def _capacitor_flaws(configuration: Configuration) -> Iterator[Flaw]:
    """The capacitor can be charged in time, and holds more than the load takes in a half cycle."""
    if configuration.voltage_loop.where == "drive":
        return
    drive, place = configuration.drive, "drive.boost_capacitance_F"
    capacitance_F, limits, line_V = drive.boost_capacitance_F, drive.limits, drive.line_voltage_V
    power_W = drive.largest_W
    rise_J = 0.5 * capacitance_F * (limits.boost_reference_min_V**2 - 2.0 * line_V * line_V)
    patience_s = configuration.interlocks.precharge_timeout_s
    if rise_J > power_W * patience_s:
        problem = f"{capacitance_F:g} F takes {rise_J / power_W:.3g} s from the line's peak to "
        problem += f"{limits.boost_reference_min_V:g} V with {power_W:.4g} W"
        yield Flaw(place, f"{problem}; interlocks.precharge_timeout_s = {patience_s:g}")
    held_J = 0.5 * capacitance_F * limits.boost_reference_max_V**2
    taken_J = limits.load_power_max_W * configuration.drive.half_cycle_s
    if held_J < taken_J:
        problem = f"{capacitance_F:g} F holds {held_J:.3g} J at {limits.boost_reference_max_V:g} V"
        need = f"a load of load_power_max_W takes {taken_J:.3g} J a half cycle"
        yield Flaw(place, f"{problem}; {need}")


# Values that can be used, and probably are not meant or do not work well together.

_REACH_SHARE = 0.1
"""Share of the set-points above the highest output that is not worth a word."""

_LEAST_LAMBDA, _MOST_LAMBDA = 0.2, 5.0
"""τ_λ over the mean time constant of the load; the examples have 0.5 to 0.9."""

_LEAST_PERIODS, _MOST_PERIODS = 2.0, 100.0
"""Slow periods in the mean time constant of the load; the examples have 10 to 22."""

_LEAST_READINGS = 3
"""Readings of the drive in a slow period, however fast the load is."""

_DELAY_SHARE = 0.5
"""Dead time of the loop, over the time constant of the closed loop."""


def advice(configuration: Configuration) -> Iterator[Flaw]:
    """Find values that probably do not do what is wanted, with the figures that show it."""
    cautions = ports.bus_kind(configuration.bus.type).cautions
    loop = (_reach, _power, _absent, _only_stop, _pace, _delay, _charge, _paper)
    for check in (*loop, _broker, _unread, cautions):
        yield from check(configuration)


def _paper(configuration: Configuration) -> Iterator[Flaw]:
    """The paper's design has the paper's estimator."""
    load, estimator = configuration.load, configuration.estimator
    if load.design != "paper":
        return
    method = load.traits.paper_method or estimator.method
    if estimator.method != method:
        yield Flaw("estimator.method", f"{estimator.method!r}: the paper has {method!r} here")
    forgetting = load.traits.paper_forgetting
    if estimator.forgetting not in (None, forgetting):
        text = f"{estimator.forgetting:g}: the paper has {forgetting:g}; leave the key out for it"
        yield Flaw("estimator.forgetting", text)


def _reach(configuration: Configuration) -> Iterator[Flaw]:
    """The highest command reaches the highest set-point."""
    section, load = configuration.load, loads.build_load(configuration)
    given, highest_V = configuration.drive.given, configuration.drive.limits.boost_reference_max_V
    highest = load.gain * to_input(highest_V, load.input_gain, load.input_exponent)
    span, unit = section.reference_max - section.reference_min, section.output_unit
    if not section.traits.charges and section.reference_max - highest > _REACH_SHARE * span:
        text = f"{section.reference_max:g} {unit} cannot be reached: "
        text += f"{given.text(highest_V, 'g')} gives {highest:.4g} {unit}"
        yield Flaw("load.reference_max", text)


def _only_stop(configuration: Configuration) -> Iterator[Flaw]:
    """A drive that nothing switches off is stopped by its set-point alone."""
    if configuration.signals.command.bridge or configuration.bus.has_bridge_words:
        return
    text = "is missing: a set-point of 0 is its only stop; see that the load is then without power"
    yield Flaw("signals.command.bridge", f"{text}, and that the drive stops without commands")


def _absent(configuration: Configuration) -> Iterator[Flaw]:
    """A quantity that is not measured watches nothing."""
    absent, drive = consistency.absent_names(configuration), configuration.drive
    stated = drive.manipulated.unit == "V" or "load_power_max_W" in drive.limits.model_fields_set
    if "load_power_W" in absent and stated:
        text = "is absent: drive.limits.load_power_max_W holds nothing back"
        yield Flaw("signals.load_power_W", f"{text}; the drive must limit its own power")
    if "boost_voltage_V" in absent:
        text = f"is absent: {drive.given.asked} stands for it, and"
        text += " interlocks.boost_voltage_max_V can trip nothing"
        yield Flaw("signals.boost_voltage_V", text)


def _power(configuration: Configuration) -> Iterator[Flaw]:
    """The drive has the power that the highest set-point takes."""
    drive = configuration.drive
    wanted_W = _highest_power_W(configuration)
    takes_k = configuration.voltage_loop.where == "daemon"
    line_W = drive.largest_W if takes_k else math.inf
    given_W = min(drive.limits.load_power_max_W, line_W)
    if wanted_W > given_W:
        source = "load_power_max_W" if given_W < line_W else "current_scale_max_S"
        text = f"takes {wanted_W:.4g} W; drive.limits.{source} gives {given_W:.4g} W"
        yield Flaw("load.reference_max", text)


def _highest_power_W(configuration: Configuration) -> float:
    """Return the power of the highest set-point; 0 where the model does not say."""
    section, load = configuration.load, loads.build_load(configuration)
    if isinstance(section, BatterySection):
        current_A = section.reference_max
        return (section.charge.voltage_max_V + section.model.droop_Ohm * current_A) * current_A
    if not isinstance(section, BathSection):
        return 0.0
    heat_W = section.reference_max / load.gain
    volts = to_voltage(heat_W, load.input_gain, load.input_exponent)
    highest_V = min(volts, configuration.drive.limits.boost_reference_max_V)
    model = section.model
    return (model.turns_ratio * highest_V) ** 2 / (model.droop_Ohm + model.heater_Ohm)


def _charge(configuration: Configuration) -> Iterator[Flaw]:
    """A charge ends, whatever its sensor reads."""
    section, limits = configuration.load, configuration.drive.limits
    if not isinstance(section, BatterySection):
        return
    if section.charge.longest_h is None:
        text = "is left out: a charge whose current is measured too high never ends"
        yield Flaw("load.charge.longest_h", text)
    limit_V = section.charge.voltage_max_V
    highest_V = section.model.turns_ratio * limits.boost_reference_max_V
    if highest_V <= limit_V:  # at the limit itself nothing tapers yet
        text = (
            f"{limit_V:g} V is never passed, so that no charge ends by itself: V_c = "
            f"{limits.boost_reference_max_V:g} V gives {highest_V:.4g} V at most"
        )
        yield Flaw("load.charge.voltage_max_V", text)


def _pace(configuration: Configuration) -> Iterator[Flaw]:
    """The λ filters and the slow period suit the load."""
    load = loads.build_load(configuration)
    mean_s = load.lag_s / load.order
    lambda_s, period_s = configuration.estimator.tau_lambda_s, configuration.load.period_s
    least_s = _LEAST_READINGS * timing_of(configuration).reading_s
    shortest_s, longest_s = mean_s / _MOST_PERIODS, mean_s / _LEAST_PERIODS
    for place, value_s, low_s, high_s in (
        ("estimator.tau_lambda_s", lambda_s, _LEAST_LAMBDA * mean_s, _MOST_LAMBDA * mean_s),
        ("load.period_s", period_s, max(shortest_s, least_s), max(longest_s, least_s)),
    ):
        if not (low_s <= value_s <= high_s or math.isclose(value_s, high_s)):
            known = f"lags of {load.lag_s:.4g} s in all, a mean time constant of {mean_s:.4g} s"
            text = f"{value_s:g} s does not suit {known}: {low_s:.3g}…{high_s:.3g} s"
            yield Flaw(place, text)


def _delay(configuration: Configuration) -> Iterator[Flaw]:
    """The closed loop is slow enough for the dead time in it."""
    load, rates = configuration.load, controller_settings(configuration).rates
    ticks = rates.latency_ticks + rates.lag_ticks + 0.5 * rates.samples
    delay_s = ticks * rates.nominal_tick_s
    closed_s = -load.period_s / math.log(load.pole)
    if delay_s > _DELAY_SHARE * closed_s:
        slowest = math.exp(-_DELAY_SHARE * load.period_s / delay_s)
        text = (
            f"{load.pole:g} asks for a time constant of {closed_s:.3g} s; latency_ticks, the "
            f"voltage loop and half of the samples delay by {delay_s:.3g} s: at least {slowest:.2f}"
        )
        yield Flaw("load.pole", text)


def _broker(configuration: Configuration) -> Iterator[Flaw]:
    """The broker can be reached without showing a password to the network."""
    mqtt = configuration.mqtt
    if not mqtt.tls and not _is_here(mqtt.host):
        yield Flaw("mqtt.tls", f"false, and {mqtt.host!r} is remote: commands travel in clear text")
    if mqtt.password_file is not None and not os.access(mqtt.password_file, os.R_OK):
        yield Flaw("mqtt.password_file", f"{mqtt.password_file} cannot be read by this user")


def _unread(configuration: Configuration) -> Iterator[Flaw]:
    """A message that is asked for is read."""
    own = [one for _, one, _ in configuration.signals.entries()]
    buses: list[tuple[str, object, Iterable[SignalSource]]] = [("bus", configuration.bus, own)]
    for number, one in enumerate(configuration.sensor_bus):
        buses.append((f"sensor_bus.{number}", one, one.signals.values()))
    for place, bus, sources in buses:
        polled = bus.polled if isinstance(bus, CanDescription) else {}
        for name in polled.keys() - {one.signal.partition(".")[0] for one in sources}:
            text = f"{polled[name]!r}: no signal of {name!r} is read, so that nobody asks for it"
            yield Flaw(f"{place}.polled.{name}", f"{text}; name a signal, or leave it out")


def _is_here(host: str) -> bool:
    """Return whether a host is this machine."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost" or host.endswith(".localhost")
