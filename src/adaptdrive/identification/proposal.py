"""`[load.model]` from an identified load."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from adaptdrive.config.load import AnyLoad, BathModel, BathSection, BatterySection, MotorSection
from adaptdrive.control.signals import Estimate
from adaptdrive.identification.result import IdentifiedLoad

Array = NDArray[np.float64]

_SHOWN = 3.0
"""Dead time over its deviation above which the record shows it."""

_STEP = 1e-6


def proposed_model(identified: IdentifiedLoad, section: AnyLoad) -> dict[str, Estimate]:
    """Return the keys of `[load.model]` that a record determines; the others stay.

    Args:
        identified: The load.
        section: `[load]`, whose model gives the dc/dc stage and says which time constant of a
            motor is the filter's: the nearer one. A load whose parameters are the keys of its
            model needs nothing here.
    """
    match section:
        case MotorSection(model=model):
            return _motor(identified, model.tau_motor_s, model.tau_filter_s)
        case BatterySection(model=model):
            return _battery(identified, model.turns_ratio, model.droop_Ohm)
        case BathSection():
            return _bath(identified, section.model)
        case _:
            return dict(identified.parameters)


def _bath(identified: IdentifiedLoad, model: BathModel) -> dict[str, Estimate]:
    """Return resistance and time constant, and what the record shows of a sensor that lags."""
    gain, *taus_s = time_constants(identified).values()
    found = dict(zip(("resistance_K_per_W", "tau_s", "lag_s"), (gain, *taus_s), strict=False))
    if identified.delay_s > _SHOWN * identified.delay_std_s:
        found["delay_s"] = Estimate(identified.delay_s, identified.delay_std_s)
    gone = [name for name in ("lag_s", "delay_s") if name not in found and getattr(model, name)]
    return found | dict.fromkeys(gone, Estimate(0.0, 0.0))


def time_constants(identified: IdentifiedLoad) -> dict[str, Estimate]:
    """Return gain and time constants of a load of one or two lags, the longer one first."""
    if "tau_product_s2" not in identified.parameters:
        return dict(identified.parameters)
    names = ("gain", "tau_1_s", "tau_2_s")
    return dict(zip(names, _motor(identified, 1.0, 0.0).values(), strict=True))


def _motor(
    identified: IdentifiedLoad, tau_motor_s: float, tau_filter_s: float
) -> dict[str, Estimate]:
    """Return the gain and both time constants; equal ones where the pair is complex."""
    total, product = (identified.parameters[name] for name in ("tau_sum_s", "tau_product_s2"))
    square = 0.25 * total.value**2 - product.value
    slopes = np.array([0.5 * total.value, -1.0])
    square_std = math.sqrt(slopes @ identified.covariance[1:, 1:] @ slopes)
    gap_s = math.sqrt(max(0.0, square))
    # The root is not linear near 0: the deviation is the way to the root at one deviation more.
    gap_std_s = math.sqrt(max(0.0, square) + square_std) - gap_s
    std_s = math.hypot(0.5 * total.std, gap_std_s)
    middle_s = 0.5 * total.value
    slow, fast = Estimate(middle_s + gap_s, std_s), Estimate(middle_s - gap_s, std_s)
    motor, tachometer = (slow, fast) if tau_motor_s >= tau_filter_s else (fast, slow)
    return {
        "gain": next(iter(identified.parameters.values())),
        "tau_motor_s": motor,
        "tau_filter_s": tachometer,
    }


def _battery(
    identified: IdentifiedLoad, turns_ratio: float, droop_Ohm: float
) -> dict[str, Estimate]:
    def resistances(admittances: Array) -> Array:
        direct_S, gain_S, tau_s = admittances
        series_Ohm, total_Ohm = turns_ratio / direct_S, turns_ratio / gain_S
        relaxation_s = tau_s * total_Ohm / series_Ohm
        return np.array([series_Ohm - droop_Ohm, total_Ohm - series_Ohm, relaxation_s])

    names = ("internal_Ohm", "relaxation_Ohm", "relaxation_s")
    values, deviations = _mapped(resistances, identified)
    return {
        name: Estimate(value, std)
        for name, value, std in zip(names, values.tolist(), deviations.tolist(), strict=True)
    }


def _mapped(function: Callable[[Array], Array], identified: IdentifiedLoad) -> tuple[Array, Array]:
    """Return a function of the parameters, and its deviations to first order."""
    values = np.array([one.value for one in identified.parameters.values()])
    slopes = np.column_stack(
        [
            (function(values + step) - function(values - step)) / (2.0 * step.sum())
            for step in np.diag(_STEP * values)
        ]
    )
    spread = slopes @ identified.covariance @ slopes.T
    return function(values), np.sqrt(np.diag(spread))
