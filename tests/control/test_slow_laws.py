"""One slow period with a trusted estimate: both laws, the change between them, and the watches."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from adaptdrive.control.charging import Charging
from adaptdrive.control.design import compensator_gains, discrete_model, reference_lead
from adaptdrive.control.loads.battery import battery_load
from adaptdrive.control.regression import theta_of
from adaptdrive.control.slow_half import slow_step
from adaptdrive.control.slow_state import SlowSample, SlowState, new_slow_state
from tests.closed_loop.bench import AT_REST, EXACT, MOTOR, REST_V

POLE = 0.7
BLEND = 4
JACKET = replace(EXACT.jacket, warm_up_periods=0, blend_periods=BLEND, ratio_min=0.5, ratio_max=4.0)
SETTINGS = replace(EXACT, jacket=JACKET)
LEAD = reference_lead(SETTINGS, MOTOR)
UNTAUGHT = 0.2
"""Share of stand-in ticks from which a sample teaches nothing: the estimate stays."""

SAMPLE = replace(AT_REST, held_share=UNTAUGHT)
HEAVY = [0.011, 33.4, 234.0]
BATTERY = battery_load(0.25, 1.2, 0.3, 60.0, Charging(0.25, 1.0, 0.2, 58.0, 1.0))


def known() -> SlowState:
    """A slow half at rest that is sure of a motor with two disks."""
    state = new_slow_state(SETTINGS, MOTOR, 3.0, REST_V)
    state.estimator.estimate.theta[:3] = theta_of(SETTINGS.learning, MOTOR, *MOTOR.realise(HEAVY))
    state.estimator.estimate.diagonal[:] = [1e-6] * 3
    state.estimator.periods = 100
    state.reference_filter.course[:] = [3.0] * len(state.reference_filter.course)
    return state


def gains_of(values: list[float]) -> list[float]:
    a, b = discrete_model(SETTINGS, MOTOR, *MOTOR.realise(values), 1.0)
    return list(compensator_gains(a, b, 2, POLE))


FIXED, ADAPTIVE = gains_of([0.011, 21.7, 117.0]), gains_of(HEAVY)


def law(gains: list[float], inputs: list[float], outputs: list[float], reference: float) -> float:
    taps = len(inputs)
    errors = reference - np.array(outputs)
    return float(np.dot(gains[taps:], errors) - np.dot(gains[:taps], inputs))


def led(references: list[float]) -> float:
    return references[-1] + LEAD * (references[-1] - references[-2])


def test_one_law_hands_over_to_the_other_by_equal_shares_of_both() -> None:
    state, inputs = known(), [REST_V] * len(known().inputs)
    outputs, references = [3.0] * 3, [3.0]
    shares = [0.25, 0.5, 0.75, 1.0, 1.0, 0.75, 0.5, 0.25, 0.0, 0.0]
    seen = []
    for number, share in enumerate(shares):
        references.append(3.0 + 0.05 * (number > 1))
        outputs = [3.0 + 0.002 * number, *outputs[:-1]]
        fixed = law(FIXED, inputs, outputs, led(references))
        other = law(ADAPTIVE, inputs, outputs, led(references))
        asked = replace(SAMPLE, output=outputs[0], reference=references[-1], adaptive=number < 5)
        seen.append(abs(fixed - other))
        inputs = [slow_step(SETTINGS, MOTOR, state, asked), *inputs[:-1]]
        assert inputs[0] == pytest.approx(fixed + share * (other - fixed), abs=1e-6)
        assert state.adaptive is (number < 5)
        step = fixed - other if number < 5 else other - fixed
        assert state.handover_step == pytest.approx(step, abs=1e-6)
    assert max(seen) > 1.0
    assert LEAD > 0.0


@pytest.mark.parametrize("periods", [1, BLEND])
def test_what_the_adaptive_law_asks_for_in_vain_is_taken_back_once_it_alone_is_in_force(
    periods: int,
) -> None:
    """The course of the reference filter is then the one that the limited input belongs to."""
    state = known()
    for _ in range(periods - 1):
        slow_step(SETTINGS, MOTOR, state, SAMPLE)
    before, outputs = list(state.inputs), [3.0] * 3
    assert slow_step(SETTINGS, MOTOR, state, replace(SAMPLE, reference=4.4)) == 400.0
    loop, course = state.reference_filter.loop, state.reference_filter.course
    asked = law(ADAPTIVE, before, outputs, float(np.dot(loop, course) / sum(loop)))
    wanted = law(ADAPTIVE, before, outputs, led([3.0, 4.4]))
    assert wanted > 410.0
    assert asked == pytest.approx(400.0 if periods == BLEND else wanted, abs=1e-5)


def test_a_law_that_is_not_a_number_repeats_the_newest_input() -> None:
    state = new_slow_state(SETTINGS, MOTOR, 3.0, REST_V)
    state.inputs[:] = [290.0, *[280.0] * (len(state.inputs) - 1)]
    state.sent = 290.0
    asked = replace(SAMPLE, reference=math.nan, adaptive=False)
    assert slow_step(SETTINGS, MOTOR, state, asked) == 290.0


@pytest.mark.parametrize("manual", [False, True])
def test_the_response_asked_for_has_four_equal_poles_or_is_what_the_operator_has_made(
    *, manual: bool
) -> None:
    state = known()
    references = 3.0 + 0.1 * np.random.default_rng(5).normal(size=30)
    for number, reference in enumerate(references):
        output = 3.0 + 0.001 * number
        asked = replace(SAMPLE, output=output, reference=float(reference), manual=manual,
                        adaptive=not manual, held=REST_V if manual else math.nan)  # fmt: skip
        slow_step(SETTINGS, MOTOR, state, asked)
    ideal = references - 3.0
    for _ in range(4):
        ideal = lfilter([1.0 - POLE], [1.0, -POLE], ideal)
    assert state.expected[-1] == pytest.approx(3.029 if manual else 3.0 + ideal[-1], abs=1e-9)


def test_the_charge_is_the_sum_of_the_output_over_time() -> None:
    state = known()
    for output, period_s in ((3.0, 1.0), (3.3, 2.0)):
        slow_step(SETTINGS, MOTOR, state, replace(SAMPLE, output=output, period_s=period_s))
    scale, tau_s = SETTINGS.learning.output_scale, SETTINGS.learning.tau_lambda_s
    assert state.estimator.charge == pytest.approx((3.0 + 6.6) / scale / tau_s)
    assert state.estimator.sample.time_s == 3.0


def cycling(state: SlowState, sample: SlowSample, periods: int = 70) -> bool:
    """Whether an output that swings across the set-point is called a limit cycle."""
    settings = replace(SETTINGS, jacket=replace(JACKET, swing_min=0.1))
    for number in range(periods):
        state.supervisor.own_power, state.supervisor.fixed_power = 0.0, 1e12
        state.supervisor.fixed_mean = 0.0
        swinging = replace(sample, output=3.0 + 20.0 * (-1.0) ** number)
        slow_step(settings, MOTOR, state, swinging)
    return state.cycling


def test_the_fixed_law_alone_can_be_in_a_limit_cycle() -> None:
    fixed = replace(SAMPLE, adaptive=False)
    assert cycling(known(), fixed)
    assert not cycling(known(), fixed, 40)
    assert not cycling(known(), replace(fixed, manual=True, held=REST_V))
    assert not cycling(known(), SAMPLE)
    assert not cycling(known(), replace(fixed, low=REST_V, high=REST_V))  # no range, no limit


def charged(state: SlowState, terminal_V: float, **changes: object) -> float:
    """Let a battery be charged for one slow period; return the input."""
    input_V = (terminal_V + 10.0) / 0.25
    sample = replace(
        SAMPLE, output=10.0, output_filtered=[10.0], input_filtered=[input_V] * 2, reference=20.0,
        adaptive=False, **changes,  # type: ignore[arg-type]
    )  # fmt: skip
    return slow_step(SETTINGS, BATTERY, state, sample)


def test_the_current_of_a_battery_is_lowered_above_its_voltage_limit() -> None:
    state = new_slow_state(SETTINGS, BATTERY, 10.0, 240.0)
    charged(state, 58.4)
    assert state.charge.current_A == pytest.approx(10.0 - 0.05 * 0.4 / 0.2)
    assert state.reference == state.charge.current_A
    charged(state, 57.6)
    assert state.reference == pytest.approx(10.0)


def test_an_operator_leads_the_current_of_a_battery_by_hand() -> None:
    state = new_slow_state(SETTINGS, BATTERY, 10.0, 240.0)
    state.charge.ending_periods = 5
    assert charged(state, 58.4, manual=True, held=250.0) == 250.0
    assert (state.charge.current_A, state.charge.ending_periods) == (10.0, 0)


def test_a_battery_without_its_voltage_rests_at_the_input_over_its_dc_impedance() -> None:
    """0.25 · 240 V over 1.2 Ohm + 0.3 Ohm."""
    watch = new_slow_state(SETTINGS, BATTERY, 10.0, 240.0).watch
    assert (watch.fast, watch.slow) == pytest.approx((40.0, 40.0))
    watch = new_slow_state(SETTINGS, MOTOR, 2.5, REST_V).watch
    assert (watch.fast, watch.slow) == (2.5, 2.5)
