"""One slow period: rest, history, redesign, and what is not learnt."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from adaptdrive.control.design.noise import Law, noise_gain, slowed_loop
from adaptdrive.control.design.pole_placement import Plant, discrete_model, reference_lead
from adaptdrive.control.estimation.regression import Regression
from adaptdrive.control.loads.battery import battery_load
from adaptdrive.control.loads.load import Charging
from adaptdrive.control.settings import ControllerSettings
from adaptdrive.control.signals import SlowSample
from adaptdrive.control.slow import slow_step
from adaptdrive.control.supervision.monitor import Fallback
from adaptdrive.control.supervision.state import SlowState
from adaptdrive.control.vectors import copy_into
from tests.integration.closed_loop.bench import AT_REST, EXACT, MOTOR, PAPER, PLAIN_LEARNING, REST_V
from tests.unit.control.systems import motor_system

BOTH = pytest.mark.parametrize("settings", [EXACT, PAPER])


def at_rest(settings: ControllerSettings = EXACT) -> SlowState:
    return SlowState(settings, MOTOR, 3.0, REST_V)


def sample(output: float = 3.0, *, adaptive: bool = False, **changes: Any) -> SlowSample:
    filtered = [output, output]
    return replace(AT_REST, output=output, output_filtered=filtered, adaptive=adaptive, **changes)


@BOTH
def test_at_rest_it_holds_still(settings: ControllerSettings) -> None:
    state = at_rest(settings)
    for _ in range(50):
        assert slow_step(settings, MOTOR, state, sample()) == pytest.approx(REST_V, abs=1e-6)
    assert math.isnan(state.handover_step)  # no other law is known


@BOTH
@pytest.mark.parametrize("reference", [-1e6, 0.0, 10.0, 1e6])
def test_the_input_is_limited_and_remembered_as_limited(
    settings: ControllerSettings, reference: float
) -> None:
    state = at_rest(settings)
    wanted = slow_step(settings, MOTOR, state, sample(reference=reference))
    assert wanted == (400.0 if reference > 3.0 else 200.0)
    assert state.inputs[0] == wanted


def test_where_the_drive_could_not_follow_the_history_holds_what_was_applied() -> None:
    for followed, remembered in ((False, 250.0), (True, REST_V)):
        state = at_rest()
        slow_step(EXACT, MOTOR, state, sample(applied=250.0, followed=followed))
        assert state.inputs[1] == remembered
    state = at_rest()
    slow_step(EXACT, MOTOR, state, sample(applied=math.nan, followed=False))
    assert np.isfinite(state.inputs).all()  # what is unknown is not believed


@BOTH
def test_a_pole_or_a_period_that_changes_makes_new_fixed_gains(
    settings: ControllerSettings,
) -> None:
    state, seen = at_rest(settings), []
    for pole, period_s in ((0.7, 1.0), (0.8, 1.0), (0.8, 1.001)):
        slow_step(settings, MOTOR, state, sample(pole=pole, period_s=period_s))
        seen.append(tuple(state.fixed_gains))
    assert len(set(seen)) == 3
    slow_step(settings, MOTOR, state, sample(pole=0.8, period_s=1.00100001))
    assert tuple(state.fixed_gains) == seen[-1]


def test_a_reference_faster_than_a_slow_pole_is_no_error_of_the_loop() -> None:
    """The loop lags far behind such a reference for ever, as it was asked to."""
    settings = replace(EXACT, supervision=replace(EXACT.supervision, error_limit=0.1))
    a, b = discrete_model(settings, MOTOR, list(MOTOR.numerator), list(MOTOR.denominator), 1.0)
    state, inputs, outputs, lags = at_rest(settings), [REST_V] * len(b), [3.0] * len(a), []
    for k in range(1000):
        reference = 3.0 + 0.4 * (k // 20 % 2)
        outputs = [np.dot(b, inputs) - np.dot(a[1:], outputs[: len(a) - 1]), *outputs[:-1]]
        asked = sample(float(outputs[0]), reference=reference, pole=0.95, adaptive=True)
        inputs = [0.0, slow_step(settings, MOTOR, state, asked), *inputs[1:-1]]
        lags.append(abs(reference - outputs[0]))
    assert min(lags[-20:]) > settings.supervision.error_limit
    assert state.watch.fallback == Fallback.NONE


@pytest.mark.parametrize(("held_share", "learns"), [(0.0, True), (0.1, True), (0.11, False)])
def test_a_period_with_many_stand_in_ticks_teaches_nothing(held_share: float, learns: bool) -> None:
    settings = replace(EXACT, learning=PLAIN_LEARNING)
    state = at_rest(settings)
    slow_step(settings, MOTOR, state, sample(3.01, held_share=held_share))
    assert any(state.estimator.estimate.theta) == learns


@pytest.mark.parametrize(("method", "compared"), [("lm-rls", True), ("rls", False)])
def test_only_physical_estimates_are_compared_with_the_nominal_load(
    method: str, compared: bool
) -> None:
    """Whose error is proportional to the distance of the output from where the load rests."""
    settings, powers = replace(EXACT, learning=replace(PLAIN_LEARNING, method=method)), []
    for distance in (0.0, 0.01, 0.02):
        state = at_rest(settings)
        slow_step(settings, MOTOR, state, sample(3.0 + distance))
        powers.append(state.supervisor.fixed_power)
    assert powers == pytest.approx([0.0, powers[1], 4.0 * powers[1]], abs=1e-15)
    assert (powers[1] > 0.0) == compared


SLOWEST_FALL_V = 20.0
"""What a load takes from the boost capacitor of a unidirectional drive in a slow period."""


def heavy() -> Plant:
    """A motor with three disks."""
    system = motor_system(3)
    return Plant(*discrete_model(EXACT, MOTOR, system.numerator, system.denominator, 1.0))


def in_force(
    settings: ControllerSettings, plant: Plant, slowness: float, noise: float = 0.0
) -> SlowState:
    """A loop that is slower than what is asked for, under gains that are not learnt."""
    state, loop = at_rest(settings), slowed_loop(plant, [1.0], 0.7, slowness)
    gains = plant.gains(loop)
    state.law = Law(
        plant=plant,
        asked=plant.asked(0.7),
        quiet_gains=gains,
        quiet_noise=noise,
        fast_loop=loop,
        fast_gains=gains,
        fast_noise=noise,
    )
    copy_into(state.reference_filter.asked, state.law.asked)
    copy_into(state.reference_filter.loop, loop)
    copy_into(state.reference_filter.course, [3.0] * len(loop))
    state.supervisor.trusted, state.blend = True, 1.0
    return state


@pytest.mark.parametrize("slowness", [0.0, 1.0, 1.6])
def test_the_course_stays_that_of_the_load_where_the_drive_cannot_follow(slowness: float) -> None:
    """The output of the model is B/B(1) m, whatever input was applied."""
    plant = heavy()
    a, b = plant.a, plant.b
    supervision = replace(EXACT.supervision, warm_up_periods=10**6, revokes=False)
    settings = replace(EXACT, supervision=supervision)
    state = in_force(settings, plant, slowness)
    inputs, outputs, held_back, applied = [REST_V] * (len(b) - 1), [3.0] * 2, 0, REST_V
    for k in range(400):
        y = float(np.dot(b[1:], inputs) - np.dot(a[1:], outputs))
        outputs = [y, *outputs[:-1]]
        followed = applied == state.inputs[0]
        reference = 3.8 if (k // 60) % 2 else 3.0
        now = sample(y, applied=applied, followed=followed, reference=reference, adaptive=True)
        decided = slow_step(settings, MOTOR, state, now)
        course = np.array(state.reference_filter.course[: len(b)])
        assert np.dot(b, course) / sum(b) == pytest.approx(y, abs=1e-6)
        applied = max(decided, inputs[0] - SLOWEST_FALL_V)
        held_back += applied != decided
        inputs = [applied, *inputs[:-1]]
    assert held_back > 20


def mean_error_at_the_lower_limit(confidence: float) -> float:
    """Mean error of a noisy output whose rest is 5 V above the lowest V_c."""
    plant, slowness, reference = heavy(), 1.0, 0.011 * 205.0
    a, b = plant.a, plant.b
    supervision = replace(
        EXACT.supervision, warm_up_periods=10**6, revokes=False, confidence=confidence
    )
    settings = replace(EXACT, supervision=supervision)
    state = in_force(settings, plant, slowness, 8.0)
    noise = 8.0 / noise_gain(plant, slowed_loop(plant, [1.0], 0.7, slowness))
    random, errors = np.random.default_rng(5), []
    inputs, outputs = [REST_V] * (len(b) - 1), [3.0] * 2
    for _ in range(3000):
        y = float(np.dot(b[1:], inputs) - np.dot(a[1:], outputs))
        outputs = [y, *outputs[:-1]]
        seen = y + noise * random.normal()
        now = sample(seen, applied=inputs[0], reference=reference, adaptive=True)
        inputs = [slow_step(settings, MOTOR, state, now), *inputs[:-1]]
        assert 200.0 <= inputs[0] <= 400.0
        errors.append(y - reference)
    return float(np.mean(errors[300:]))


def test_noise_that_a_limit_cuts_off_moves_the_output_less() -> None:
    cut_off, remembered = (mean_error_at_the_lower_limit(each) for each in (0.0, 2.0))
    assert cut_off > 0.005
    assert abs(remembered) < 0.4 * cut_off


FIXED = replace(AT_REST, adaptive=False)


@pytest.mark.parametrize("followed", [True, False])
def test_an_error_counts_only_while_the_drive_follows(*, followed: bool) -> None:
    """The output stays although the set-point is 0.2 V away."""
    supervision = replace(EXACT.supervision, error_limit=0.1, response_distance=1.0)
    settings = replace(EXACT, supervision=supervision)
    state = at_rest(settings)
    for _ in range(60):
        applied = REST_V if followed else REST_V + 1.0
        asked = replace(AT_REST, reference=3.2, followed=followed, applied=applied, high=1e9)
        slow_step(settings, MOTOR, state, asked)
    assert state.watch.fallback == (Fallback.ERROR if followed else Fallback.NONE)


def test_by_hand_no_law_is_in_force_and_the_fixed_one_is_the_first_after_it() -> None:
    state = at_rest()
    state.adaptive, state.blend, state.handover_step = True, 1.0, 3.0
    before = list(state.inputs)
    assert slow_step(EXACT, MOTOR, state, replace(FIXED, manual=True, held=250.0)) == 250.0
    assert state.inputs == [250.0, 250.0, *before[1:-1]]
    assert not state.adaptive
    assert state.blend == 0.0
    assert math.isnan(state.handover_step)


@pytest.mark.parametrize(
    ("held_V", "unresponsive"), [(200.0, True), (400.0, True), (210.0, False), (390.0, False)]
)
def test_an_input_by_hand_at_a_limit_shows_a_load_that_does_not_answer(
    held_V: float, *, unresponsive: bool
) -> None:
    """One within the limits is the operator's own, and judged by the operator."""
    supervision = replace(EXACT.supervision, response_periods=20, response_distance=0.05)
    settings = replace(EXACT, supervision=supervision)
    state = at_rest(settings)
    for _ in range(400):
        slow_step(settings, MOTOR, state, replace(FIXED, manual=True, held=held_V))
    assert state.unresponsive is unresponsive


POLE = 0.7
BLEND = 4
JACKET = replace(
    EXACT.supervision, warm_up_periods=0, blend_periods=BLEND, ratio_min=0.5, ratio_max=4.0
)
SETTINGS = replace(EXACT, supervision=JACKET)
LEAD = reference_lead(SETTINGS, MOTOR)
UNTAUGHT = 0.2
"""Share of stand-in ticks from which a sample teaches nothing: the estimate stays."""

SAMPLE = replace(AT_REST, held_share=UNTAUGHT)
HEAVY = [0.011, 33.4, 234.0]
BATTERY = battery_load(0.25, 1.2, 0.3, 60.0, Charging(0.25, 1.0, 0.2, 58.0, 1.0))


def known(settings: ControllerSettings = SETTINGS) -> SlowState:
    """A slow half at rest that is sure of a motor with two disks."""
    state = SlowState(settings, MOTOR, 3.0, REST_V)
    regression = Regression(SETTINGS.learning, MOTOR)
    state.estimator.estimate.theta[:3] = regression.theta_of(*MOTOR.realise(HEAVY))
    state.estimator.estimate.diagonal[:] = [1e-6] * 3
    state.estimator.periods = 100
    state.reference_filter.course[:] = [3.0] * len(state.reference_filter.course)
    return state


def gains_of(values: list[float]) -> list[float]:
    plant = Plant(*discrete_model(SETTINGS, MOTOR, *MOTOR.realise(values), 1.0))
    return plant.gains(plant.asked(POLE))


FIXED_LAW, ADAPTIVE_LAW = gains_of([0.011, 21.7, 117.0]), gains_of(HEAVY)


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
        fixed = law(FIXED_LAW, inputs, outputs, led(references))
        other = law(ADAPTIVE_LAW, inputs, outputs, led(references))
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
    asked = law(ADAPTIVE_LAW, before, outputs, float(np.dot(loop, course) / sum(loop)))
    wanted = law(ADAPTIVE_LAW, before, outputs, led([3.0, 4.4]))
    assert wanted > 410.0
    assert asked == pytest.approx(400.0 if periods == BLEND else wanted, abs=1e-5)


@pytest.mark.parametrize("fallback", [Fallback.NONE, Fallback.ERROR])
def test_a_fallback_ends_the_adaptive_law(fallback: Fallback) -> None:
    state = known()
    slow_step(SETTINGS, MOTOR, state, SAMPLE)
    assert state.adaptive
    state.watch.fallback = fallback
    slow_step(SETTINGS, MOTOR, state, SAMPLE)
    assert state.adaptive is (fallback == Fallback.NONE)


def test_a_law_that_is_not_a_number_repeats_the_newest_input() -> None:
    state = SlowState(SETTINGS, MOTOR, 3.0, REST_V)
    state.inputs[:] = [290.0, *[280.0] * (len(state.inputs) - 1)]
    state.sent = 290.0
    asked = replace(SAMPLE, reference=math.nan, adaptive=False)
    assert slow_step(SETTINGS, MOTOR, state, asked) == 290.0


def charged(state: SlowState, terminal_V: float, **changes: object) -> float:
    """Let a battery be charged for one slow period; return the input."""
    input_V = (terminal_V + 10.0) / 0.25
    sample = replace(
        SAMPLE, output=10.0, output_filtered=[10.0], input_filtered=[input_V] * 2, reference=20.0,
        adaptive=False, **changes,  # type: ignore[arg-type]
    )  # fmt: skip
    return slow_step(SETTINGS, BATTERY, state, sample)


def test_the_current_of_a_battery_is_lowered_above_its_voltage_limit() -> None:
    state = SlowState(SETTINGS, BATTERY, 10.0, 240.0)
    charged(state, 58.4)
    assert state.charge.current_A == pytest.approx(10.0 - 0.05 * 0.4 / 0.2)
    assert state.reference == state.charge.current_A
    charged(state, 57.6)
    assert state.reference == pytest.approx(10.0)


def test_an_operator_leads_the_current_of_a_battery_by_hand() -> None:
    state = SlowState(SETTINGS, BATTERY, 10.0, 240.0)
    state.charge.ending_periods = 5
    assert charged(state, 58.4, manual=True, held=250.0) == 250.0
    assert (state.charge.current_A, state.charge.ending_periods) == (10.0, 0)
