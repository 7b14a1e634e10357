"""The load that a configuration describes, and the poles whose fixed gains stand an error of it.

Poles far slower than the load's own take gains with which a small error of the model ends in a
limit cycle; so do poles that are far faster. The fixed controller must keep each load stable whose
physical parameters are wrong by a tenth: the worst are at the corners of that box.
"""

import itertools
import math
from typing import Any

from adaptdrive.config import Configuration, root
from adaptdrive.config.load import BathSection, BatterySection, LoadSection, MotorSection
from adaptdrive.control.design.pole_placement import Plant, discrete_model, is_stable
from adaptdrive.control.estimation.direct import METHODS
from adaptdrive.control.loads import bath, motor
from adaptdrive.control.loads.battery import battery_load
from adaptdrive.control.loads.load import Charging, Load, to_input
from adaptdrive.control.settings import ControllerSettings
from adaptdrive.safety import plausibility

MODEL_ERROR = 0.1
"""Error of each parameter that the fixed gains must stand: copper that is 25 K warmer has
10 % more resistance."""

_FASTEST = 0.5
"""Fastest pole that an operator may ask for, where `load.pole` is slower: most of an error is gone
after one slow period."""

_SLOWEST = 0.98
"""Slowest pole that an operator may ask for, where `load.pole` is faster: a response of fifty slow
periods."""

_POLE_STEP = 0.01
"""Distance of the poles that are tried."""


def build_load(configuration: Configuration) -> Load:
    """The load with its nominal model."""
    match configuration.load:
        case MotorSection(model=model):
            lag_s = short_lag_s(configuration) or model.tau_filter_s
            return motor.motor_load(model.gain, model.tau_motor_s, lag_s)
        case BathSection(model=model):
            return bath.bath_load(**model.model_dump())
        case BatterySection(model=model, charge=charge):
            stage = model.turns_ratio, model.droop_Ohm, model.internal_Ohm
            longest_s = math.inf if charge.longest_h is None else 3600.0 * charge.longest_h
            charging = Charging(*stage, charge.voltage_max_V, charge.end_current_A, longest_s)
            series_Ohm, relaxation_s = model.droop_Ohm + model.internal_Ohm, model.relaxation_s
            return battery_load(
                model.turns_ratio, series_Ohm, model.relaxation_Ohm, relaxation_s, charging
            )


def short_lag_s(configuration: Configuration) -> float:
    """Return a second lag of a motor that is too short to be learnt; 0 where there is none.

    What is shorter than a slow period counts as half a period at most, so that it is wrong by half
    a period at most, whatever `tau_filter_s` says.
    """
    load = configuration.load
    learnt = load.design == "exact" and METHODS[configuration.estimator.method].physical
    if not (isinstance(load, MotorSection) and learnt):
        return 0.0
    lag_s = load.model.tau_filter_s
    return min(lag_s, 0.5 * load.period_s) if lag_s < load.period_s else 0.0


def candidate_loads(configuration: Configuration) -> list[Load]:
    """The structures that a record of the load may show: a bath with one lag or with two."""
    if not isinstance(configuration.load, BathSection):
        return [build_load(configuration)]
    model = configuration.load.model
    shapes = [{"lag_s": lag_s, "delay_s": 0.0} for lag_s in (0.0, model.lag_s or model.tau_s)]
    return [bath.bath_load(**(model.model_dump() | shape)) for shape in shapes]


def pole_range(
    settings: ControllerSettings, load: Load, section: LoadSection
) -> tuple[float, float]:
    """Return the fastest and the slowest pole that may be asked for.

    All from one to the other stand, and lie within `_FASTEST` and `_SLOWEST`, or `load.pole`.

    Args:
        settings: The design.
        load: The load and its nominal model.
        section: `[load]`, whose own pole is taken to stand.
    """
    plants = _plants(settings, load, section.period_s)
    ends = []
    for end in (min(_FASTEST, section.pole), max(_SLOWEST, section.pole)):
        after = itertools.takewhile(lambda p: _stands(plants, p), _poles(section.pole, end))
        ends.append([section.pole, *after][-1])
    return ends[0], ends[1]


def standing_poles(settings: ControllerSettings, load: Load, section: LoadSection) -> list[float]:
    """Return the poles of `_FASTEST` to `_SLOWEST` that stand; `load.pole` is tried too.

    Arguments as of `pole_range`.
    """
    plants = _plants(settings, load, section.period_s)
    poles = [_FASTEST, *_poles(_FASTEST, _SLOWEST), section.pole]
    return sorted(pole for pole in set(poles) if _stands(plants, pole))


def _plants(settings: ControllerSettings, load: Load, period_s: float) -> list[Plant]:
    """Return the nominal model, and those of the loads at the corners of its box."""
    values = load.physical(list(load.numerator), list(load.denominator))
    shares = itertools.product((1.0 - MODEL_ERROR, 1.0 + MODEL_ERROR), repeat=len(values))
    boxes = [[v * s for v, s in zip(values, corner, strict=True)] for corner in shares]
    return [
        Plant(*discrete_model(settings, load, *load.realise(parameters), period_s))
        for parameters in (values, *boxes)
    ]


def _stands(plants: list[Plant], pole: float) -> bool:
    """Return whether the gains for the first of some models keep all of them stable."""
    gains = plants[0].gains(plants[0].asked(pole))
    return all(is_stable(one.closed(gains)) for one in plants)


def _poles(start: float, end: float) -> list[float]:
    """Return the poles after one to another, that one included."""
    count = math.ceil(abs(end - start) / _POLE_STEP - 1e-9)
    step = math.copysign(_POLE_STEP, end - start)
    return [*(round(start + step * i, 6) for i in range(1, count)), end] if count else []


# Limits of the output that follow from the model of the load.

_POWER_FACTOR = 2.0
"""A power is measured, and half of it at most is lost on the way to the load."""


def _judged(configuration: Configuration) -> dict[str, Any]:
    """Return the model of the load by which its output is judged."""
    load, section = build_load(configuration), configuration.load
    return {
        "display": section.display,
        "output_name": section.output_name,
        "gain": load.gain,
        "input_gain": load.input_gain,
        "input_exponent": load.input_exponent,
        "lags_s": (load.lag_s / load.order,) * load.order,
    }


def stillness_limits(configuration: Configuration) -> plausibility.StillnessLimits | None:
    """Return when the output is stuck, None for never."""
    interlocks, section = configuration.interlocks, configuration.load
    if not interlocks.stuck_distance and not interlocks.stuck_s:
        return None
    distance = interlocks.stuck_distance * (section.reference_max - section.reference_min)
    if section.traits.charges:  # takes no current at all below its own voltage
        distance = 0.0
    return plausibility.StillnessLimits(
        **_judged(configuration),
        resolution=section.resolution,
        distance=distance or math.inf,
        longest_s=interlocks.stuck_s or math.inf,
        inputs=root.moved_inputs("output", configuration.derived),
    )


def response_limits(configuration: Configuration) -> plausibility.ResponseLimits | None:
    """Return when the output is below what the load must give, None for never."""
    factor, section = configuration.interlocks.response_factor, configuration.load
    if not factor:
        return None
    load, highest_V = build_load(configuration), configuration.drive.limits.boost_reference_max_V
    reference_range = section.reference_max - section.reference_min
    known = _judged(configuration) | {
        "input_max": to_input(highest_V, load.input_gain, load.input_exponent),
        "factor": factor,
    }
    if isinstance(section, BatterySection):
        ratio = section.model.turns_ratio
        known |= {
            "gain": 1.0 / ratio,
            "input_max": reference_range * ratio,
            "lags_s": (section.period_s,),  # a sensor's cycle is no longer
            "factor": min(factor, _POWER_FACTOR),
            "by_power": True,
        }
    return plausibility.ResponseLimits(**known, reference_range=reference_range)
