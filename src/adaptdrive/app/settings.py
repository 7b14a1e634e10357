"""Settings of controller and runtime, made from the configuration."""

from __future__ import annotations

import math
from dataclasses import replace

from adaptdrive.config import Configuration
from adaptdrive.config.derived import moved_inputs
from adaptdrive.config.load import BathSection, BatterySection, MotorSection, Supervisor
from adaptdrive.control.charging import Charging
from adaptdrive.control.load import Load, to_input
from adaptdrive.control.loads.bath import bath_load
from adaptdrive.control.loads.battery import battery_load
from adaptdrive.control.loads.motor import motor_load
from adaptdrive.control.settings import (
    ControllerSettings,
    Jacket,
    Learning,
    PowerStage,
    Rates,
)
from adaptdrive.control.voltage_loop import LAG_TICKS
from adaptdrive.runtime.daemon import DaemonSettings
from adaptdrive.runtime.fast_loop import FastLoopSettings
from adaptdrive.runtime.guard import CommandLimits
from adaptdrive.runtime.interlocks import Limits
from adaptdrive.runtime.machine import MachineLimits
from adaptdrive.runtime.realtime import RealtimeSettings
from adaptdrive.runtime.response import ResponseLimits
from adaptdrive.runtime.stillness import StillnessLimits

_LOWEST_LINE = 0.5
_SWING_SHARE = 0.01
_ERROR_SHARE = 0.1
_PAPER_PATIENCE = 30
_SHORTEST_WAVE_PERIODS = 4
_POWER_FACTOR = 2.0  # a power is measured, and half of it at most is lost on the way to the load
_BELOW_RANGE = 0.25  # noise of 5 % and the overshoot of a step downwards stay above
_COLLECT_TICKS = 12


def build_load(configuration: Configuration) -> Load:
    """The load with its nominal model."""
    match configuration.load:
        case MotorSection(model=model):
            return motor_load(model.gain, model.tau_motor_s, model.tau_filter_s)
        case BathSection(model=model):
            return bath_load(
                model.resistance_K_per_W,
                model.tau_s,
                model.turns_ratio,
                model.droop_Ohm,
                model.heater_Ohm,
            )
        case BatterySection(model=model):
            return battery_load(
                model.turns_ratio,
                model.droop_Ohm + model.internal_Ohm,
                model.relaxation_Ohm,
                model.relaxation_s,
                _charging(configuration.load),
            )


def _charging(battery: BatterySection) -> Charging:
    return Charging(
        turns_ratio=battery.model.turns_ratio,
        droop_Ohm=battery.model.droop_Ohm,
        internal_Ohm=battery.model.internal_Ohm,
        voltage_max_V=battery.charge.voltage_max_V,
        end_current_A=battery.charge.end_current_A,
    )


def controller_settings(configuration: Configuration) -> ControllerSettings:
    """Return all settings of the controller."""
    load = configuration.load
    exact = load.design == "exact"
    return ControllerSettings(
        exact=exact,
        stage=_power_stage(configuration),
        rates=Rates(
            ticks_per_period=configuration.ticks_per_period,
            latency_ticks=load.latency_ticks,
            samples=load.samples if exact else 1,
            nominal_tick_s=tick_s(configuration),
            clip=load.clip if exact else 0.0,
            lag_ticks=_lag_ticks(configuration),
        ),
        learning=_learning(configuration, exact=exact),
        jacket=_jacket(configuration),
    )


def daemon_settings(configuration: Configuration) -> DaemonSettings:
    """Return all settings of the runtime."""
    return DaemonSettings(
        machine=_machine_limits(configuration),
        pole=configuration.load.pole,
        fast=_fast_loop(configuration),
        report_s=1.0 / configuration.mqtt.telemetry_Hz,
        late_us=configuration.realtime.late_us,
        spin_s=configuration.realtime.spin_us * 1e-6,
        rehearse_s=configuration.realtime.rehearse_us * 1e-6,
        collect_ticks=_COLLECT_TICKS if configuration.realtime.freeze_gc else 0,
        refused_share=configuration.interlocks.refused_share,
    )


def realtime_settings(configuration: Configuration) -> RealtimeSettings:
    """Return the settings of `[realtime]`."""
    realtime = configuration.realtime
    return RealtimeSettings(
        priority=realtime.priority,
        cpus=tuple(realtime.cpus),
        lock_memory=realtime.lock_memory,
        freeze_gc=realtime.freeze_gc,
        cpu_latency_us=realtime.cpu_latency_us,
    )


def tick_s(configuration: Configuration) -> float:
    """Half a line cycle at nominal frequency."""
    return 0.5 / configuration.drive.line_frequency_Hz


def _lag_ticks(configuration: Configuration) -> float:
    """Mean delay of the loop that holds the boost voltage; a drive's own may have another."""
    lag_s = configuration.voltage_loop.lag_s
    return LAG_TICKS if lag_s is None else lag_s / tick_s(configuration)


def _power_stage(configuration: Configuration) -> PowerStage:
    drive, loop = configuration.drive, configuration.voltage_loop
    return PowerStage(
        capacitance_F=drive.boost_capacitance_F,
        line_voltage_min_V=_LOWEST_LINE * drive.line_voltage_V,
        current_scale_min_S=_lowest_scale(configuration),
        current_scale_max_S=drive.limits.current_scale_max_S,
        boost_reference_min_V=drive.limits.boost_reference_min_V,
        boost_reference_max_V=drive.limits.boost_reference_max_V,
        load_power_max_W=drive.limits.load_power_max_W,
        feed_forward=loop.feed_forward,
        holds_voltage=loop.where == "drive",
        boost_needs_bridge=drive.enable_bit == "bridge-and-boost",
    )


def _lowest_scale(configuration: Configuration) -> float:
    drive = configuration.drive
    return -drive.limits.current_scale_max_S if drive.kind == "bidirectional" else 0.0


def _learning(configuration: Configuration, *, exact: bool) -> Learning:
    estimator, load = configuration.estimator, build_load(configuration)
    battery = isinstance(configuration.load, BatterySection)
    limits = configuration.drive.limits
    middle_V = 0.5 * (limits.boost_reference_min_V + limits.boost_reference_max_V)
    middle = to_input(middle_V, load.input_gain, load.input_exponent)
    dc_gain = load.numerator[-1] / load.denominator[-1]
    return Learning(
        filtered=estimator.method == "lm-rls",
        forgetting=estimator.forgetting,
        tau_lambda_s=estimator.tau_lambda_s,
        dead_band=estimator.dead_band,
        initial_covariance=estimator.initial_covariance,
        settle_periods=math.ceil(estimator.settle_s / configuration.load.period_s),
        gate=estimator.gate if exact else 0.0,
        output_scale=dc_gain * middle if exact else 1.0,
        input_scale=middle if exact else 1.0,
        start_at_nominal=exact,
        alert=exact and estimator.alert,
        covariance_max=estimator.covariance_max if exact else 0.0,
        known_filter_s=_known_filter_s(configuration),
        bias=(exact and estimator.bias) or battery,
        initial_state=exact and estimator.initial_state and not battery,
    )


def _known_filter_s(configuration: Configuration) -> float:
    load = configuration.load
    if not configuration.estimator.known_filter or not isinstance(load, MotorSection):
        return 0.0
    return load.model.tau_filter_s


def _jacket(configuration: Configuration) -> Jacket:
    supervisor, load = configuration.supervisor, configuration.load
    reference_range = load.reference_max - load.reference_min
    basics = Jacket(
        warm_up_periods=_periods(configuration, supervisor.warm_up_s),
        ratio_min=supervisor.ratio_min,
        ratio_max=supervisor.ratio_max,
        patience_periods=_PAPER_PATIENCE,
    )
    if load.design == "paper":
        return basics
    return replace(
        basics,
        patience_periods=supervisor.patience_periods,
        damping_min=supervisor.damping_min,
        deviation_max=supervisor.deviation_max,
        residual_margin=supervisor.residual_margin,
        confirm_periods=_periods(configuration, supervisor.confirm_s),
        confidence=supervisor.confidence,
        dwell_periods=supervisor.dwell_periods,
        blend_periods=supervisor.blend_periods,
        saturated_periods=_periods(configuration, supervisor.saturated_s),
        gain_slew=supervisor.gain_slew,
        error_limit=_error_limit(supervisor, reference_range),
        swing_min=_SWING_SHARE * reference_range,
        response_periods=_periods(configuration, supervisor.response_s),
        response_distance=supervisor.response_distance * reference_range,
    )


def _error_limit(supervisor: Supervisor, reference_range: float) -> float:
    if supervisor.error_limit is None:
        return _ERROR_SHARE * reference_range
    return supervisor.error_limit


def _periods(configuration: Configuration, time_s: float) -> int:
    return math.ceil(time_s / configuration.load.period_s)


def _machine_limits(configuration: Configuration) -> MachineLimits:
    load, tick = configuration.load, tick_s(configuration)
    return MachineLimits(
        reference_min=load.reference_min,
        reference_max=load.reference_max,
        unit=load.output_unit,
        pole_min=load.pole_min,
        pole_max=load.pole_max,
        period_min_s=_SHORTEST_WAVE_PERIODS * load.period_s,
        floor_V=configuration.drive.limits.boost_reference_min_V,
        boost_needs_bridge=configuration.drive.enable_bit == "bridge-and-boost",
        starting_ticks=round(configuration.interlocks.precharge_timeout_s / tick),
        tick_s=tick,
    )


def _fast_loop(configuration: Configuration) -> FastLoopSettings:
    interlocks, limits = configuration.interlocks, configuration.drive.limits
    return FastLoopSettings(
        limits=Limits(
            stale_s=interlocks.stale_s,
            boost_voltage_max_V=interlocks.boost_voltage_max_V,
            output_max=interlocks.output_max,
            output_unit=configuration.load.output_unit,
            output_name=configuration.load.output_name,
            output_min=_output_min(configuration),
        ),
        command=CommandLimits(
            current_scale_min_S=_lowest_scale(configuration),
            current_scale_max_S=limits.current_scale_max_S,
            current_scale_slew_S=limits.current_scale_slew_S,
            boost_reference_max_V=limits.boost_reference_max_V,
        ),
        tick_s=tick_s(configuration),
        latency_ticks=configuration.load.latency_ticks,
        late_fraction=configuration.realtime.late_fraction,
        timer_standin=configuration.realtime.timer_standin,
        ticks_per_reading=configuration.bus.ticks_per_reading,
        stillness=_stillness(configuration),
        response=_response(configuration),
        drive_clocks=configuration.bus.drive_clocks,
        stop_s=interlocks.stop_s,
    )


def _output_min(configuration: Configuration) -> float:
    """Return the lowest output: below it is none that a load at rest or in control has."""
    load, given = configuration.load, configuration.interlocks.output_min
    if given is not None:
        return given
    return min(0.0, load.reference_min) - _BELOW_RANGE * (load.reference_max - load.reference_min)


def _stillness(configuration: Configuration) -> StillnessLimits | None:
    interlocks, section = configuration.interlocks, configuration.load
    if not interlocks.stuck_distance and not interlocks.stuck_s:
        return None
    load = build_load(configuration)
    distance = interlocks.stuck_distance * (section.reference_max - section.reference_min)
    if isinstance(section, BatterySection):  # takes no current at all below its own voltage
        distance = 0.0
    return StillnessLimits(
        unit=section.output_unit,
        gain=load.numerator[-1] / load.denominator[-1],
        input_gain=load.input_gain,
        input_exponent=load.input_exponent,
        lags_s=_lags_s(load),
        distance=distance or math.inf,
        longest_s=interlocks.stuck_s or math.inf,
        name=section.output_name,
        inputs=moved_inputs("output", configuration.derived),
    )


def _lags_s(load: Load) -> tuple[float, ...]:
    """Return equal time constants with the same sum as those of the load."""
    return (load.denominator[-2] / load.denominator[-1] / load.order,) * load.order


def _response(configuration: Configuration) -> ResponseLimits | None:
    factor, section = configuration.interlocks.response_factor, configuration.load
    if not factor:
        return None
    load, highest_V = build_load(configuration), configuration.drive.limits.boost_reference_max_V
    reference_range = section.reference_max - section.reference_min
    limits = ResponseLimits(
        name=section.output_name,
        unit=section.output_unit,
        gain=load.numerator[-1] / load.denominator[-1],
        input_gain=load.input_gain,
        input_exponent=load.input_exponent,
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
