"""Settings of controller, runtime and interlocks, made from the configuration."""

import functools
import math
from collections.abc import Callable

from adaptdrive import __version__
from adaptdrive.app import loads
from adaptdrive.app.loads import build_load
from adaptdrive.config import Configuration, consistency
from adaptdrive.config.bus import CanBus, CanOpenBus
from adaptdrive.config.load import FORGETTING, MotorSection
from adaptdrive.control import fast, settings, thresholds
from adaptdrive.control.estimation.direct import METHODS
from adaptdrive.control.loads.discretise import KICK_SHARE, kick_factors
from adaptdrive.control.loads.load import to_input
from adaptdrive.control.supervision.setpoints import nominal_reach
from adaptdrive.mqtt.contract import Output, Profile
from adaptdrive.runtime.settings import FastLoopSettings, MachineLimits
from adaptdrive.safety import frames, plausibility
from adaptdrive.safety.interlocks import Limits
from adaptdrive.safety.timing import timing_of

# The interlocks that a configuration asks for: trip levels, and watches over the output.

_BELOW_RANGE = 0.25
"""Noise of 5 % and the overshoot of a step downwards stay above."""


def trip_limits(configuration: Configuration) -> Limits:
    """Return the levels at which a single reading trips the drive."""
    interlocks, load = configuration.interlocks, configuration.load
    lowest = interlocks.output_min
    if lowest is None:  # no load at rest or in control has an output below it
        span = load.reference_max - load.reference_min
        lowest = min(0.0, load.reference_min) - _BELOW_RANGE * span
    return Limits(
        boost_voltage_max_V=interlocks.boost_voltage_max_V,
        output_max=interlocks.output_max,
        display=load.display,
        output_name=load.output_name,
        given=configuration.drive.given,
        output_min=lowest,
        absent=consistency.absent_names(configuration),
    )


def watches(configuration: Configuration) -> tuple[Callable[[], plausibility.Watch], ...]:
    """Return the factories of the watches over the output; a fast loop builds its own of each."""
    found: list[Callable[[], plausibility.Watch]] = []
    if (stillness := loads.stillness_limits(configuration)) is not None:
        found.append(functools.partial(plausibility.StillnessWatch, stillness))
    if (response := loads.response_limits(configuration)) is not None:
        found.append(functools.partial(plausibility.Response, response))
    return tuple(found)


# Settings of controller and runtime, made from the configuration.

_LOWEST_LINE = 0.5
"""Share of the nominal line voltage below which the voltage loop does not divide by it."""

_SWING_SHARE = 0.01
"""Smallest peak that counts as a swing, as a share of the range of set-points."""

_ERROR_SHARE = 0.1
"""Distance from the response asked for that must not last, as a share of the range of
set-points."""

_NOISE_SHARE = 0.04
"""Largest standard deviation of V_c that noise may cause, as a share of its range."""

_CLIP = 5.0
"""Mean deviations about its prediction to which a fast sample is clipped."""

_GATE = 1.2
"""Multiple of 1 - ρ above which rᵀPr lets a sample teach; below it the output does not move."""

_DAMPING_MIN = 0.9
"""Smallest damping of an estimated load: real time constants have 1."""

_SPREAD_MAX = 0.05
"""Largest error of the response to a step within the confidence, as a share of the step."""

_RESIDUAL_MARGIN = 1.5
"""Largest prediction error, over that of the nominal model."""

_CONFIDENCE = 2.0
"""Standard deviations of an estimate within which its gains must keep the loop stable."""

_DWELL_PERIODS = 7
"""Good estimates in a row before the first goes live."""

_BLEND_PERIODS = 5
"""Slow periods over which one law hands over to the other."""

_PROBE_S = 300.0
"""Time without movement after which the load counts as unknown, and least time between probes."""

_OPEN = thresholds.UNKNOWN * thresholds.UNKNOWN / thresholds.NOISE_FLOOR
"""P[0] of the exact design, over σ²: nothing is known of any parameter, at the smallest σ."""

PAPER_COVARIANCE = 1.0e4
"""P[0] of the paper."""

_SHORTEST_WAVE_PERIODS = 4
"""Shortest period of a waveform, in slow periods: two samples for each half."""


def controller_settings(configuration: Configuration) -> settings.ControllerSettings:
    """Return all settings of the controller."""
    load, warm_up_s = configuration.load, configuration.supervisor.warm_up_s
    exact = load.design == "exact"
    return settings.ControllerSettings(
        exact=exact,
        stage=_power_stage(configuration),
        rates=settings.Rates(
            ticks_per_period=configuration.ticks_per_period,
            latency_ticks=load.latency_ticks,
            samples=load.samples if exact else 1,
            nominal_tick_s=configuration.drive.half_cycle_s,
            clip=_CLIP if exact else 0.0,
            lag_ticks=_lag_ticks(configuration),
        ),
        learning=_learning(configuration) if exact else paper_learning(configuration),
        supervision=_supervision(configuration)
        if exact
        else settings.SupervisionLimits(_periods(configuration, warm_up_s)),
        probing=_probing(configuration),
    )


def _lag_ticks(configuration: Configuration) -> float:
    """Mean delay of the loop that holds the boost voltage; a drive's own may have another."""
    lag_s = configuration.voltage_loop.lag_s
    return fast.LAG_TICKS if lag_s is None else lag_s / configuration.drive.half_cycle_s


def _power_stage(configuration: Configuration) -> settings.PowerStage:
    drive, loop = configuration.drive, configuration.voltage_loop
    limits = drive.limits
    kick_ticks, kick_first, kick_second = _kicks(configuration)
    return settings.PowerStage(
        current_scale_min_S=drive.current_scale_min_S,
        current_scale_max_S=limits.current_scale_max_S,
        boost_reference_min_V=limits.boost_reference_min_V,
        boost_reference_max_V=limits.boost_reference_max_V,
        load_power_max_W=limits.load_power_max_W,
        capacitance_F=drive.boost_capacitance_F,
        line_voltage_min_V=_LOWEST_LINE * drive.line_voltage_V,
        holds_voltage=loop.where == "drive",
        boost_needs_bridge=drive.boost_needs_bridge,
        kick_ticks=kick_ticks,
        kick_first=kick_first,
        kick_second=kick_second,
    )


def _kicks(configuration: Configuration) -> tuple[int, float, float]:
    """Return length and factors of the kicks for the impulse-invariant model; 0 to hold V_c."""
    section = configuration.load
    if not isinstance(section, MotorSection) or section.boost_course == "held":
        return 0, 0.0, 0.0
    tick_s = configuration.drive.half_cycle_s
    ticks = round(KICK_SHARE * configuration.ticks_per_period)
    delay_s = (section.latency_ticks + _lag_ticks(configuration)) * tick_s
    load = build_load(configuration)
    return ticks, *kick_factors(load, section.period_s, delay_s, ticks * tick_s)


def _learning(configuration: Configuration) -> settings.EstimatorSettings:
    estimator, load = configuration.estimator, build_load(configuration)
    charges = configuration.load.traits.charges
    limits = configuration.drive.limits
    low_V, high_V = limits.boost_reference_min_V, limits.boost_reference_max_V
    middle_V = 0.5 * (low_V + high_V if low_V >= 0.0 else max(-low_V, abs(high_V)))
    middle = to_input(middle_V, load.input_gain, load.input_exponent)
    physical = METHODS[estimator.method].physical
    return settings.EstimatorSettings(
        tau_lambda_s=estimator.tau_lambda_s,
        gate=_GATE,
        alert=True,
        initial_state=True,
        method=estimator.method,
        forgetting=estimator.forgetting or FORGETTING,
        initial_covariance=_OPEN if physical else PAPER_COVARIANCE,
        settle_periods=_periods(configuration, estimator.settle_s),
        output_scale=load.gain * middle,
        input_scale=middle,
        start_at_nominal=True,
        short_lag_s=loads.short_lag_s(configuration),
        bias=estimator.bias or charges,
        resolution=configuration.load.resolution,
        charge=charges and physical,
        drifts=configuration.load.traits.drifts and physical,
    )


def _supervision(configuration: Configuration) -> settings.SupervisionLimits:
    supervisor, load = configuration.supervisor, configuration.load
    reference_range = load.reference_max - load.reference_min
    return settings.SupervisionLimits(
        ratio_min=supervisor.ratio_min,
        ratio_max=supervisor.ratio_max,
        revokes=True,
        damping_min=_DAMPING_MIN,
        spread_max=_SPREAD_MAX,
        residual_margin=_RESIDUAL_MARGIN,
        dwell_periods=_DWELL_PERIODS,
        blend_periods=_BLEND_PERIODS,
        confidence=_CONFIDENCE,
        warm_up_periods=_periods(configuration, supervisor.warm_up_s),
        saturated_periods=_periods(configuration, supervisor.saturated_s),
        error_limit=_ERROR_SHARE * reference_range,
        swing_min=_SWING_SHARE * reference_range,
        response_periods=_periods(configuration, supervisor.response_s),
        response_distance=supervisor.response_distance * reference_range,
        noise_max=_noise_max(configuration),
    )


def _probing(configuration: Configuration) -> settings.Probing:
    """Return limits of the probing, which needs an estimate of physical parameters."""
    load = configuration.load
    if load.design != "exact" or not METHODS[configuration.estimator.method].physical:
        return settings.Probing()
    scale = 1.0 if load.traits.charges else load.reference_max - load.reference_min
    return settings.Probing(
        amplitude=load.probe_share * scale,
        stale_periods=_periods(configuration, _PROBE_S),
        settle_periods=_periods(configuration, configuration.estimator.settle_s),
        lowest=load.reference_min,
        highest=load.reference_max,
    )


def _noise_max(configuration: Configuration) -> float:
    """Largest noise of the input, converted from volts in the middle of the range of V_c."""
    limits, load = configuration.drive.limits, build_load(configuration)
    low_V, high_V = limits.boost_reference_min_V, limits.boost_reference_max_V
    noise_V = _NOISE_SHARE * (high_V - low_V)
    middle_V, gain, exponent = 0.5 * (low_V + high_V), load.input_gain, load.input_exponent
    upper, lower = middle_V + 0.5 * noise_V, middle_V - 0.5 * noise_V
    return to_input(upper, gain, exponent) - to_input(lower, gain, exponent)


def _periods(configuration: Configuration, time_s: float) -> int:
    return math.ceil(time_s / configuration.load.period_s)


def machine_limits(configuration: Configuration) -> MachineLimits:
    """Return the limits of an operator's requests."""
    load, drive = configuration.load, configuration.drive
    law, model = controller_settings(configuration), build_load(configuration)
    pole_min, pole_max = loads.pole_range(law, model, load)
    patience_s = configuration.interlocks.precharge_timeout_s
    verdict_ticks = frames.verdict_ticks(configuration.bus.ticks_per_reading)
    return MachineLimits(
        load=load,
        drive=drive,
        pole_min=pole_min,
        pole_max=pole_max,
        period_min_s=_SHORTEST_WAVE_PERIODS * load.period_s,
        starting_ticks=round(patience_s / drive.half_cycle_s),
        rate_s=max(patience_s, verdict_ticks * drive.half_cycle_s),
        reach=nominal_reach(model, law.stage),
    )


def fast_settings(configuration: Configuration) -> FastLoopSettings:
    """Return the settings of the fast loop."""
    bus = configuration.bus
    return FastLoopSettings(
        latency_ticks=configuration.load.latency_ticks,
        drive_clocks=isinstance(bus, CanBus)
        or (isinstance(bus, CanOpenBus) and bus.sync == "drive"),
        limits=trip_limits(configuration),
        watches=watches(configuration),
        drive=configuration.drive,
        timing=timing_of(configuration),
        charges_capacitor=configuration.voltage_loop.where == "daemon",
    )


def paper_learning(configuration: Configuration) -> settings.EstimatorSettings:
    """Return the plain estimator (3), which starts at θ = 0; a battery's EMF is a bias of it.

    Nothing is added to the paper's controller: no bounds, no patience, no scaling, no gate, no
    blending. An estimate that is not finite or not stable, or whose loop would not be, leaves the
    gains in force as they are; nothing else is checked.
    """
    estimator, load = configuration.estimator, configuration.load
    return settings.EstimatorSettings(
        method=estimator.method,
        forgetting=estimator.forgetting or load.traits.paper_forgetting,
        tau_lambda_s=estimator.tau_lambda_s,
        initial_covariance=PAPER_COVARIANCE,
        bias=load.traits.charges,
    )


# The names, units and limits of a drive that operators see.


def operator_profile(configuration: Configuration) -> Profile:
    """Return names, units and limits of a drive, which operators need in addition to its state."""
    load, drive = configuration.load, configuration.drive.limits
    trips, machine = trip_limits(configuration), machine_limits(configuration)
    return Profile(
        drive=configuration.drive.name,
        output=Output(
            load.output_name, load.output_unit, load.display if load.output_display else None
        ),
        manipulated=configuration.drive.given,
        limits={
            "setpoint": (load.reference_min, load.reference_max),
            "output_trip": (trips.output_min, trips.output_max),
            "pole": (machine.pole_min, machine.pole_max),
            "period_s": (machine.period_min_s, None),
            "boost_V": (drive.boost_reference_min_V, drive.boost_reference_max_V),
            "boost_trip_V": (None, trips.boost_voltage_max_V),
            "power_W": (None, drive.load_power_max_W),
        },
        version=__version__,
    )
