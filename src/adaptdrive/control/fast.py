"""The fast half of the controller: one call per half line cycle.

It runs the λ filters of output and input, averages what the slow half will want, and closes the
voltage loop. The input of the λ filters is the measured boost voltage (through the load's input
map), not V_c: the lag of the voltage loop would otherwise be taken for the load's.

The voltage loop makes the boost voltage follow V_c by scaling the line current. The boost stage is
linear in x = v_bst² whatever the size of the step:

    x[n+1] = x[n] + b k - (2 T / C) p            b = 2 T V_rms² / C

and a scale k computed from frame n acts from frame n+1 to n+2. In I-P form (the proportional part
acts on x alone, the sum S leaves out the present sample)

    b k[n] = Ki S[n] - Kp x[n] + (2 T / C) p[n]          S[n+1] = S[n] + x_ref[n] - x[n]

the closed loop is z³ - 2 z² + (1 + Kp) z + Ki - Kp; Kp = 1/3 and Ki = 1/27 make it (z - 2/3)³: no
overshoot, settled in 0.16 s at 60 Hz. The last term feeds the measured load power forward, and
dividing by the measured line voltage keeps the poles there on a weak or a strong line. The sum
stands still while k is limited and the error would drive it further into the limit.
"""

import math
from collections import deque
from dataclasses import dataclass
from fractions import Fraction

from adaptdrive.control import signals, thresholds
from adaptdrive.control.estimation import filters
from adaptdrive.control.loads.load import Load, to_input
from adaptdrive.control.settings import ControllerSettings, PowerStage
from adaptdrive.control.vectors import Vector

_CEILING_RISE = 0.001
"""Rise of the ceiling of V_c for each reading, as a share of the largest V_c: slow, so that the
power limit does not oscillate."""


@dataclass(slots=True)
class FilterBank:
    """The λ chains of output and input, and their sums over the averaging window.

    Attributes:
        gains: φ, P and R of both chains.
        outputs: y, λy ... λ^m y.
        inputs: u of a dead time ago, λu ... λ^m u.
        late: u of the last ticks, from a dead time ago until now.
        sums: Sums over the window: y, λy ... λ^m y, u, λu ... λ^m u.
        count: Samples in `sums`.
        outlier_filter: What stands in front of the output's chain.
        quantiser: What is known of the resolution of the output.
    """

    gains: filters.Gains
    outputs: Vector
    inputs: Vector
    late: deque[float]
    sums: Vector
    count: int
    outlier_filter: filters.OutlierFilter
    quantiser: filters.Quantiser


@dataclass(slots=True)
class FastState:
    """State of the fast half, apart from its filters.

    Attributes:
        tick: Last tick.
        boost_reference_V: V_c as decided.
        ceiling_V: What the load's power, or its voltage, leaves of it.
        error_sum: Sum of the voltage loop.
        limit: 1, -1 or 0: the limit at which k is held.
        voltage_sum: Sum of v_bst over the slow period so far.
        readings: Measurements in `voltage_sum`.
        limited_ticks: Ticks of the slow period so far with k or V_c at a limit.
        held_ticks: Ticks of the slow period so far without a fresh measurement.
        by_hand: Whether the operator has set V_c in the slow period so far.
        kicked_V: V_c whose last change has been kicked; NaN before the first one.
        kick_V: That change.
        kick_tick: Tick at which it came.
    """

    tick: int
    boost_reference_V: float
    error_sum: float
    ceiling_V: float = math.inf
    limit: int = 0
    voltage_sum: float = 0.0
    readings: int = 0
    limited_ticks: int = 0
    held_ticks: int = 0
    by_hand: bool = False
    kicked_V: float = math.nan
    kick_V: float = 0.0
    kick_tick: int = 0


def new_filter_bank(
    load: Load, tick_period_s: float, tau_lambda_s: float, output: float, boost_voltage_V: float
) -> FilterBank:
    """λ chains that have seen the present output and boost voltage for ever."""
    order = load.order
    load_input = to_input(boost_voltage_V, load.input_gain, load.input_exponent)
    expected = load.gain * load_input
    ticks = 1 + round(load.delay_s / tick_period_s)
    return FilterBank(
        gains=filters.chain_gains(order, tick_period_s, tau_lambda_s),
        outputs=[output] * (order + 1),
        inputs=[load_input] * (order + 1),
        late=deque([load_input] * ticks, ticks),
        sums=[0.0] * (2 * order + 2),
        count=0,
        outlier_filter=filters.OutlierFilter(
            output, 0.0, filters.WIDE * max(abs(output), abs(expected))
        ),
        quantiser=filters.Quantiser(output),
    )


def take_in(
    settings: ControllerSettings,
    load: Load,
    state: FastState,
    bank: FilterBank,
    measurement: signals.Measurement,
) -> bool:
    """Filter one measurement and keep the books.

    Args:
        settings: Rates and clipping.
        load: Its input map.
        state: Overwritten.
        bank: Overwritten.
        measurement: Of this tick.

    Returns:
        True when a slow period ends with this tick.
    """
    rates, tick = settings.rates, measurement.tick
    into_period = tick % rates.ticks_per_period
    load_input = to_input(measurement.boost_voltage_V, load.input_gain, load.input_exponent)
    elapsed = tick - state.tick
    counted = min(max(elapsed, 1), rates.ticks_per_period)
    if elapsed > 0:
        output = measurement.output
        filters.note_sample(bank.quantiser, output, settings.learning.output_scale, counted)
        if rates.clip > 0.0:
            learning = settings.learning
            least = max(filters.FINEST * learning.output_scale, learning.resolution)
            output = filters.reject_outlier(bank.outlier_filter, output, rates.clip, elapsed, least)
        filter_sample(bank, output, load_input, counted)
    count_tick(state, measurement.boost_voltage_V, measurement.fresh, counted)
    if into_period == 0 or into_period > rates.ticks_per_period - rates.samples:
        accumulate(bank)
    state.tick = tick
    return not 0 <= into_period - elapsed < rates.ticks_per_period  # the tick before lies outside


def filter_sample(bank: FilterBank, output: float, load_input: float, ticks: int) -> None:
    """Move the chains to a new sample, linearly over the ticks since the last one."""
    last_output, last_input = bank.outputs[0], bank.late[-1]
    for i in range(1, ticks + 1):
        bank.late.append(last_input + (load_input - last_input) * i / ticks)
        filters.advance(bank.outputs, bank.gains, last_output + (output - last_output) * i / ticks)
        filters.advance(bank.inputs, bank.gains, bank.late[0])
    bank.outputs[0], bank.late[-1] = output, load_input


def accumulate(bank: FilterBank) -> None:
    """Add the present sample to the window."""
    size = len(bank.outputs)
    for i in range(size):
        bank.sums[i] += bank.outputs[i]
        bank.sums[size + i] += bank.inputs[i]
    bank.count += 1


def take_means(bank: FilterBank) -> Vector:
    """The means over the window, which starts again empty; the last sample if it was empty."""
    if bank.count == 0:
        accumulate(bank)
    means = [value / bank.count for value in bank.sums]
    bank.sums, bank.count = [0.0] * len(means), 0
    return means


def take_rounding(settings: ControllerSettings, bank: FilterBank) -> tuple[float, float]:
    """Return step and rounding error of the output at the end of a slow period, in its unit.

    Args:
        settings: A resolution that is configured counts instead of what the samples show.
        bank: Overwritten: its count of changes begins again.
    """
    quantiser = bank.quantiser
    filters.close_share(quantiser, settings.rates.ticks_per_period)
    if not settings.exact:
        return 0.0, 0.0
    given = settings.learning.resolution
    step = given if given > 0.0 else quantiser.step
    return step, filters.rounding_error(step, quantiser.share)


def drive(
    state: FastState,
    stage: PowerStage,
    measurement: signals.Measurement,
    highest_V: float = math.inf,
) -> tuple[float, float]:
    """Return the command for the drive: current scale k in siemens, and V_c in force in volts.

    Args:
        state: Overwritten.
        stage: Limits.
        measurement: Of this tick.
        highest_V: V_c that the load bears at present.
    """
    voltage_V, power_W = measurement.boost_voltage_V, measurement.load_power_W
    reference_V = hold_back(state, stage, voltage_V, power_W, highest_V)
    if stage.kick_ticks > 0:
        reference_V = kick(state, stage, reference_V, measurement.tick)
    if stage.holds_voltage:
        return 0.0, reference_V
    line_V, tick_s = measurement.line_voltage_V, measurement.tick_period_s
    scale_S = regulate_voltage(state, stage, reference_V, voltage_V, line_V, power_W, tick_s)
    return scale_S, reference_V


def kick(state: FastState, stage: PowerStage, reference_V: float, tick: int) -> float:
    """Exaggerate the last change of V_c, so that the impulse-invariant model holds."""
    if math.isnan(state.kicked_V) or state.by_hand:
        state.kicked_V, state.kick_V = state.boost_reference_V, 0.0
    elif state.kicked_V != state.boost_reference_V:
        state.kick_V, state.kick_tick = state.boost_reference_V - state.kicked_V, tick
        state.kicked_V = state.boost_reference_V
    part = (tick - state.kick_tick) // stage.kick_ticks
    if part == 0:
        reference_V += stage.kick_first * state.kick_V
    elif part == 1:
        reference_V += stage.kick_second * state.kick_V
    limited_V = max(reference_V, stage.boost_reference_min_V)
    return min(limited_V, stage.boost_reference_max_V, state.ceiling_V)


def set_by_hand(
    state: FastState, stage: PowerStage, voltage_V: float, highest_V: float = math.inf
) -> None:
    """Set V_c to the operator's value within the limits of the drive; one that is NaN changes none.

    Args:
        state: Overwritten.
        stage: Limits.
        voltage_V: The operator's value.
        highest_V: V_c that the load bears at present.
    """
    if math.isfinite(voltage_V):
        limited_V = max(min(voltage_V, highest_V), stage.boost_reference_min_V)
        state.boost_reference_V = min(limited_V, stage.boost_reference_max_V)
    state.by_hand = True


def hold_back(
    state: FastState,
    stage: PowerStage,
    boost_voltage_V: float,
    load_power_W: float,
    highest_V: float = math.inf,
) -> float:
    """V_c in force: held back by what the load bears, and while it draws more than the drive gives.

    At constant speed or temperature the power goes with the square of the voltage, so that the
    square root of the excess is a voltage that ends it; the ceiling then rises slowly again.

    Args:
        state: Its ceiling is overwritten.
        stage: Limits.
        boost_voltage_V: v_bst.
        load_power_W: What the load draws.
        highest_V: V_c that the load bears at present.
    """
    excess = load_power_W / stage.load_power_max_W
    ceiling_V = state.ceiling_V + _CEILING_RISE * stage.boost_reference_max_V
    if excess > 1.0:
        lowest_V = stage.boost_reference_min_V  # of a voltage that is no number, too
        ceiling_V = max(lowest_V, abs(boost_voltage_V) / math.sqrt(excess))
    state.ceiling_V = max(min(ceiling_V, highest_V), stage.boost_reference_min_V)
    return min(state.boost_reference_V, state.ceiling_V)


def count_tick(state: FastState, boost_voltage_V: float, fresh: bool, ticks: int = 1) -> None:
    """Keep the books of the slow period.

    Args:
        state: Overwritten.
        boost_voltage_V: v_bst.
        fresh: Whether it was measured now, not held.
        ticks: Half line cycles since the last reading: more than 1 where a drive is polled.
    """
    state.voltage_sum += boost_voltage_V
    state.readings += 1
    if state.limit != 0 or state.ceiling_V < state.boost_reference_V:
        state.limited_ticks += ticks
    if not fresh:
        state.held_ticks += ticks


def close_period(state: FastState, settings: ControllerSettings) -> tuple[float, bool, int]:
    """Books of the elapsed slow period: mean voltage, whether it followed V_c, held ticks."""
    applied_V = state.voltage_sum / state.readings if state.readings else math.nan
    followed = state.limited_ticks <= thresholds.LOST_SHARE * settings.rates.ticks_per_period
    held = state.held_ticks
    state.voltage_sum = 0.0
    state.readings = state.limited_ticks = state.held_ticks = 0
    state.by_hand = False
    return applied_V, followed, held


# The voltage loop.

_POLE = Fraction(2, 3)
"""Pole of the closed loop, a triple one: whatever Kp and Ki are, the three add up to 2."""

PROPORTIONAL = float(3 * _POLE**2 - 1)
"""Kp: 1/3, for the loop has 1 + Kp before z, and 3 p² with three poles at p."""

INTEGRAL = float((1 - _POLE) ** 3)
"""Ki: 1/27, for the loop is Ki at z = 1."""

LAG_TICKS = float(3 / (1 - _POLE))
"""Mean delay of the closed loop in ticks: 9, 3 for each pole."""


def initial_sum(boost_voltage_V: float) -> float:
    """Return the sum S at which the current equals that of the load, at the present voltage."""
    return PROPORTIONAL / INTEGRAL * boost_voltage_V * boost_voltage_V


def current_scale(
    error_sum: float,
    boost_voltage_V: float,
    load_power_W: float,
    line_voltage_V: float,
    tick_period_s: float,
    capacitance_F: float,
) -> float:
    """The line-current scale k in siemens, before limits.

    Args:
        error_sum: S, in V².
        boost_voltage_V: v_bst of this frame.
        load_power_W: Load power to feed forward; 0 for none.
        line_voltage_V: Line voltage, rms.
        tick_period_s: T, half a line cycle.
        capacitance_F: C, boost capacitor.
    """
    square = boost_voltage_V * boost_voltage_V
    wanted = INTEGRAL * error_sum - PROPORTIONAL * square
    power_W = wanted * capacitance_F / (2.0 * tick_period_s) + load_power_W
    return power_W / (line_voltage_V * line_voltage_V)


def advance_sum(error_sum: float, reference_V: float, boost_voltage_V: float, limit: int) -> float:
    """S for the next frame.

    Args:
        error_sum: S.
        reference_V: V_c.
        boost_voltage_V: v_bst of this frame.
        limit: 1 when k is held at its upper limit, -1 at its lower one, 0 when it is free.
    """
    error = reference_V * reference_V - boost_voltage_V * boost_voltage_V
    if error * limit > 0.0:
        return error_sum
    return error_sum + error


def regulate_voltage(
    state: FastState,
    stage: PowerStage,
    reference_V: float,
    boost_voltage_V: float,
    line_voltage_V: float,
    load_power_W: float,
    tick_period_s: float,
) -> float:
    """One step of the voltage loop: the limited current scale k in siemens."""
    wanted = current_scale(
        state.error_sum,
        boost_voltage_V,
        load_power_W,
        max(line_voltage_V, stage.line_voltage_min_V),
        tick_period_s,
        stage.capacitance_F,
    )
    if not math.isfinite(wanted):  # an absurd measurement; it must not stay in the sum
        return min(max(0.0, stage.current_scale_min_S), stage.current_scale_max_S)
    scale = min(max(wanted, stage.current_scale_min_S), stage.current_scale_max_S)
    state.limit = (wanted > scale) - (wanted < scale)
    state.error_sum = advance_sum(state.error_sum, reference_V, boost_voltage_V, state.limit)
    return scale
