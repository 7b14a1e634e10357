"""The interlocks that a configuration asks for: trip levels, and watches over the output."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator
from dataclasses import replace

from adaptdrive.app.loads import alike, build_load
from adaptdrive.config import Configuration
from adaptdrive.config.load import BatterySection
from adaptdrive.config.supply import absent_names, moved_inputs
from adaptdrive.control.load import Load, to_input
from adaptdrive.runtime.capacitor import CapacitorLimits
from adaptdrive.runtime.interlocks import Limits, Watch
from adaptdrive.runtime.plausibility import (
    Response,
    ResponseLimits,
    StillnessLimits,
    StillnessWatch,
)

_POWER_FACTOR = 2.0  # a power is measured, and half of it at most is lost on the way to the load
_BELOW_RANGE = 0.25  # noise of 5 % and the overshoot of a step downwards stay above


def trip_limits(configuration: Configuration) -> Limits:
    """Return the levels at which a single reading trips the drive."""
    sections = configuration.interlocks, configuration.load, configuration.drive
    return Limits(
        **alike(Limits, *sections, but=("output_min",)),
        output_min=_output_min(configuration),
        absent=absent_names(configuration),
    )


def capacitor_limits(configuration: Configuration) -> CapacitorLimits | None:
    """Return the boost capacitor that the daemon charges, None where the drive does by itself."""
    drive = configuration.drive
    if configuration.voltage_loop.where == "drive":
        return None
    return CapacitorLimits(
        capacitance_F=drive.boost_capacitance_F,
        highest_V=configuration.interlocks.boost_voltage_max_V,
        largest_W=drive.limits.current_scale_max_S * drive.line_voltage_V**2,
    )


def watches(configuration: Configuration) -> tuple[Callable[[], Watch], ...]:
    """Return the factories of the watches over the output; a fast loop builds its own of each."""
    return tuple(_watches(configuration))


def _watches(configuration: Configuration) -> Iterator[Callable[[], Watch]]:
    if (stillness := stillness_limits(configuration)) is not None:
        yield functools.partial(StillnessWatch, stillness)
    if (response := response_limits(configuration)) is not None:
        yield functools.partial(Response, response)


def _output_min(configuration: Configuration) -> float:
    """Return the lowest output: below it is none that a load at rest or in control has."""
    load, given = configuration.load, configuration.interlocks.output_min
    if given is not None:
        return given
    return min(0.0, load.reference_min) - _BELOW_RANGE * (load.reference_max - load.reference_min)


def stillness_limits(configuration: Configuration) -> StillnessLimits | None:
    """Return when the output is stuck, None for never."""
    interlocks, section = configuration.interlocks, configuration.load
    if not interlocks.stuck_distance and not interlocks.stuck_s:
        return None
    load = build_load(configuration)
    distance = interlocks.stuck_distance * (section.reference_max - section.reference_min)
    if section.traits.charges:  # takes no current at all below its own voltage
        distance = 0.0
    return StillnessLimits(
        **alike(StillnessLimits, load, section),
        lags_s=_lags_s(load),
        distance=distance or math.inf,
        longest_s=interlocks.stuck_s or math.inf,
        inputs=moved_inputs("output", configuration.derived),
    )


def _lags_s(load: Load) -> tuple[float, ...]:
    """Return equal time constants with the same sum as those of the load."""
    return (load.lag_s / load.order,) * load.order


def response_limits(configuration: Configuration) -> ResponseLimits | None:
    """Return when the output is below what the load must give, None for never."""
    factor, section = configuration.interlocks.response_factor, configuration.load
    if not factor:
        return None
    load, highest_V = build_load(configuration), configuration.drive.limits.boost_reference_max_V
    reference_range = section.reference_max - section.reference_min
    limits = ResponseLimits(
        **alike(ResponseLimits, load, section),
        input_max=to_input(highest_V, load.input_gain, load.input_exponent),
        lags_s=_lags_s(load),
        factor=factor,
        reference_range=reference_range,
    )
    if not isinstance(section, BatterySection):
        return limits
    ratio = section.model.turns_ratio
    return replace(
        limits,
        gain=1.0 / ratio,
        input_max=reference_range * ratio,
        lags_s=(section.period_s,),  # a sensor's cycle is no longer
        factor=min(factor, _POWER_FACTOR),
        by_power=True,
    )
