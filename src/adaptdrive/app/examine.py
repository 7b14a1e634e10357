"""Everything that can be known to be wrong with a configuration before a bus is opened."""

import functools
import math
from collections.abc import Callable, Iterator
from pathlib import Path

from adaptdrive.app import loads, ports
from adaptdrive.app.settings import controller_settings
from adaptdrive.config import Configuration, file, polled
from adaptdrive.config.load import AnyLoad, BatterySection
from adaptdrive.control.design.pole_placement import compensator_gains, discrete_model
from adaptdrive.control.loads.load import Load
from adaptdrive.control.supervision.setpoints import nominal_reach
from adaptdrive.devices.description import NO_DEMANDS, demands_of
from adaptdrive.util.clock import now_s
from adaptdrive.util.errors import ConfigurationError, Flaw

_OF_PORT = frozenset({"drive", "bus", "signals", "voltage_loop", "load", "interlocks"})


def load_examined(path: Path) -> Configuration:
    """Read a configuration and hold it against its DBC, EDS or register map.

    Args:
        path: Configuration file.

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
    findings = file.find_flaws(text, path)
    flaws = file.added(findings.flaws, _description_flaws(findings, path))
    if not findings.flaws:
        flaws = (*flaws, *implausible(findings.configuration))
    if flaws:
        raise ConfigurationError(path, flaws)
    return findings.configuration


def _description_flaws(findings: file.Findings, path: Path) -> Iterator[Flaw]:
    """Yield the errors in the files and maps that describe drive and sensors."""
    configuration, whole = findings.configuration, findings.valid >= _OF_PORT
    if whole and _leads_somewhere(findings):
        yield from _flaws_of(lambda: ports.build_port(configuration, now_s, path))
    if "sensor_bus" not in findings.valid:
        return
    demands = demands_of(configuration) if whole else NO_DEMANDS
    for number, bus in enumerate(configuration.sensor_bus):
        place = f"sensor_bus.{number}"
        build = functools.partial(ports.build_sensor_port, bus, place, now_s, path, demands)
        yield from _flaws_of(build)


def _leads_somewhere(findings: file.Findings) -> bool:
    """Return whether names in `[signals]` can be looked up, which needs a valid register map."""
    if not isinstance(findings.configuration.bus, polled.ModbusBus | polled.ScpiBus):
        return True
    return not any(flaw.place.startswith(("bus", "signals")) for flaw in findings.flaws)


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
    """Find values that contradict each other, with the figures that show it.

    Args:
        configuration: A valid configuration.
    """
    load = loads.build_load(configuration)
    yield from _telemetry_flaws(configuration)
    yield from _battery_flaws(configuration)
    yield from _reach_flaws(configuration, load)
    yield from _pace_flaws(configuration, load)
    if configuration.voltage_loop.where == "daemon":
        yield from _capacitor_flaws(configuration)


def _telemetry_flaws(configuration: Configuration) -> Iterator[Flaw]:
    """Telemetry comes often enough to be taken for live."""
    rate_Hz = configuration.mqtt.telemetry_Hz
    if rate_Hz < _LOWEST_TELEMETRY_HZ:
        problem = f"{rate_Hz:g}: below {_LOWEST_TELEMETRY_HZ:g} an old output is shown as live"
        yield Flaw("mqtt.telemetry_Hz", f"{problem}, and commands are refused as expired")


def _reach_flaws(configuration: Configuration, load: Load) -> Iterator[Flaw]:
    """The voltages that may be asked for lead to outputs among the set-points."""
    section, limits = configuration.load, configuration.drive.limits
    reach = nominal_reach(load, controller_settings(configuration).stage)
    if not reach.is_known:
        return
    if reach.low <= section.reference_max and reach.high >= section.reference_min:
        return
    unit, given = section.output_unit, configuration.drive.given
    yield Flaw(
        "load.model",
        f"{given.symbol} = {limits.boost_reference_min_V:g}…"
        f"{given.text(limits.boost_reference_max_V, 'g')} gives "
        f"{section.output_name} = {reach.low:g}…{reach.high:g} {unit}, which "
        f"misses every set-point of {section.reference_min:g}…{section.reference_max:g} {unit}: "
        "compare the model's gain, load.reference_min and _max, and [drive.limits]",
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


def _pace_flaws(configuration: Configuration, load: Load) -> Iterator[Flaw]:
    """The slow period fits the load, and the load can be controlled with it."""
    period_s = configuration.load.period_s
    total_s = load.lag_s
    if not _SHORTEST_PERIODS <= total_s / period_s <= _LONGEST_PERIODS:
        problem = f"its time constants add up to {total_s:.4g} s, {total_s / period_s:.3g} slow "
        limits = f"{_SHORTEST_PERIODS:g}…{_LONGEST_PERIODS:g}"
        yield Flaw("load.model", f"{problem}periods of {period_s:g} s; {limits} can be controlled")
        return
    settings = controller_settings(configuration)
    model = discrete_model(settings, load, list(load.numerator), list(load.denominator), period_s)
    gains = compensator_gains(*model, load.order, configuration.load.pole)
    if not all(map(math.isfinite, gains)):
        yield Flaw(
            "load.model", f"no gains place the poles at load.pole = {configuration.load.pole}"
        )
        return
    yield from _pole_flaws(
        configuration.load, loads.standing_poles(settings, load, configuration.load)
    )


def _pole_flaws(section: AnyLoad, standing: list[float]) -> Iterator[Flaw]:
    """The fixed controller stands an error of the model with the pole of the file."""
    if section.pole in standing:
        return
    problem = (
        f"{section.pole:g}: the fixed controller must keep a load stable whose parameters are "
        f"{100.0 * loads.MODEL_ERROR:g} % off load.model"
    )
    if standing:
        remedy = f"poles of {standing[0]:g}…{standing[-1]:g} do"
    else:
        remedy = "no pole of load.pole_min…load.pole_max does: compare load.period_s and load.model"
    yield Flaw("load.pole", f"{problem}; {remedy}")


def _capacitor_flaws(configuration: Configuration) -> Iterator[Flaw]:
    """The capacitor can be charged in time, and holds more than the load takes in a half cycle."""
    drive, place = configuration.drive, "drive.boost_capacitance_F"
    capacitance_F, limits, line_V = drive.boost_capacitance_F, drive.limits, drive.line_voltage_V
    power_W = limits.current_scale_max_S * line_V * line_V
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
        yield Flaw(
            place, f"{problem}; a load of load_power_max_W takes {taken_J:.3g} J a half cycle"
        )
