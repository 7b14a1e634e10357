"""Values that can be used, and probably are not meant or do not work well together."""

import ipaddress
import math
import os
from collections.abc import Iterable, Iterator

from adaptdrive.app import loads, ports, settings
from adaptdrive.config import Configuration, consistency
from adaptdrive.config.bus import CanDescription, SignalSource
from adaptdrive.config.load import BathSection, BatterySection
from adaptdrive.control.loads.load import Load, to_input, to_voltage
from adaptdrive.util.errors import Flaw

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
    """Find values that probably do not do what is wanted, with the figures that show it.

    Args:
        configuration: A valid configuration.
    """
    load = loads.build_load(configuration)
    yield from _reach(configuration, load)
    yield from _power(configuration, load)
    yield from _absent(configuration)
    yield from _only_stop(configuration)
    yield from _pace(configuration, load)
    yield from _delay(configuration)
    yield from _charge(configuration)
    yield from _paper(configuration)
    yield from _broker(configuration)
    yield from _unread(configuration)
    yield from ports.bus_kind(configuration.bus.type).cautions(configuration)


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


def _reach(configuration: Configuration, load: Load) -> Iterator[Flaw]:
    """The highest command reaches the highest set-point."""
    section, limits = configuration.load, configuration.drive.limits
    given = configuration.drive.given
    if section.traits.charges:
        return
    highest = load.gain * to_input(
        limits.boost_reference_max_V, load.input_gain, load.input_exponent
    )
    span = section.reference_max - section.reference_min
    if section.reference_max - highest > _REACH_SHARE * span:
        text = (
            f"{section.reference_max:g} {section.output_unit} cannot be reached: "
            f"{given.text(limits.boost_reference_max_V, 'g')} gives {highest:.4g} "
            f"{section.output_unit}"
        )
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


def _power(configuration: Configuration, load: Load) -> Iterator[Flaw]:
    """The drive has the power that the highest set-point takes."""
    drive = configuration.drive
    wanted_W = _highest_power_W(configuration, load)
    line_W = drive.limits.current_scale_max_S * drive.line_voltage_V**2
    if configuration.voltage_loop.where == "drive":  # it takes no k
        line_W = math.inf
    given_W = min(drive.limits.load_power_max_W, line_W)
    if wanted_W > given_W:
        source = "load_power_max_W" if given_W < line_W else "current_scale_max_S"
        text = f"takes {wanted_W:.4g} W; drive.limits.{source} gives {given_W:.4g} W"
        yield Flaw("load.reference_max", text)


def _highest_power_W(configuration: Configuration, load: Load) -> float:
    """Return the power of the highest set-point; 0 where the model does not say."""
    section = configuration.load
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


def _pace(configuration: Configuration, load: Load) -> Iterator[Flaw]:
    """The λ filters and the slow period suit the load."""
    mean_s = load.lag_s / load.order
    lambda_s, period_s = configuration.estimator.tau_lambda_s, configuration.load.period_s
    least_s = _LEAST_READINGS * configuration.timing.reading_s
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
    load, rates = configuration.load, settings.controller_settings(configuration).rates
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
