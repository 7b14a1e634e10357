"""The load that a configuration describes, as the controller takes it."""

from __future__ import annotations

import math

from adaptdrive.config import Configuration
from adaptdrive.config.load import BathSection, BatterySection, MotorSection
from adaptdrive.control.charging import Charging
from adaptdrive.control.load import Load
from adaptdrive.control.loads.bath import bath_load
from adaptdrive.control.loads.battery import battery_load
from adaptdrive.control.loads.motor import motor_load
from adaptdrive.control.methods import METHODS


def build_load(configuration: Configuration) -> Load:
    """The load with its nominal model."""
    match configuration.load:
        case MotorSection(model=model):
            lag_s = short_lag_s(configuration) or model.tau_filter_s
            return motor_load(model.gain, model.tau_motor_s, lag_s)
        case BathSection(model=model):
            return bath_load(
                model.resistance_K_per_W,
                model.tau_s,
                model.turns_ratio,
                model.droop_Ohm,
                model.heater_Ohm,
                model.lag_s,
                model.delay_s,
            )
        case BatterySection(model=model):
            return battery_load(
                model.turns_ratio,
                model.droop_Ohm + model.internal_Ohm,
                model.relaxation_Ohm,
                model.relaxation_s,
                _charging(configuration.load),
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
    stage = (model.turns_ratio, model.droop_Ohm, model.heater_Ohm)
    return [
        bath_load(model.resistance_K_per_W, model.tau_s, *stage, lag_s)
        for lag_s in (0.0, model.lag_s or model.tau_s)
    ]


def _charging(battery: BatterySection) -> Charging:
    longest_h = battery.charge.longest_h
    return Charging(
        turns_ratio=battery.model.turns_ratio,
        droop_Ohm=battery.model.droop_Ohm,
        internal_Ohm=battery.model.internal_Ohm,
        voltage_max_V=battery.charge.voltage_max_V,
        end_current_A=battery.charge.end_current_A,
        longest_s=math.inf if longest_h is None else 3600.0 * longest_h,
    )
