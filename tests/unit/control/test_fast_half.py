"""The fast half: filters at rest and in the window, books of a period, limits of the stage."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lsim

from adaptdrive.control import fast
from adaptdrive.control.signals import Measurement
from tests.integration.closed_loop.bench import EXACT, MOTOR, RATES, STAGE, TICKS, TICK_s
from tests.unit.control.systems import Array


def bank(output: float = 3.0, voltage: float = 280.0) -> fast.FilterBank:
    return fast.new_filter_bank(MOTOR, TICK_s, 10.0, output, voltage)


def state(**changes: float) -> fast.FastState:
    made = fast.FastState(tick=0, boost_reference_V=300.0, error_sum=9.0 * 300.0**2)
    for name, value in changes.items():
        setattr(made, name, value)
    return made


def filtered_line(corners: Array, time_s: NDArray[Any], order: int) -> Array:
    """λ^i of a broken line, by scipy, from rest."""
    system = ([1.0], np.asarray(np.poly([-0.1] * order)) * 10.0**order)
    _, response, _ = lsim(system, corners - corners[0], time_s)
    return np.asarray(corners[0] + response)


@pytest.mark.parametrize("missed", [1, 2, 7])
def test_missed_ticks_are_bridged_by_a_straight_line(missed: int) -> None:
    random = np.random.default_rng(1)
    outputs = np.asarray(3.0 + 0.1 * random.normal(size=60), np.float64)
    time_s = np.arange(60) * missed * TICK_s
    voltages = np.asarray(280.0 + 5.0 * random.normal(size=60), np.float64)
    filters = bank(float(outputs[0]), float(voltages[0]))
    for y, voltage in zip(outputs[1:], voltages[1:], strict=True):
        fast.filter_sample(filters, float(y), float(voltage), missed)
    for order in (1, 2):
        expected = filtered_line(outputs, time_s, order)[-1]
        assert filters.outputs[order] == pytest.approx(expected, abs=1e-12)
        expected = filtered_line(voltages, time_s, order)[-1]
        assert filters.inputs[order] == pytest.approx(expected, abs=1e-10)


def regulate(
    books: fast.FastState,
    voltage: float = 300.0,
    line: float = 120.0,
    power: float = 500.0,
    reference: float = 300.0,
) -> float:
    return fast.regulate_voltage(books, STAGE, reference, voltage, line, power, TICK_s)


def test_a_weak_line_is_divided_by_only_down_to_its_lowest_voltage() -> None:
    assert regulate(state(), line=10.0, power=50.0) == regulate(state(), line=60.0, power=50.0)


@pytest.mark.parametrize(("lowest_S", "safe_S"), [(-0.1, 0.0), (0.02, 0.02)])
def test_an_absurd_measurement_gives_the_least_current(lowest_S: float, safe_S: float) -> None:
    """And it leaves nothing in the sum of errors."""
    books, stage = state(), replace(STAGE, current_scale_min_S=lowest_S)
    assert fast.regulate_voltage(books, stage, 300.0, 300.0, 120.0, math.inf, TICK_s) == safe_S
    assert books.error_sum == state().error_sum


def measured(tick: int, output: float = 3.0, power_W: float = 500.0) -> Measurement:
    return Measurement(tick, TICK_s, 300.0, 120.0, power_W, output)


def test_the_command_carries_the_load_and_names_V_c() -> None:
    assert fast.drive(state(), STAGE, measured(1)) == pytest.approx((500.0 / 120.0**2, 300.0))


def test_a_drive_with_its_own_voltage_loop_is_told_V_c_alone() -> None:
    holding = replace(STAGE, holds_voltage=True)
    assert fast.drive(state(), holding, measured(1)) == (0.0, 300.0)
    kicking, books = replace(holding, kick_ticks=1, kick_first=0.5), state()
    fast.drive(books, kicking, measured(1))
    books.boost_reference_V = 310.0
    assert fast.drive(books, kicking, measured(2))[1] == 315.0
    held_back = fast.drive(state(), holding, measured(1, power_W=1.21 * STAGE.load_power_max_W))
    assert held_back == pytest.approx((0.0, 300.0 / 1.1))


@pytest.mark.parametrize(("ticks", "bridged"), [(1, 1), (5, 5), (120, 120), (1000, 120)])
def test_a_gap_is_bridged_for_as_long_as_a_slow_period_at_most(ticks: int, bridged: int) -> None:
    filters, books, alone = bank(), state(), bank()
    fast.take_in(EXACT, MOTOR, books, filters, measured(ticks, output=3.4))
    fast.filter_sample(alone, 3.4, 300.0, bridged)
    assert filters.outputs == pytest.approx(alone.outputs, rel=1e-12)
    assert filters.inputs == pytest.approx(alone.inputs, rel=1e-12)


def test_each_tick_is_in_the_books_of_its_period() -> None:
    filters, books = bank(), state()
    for tick in range(1, 121):
        fresh = replace(measured(tick), boost_voltage_V=300.0 + tick, fresh=tick % 3 != 0)
        ended = fast.take_in(EXACT, MOTOR, books, filters, fresh)
        assert ended is (tick == 120)
    applied_V, *rest = fast.close_period(books, EXACT)
    assert applied_V == pytest.approx(360.5)
    assert rest == [True, 40]
    fast.count_tick(books, 280.0, fresh=True)
    assert fast.close_period(books, EXACT) == (280.0, True, 0)
    assert math.isnan(fast.close_period(books, EXACT)[0])


@pytest.mark.parametrize("clip", [0.0, 0.5, 6.0])
def test_a_spike_reaches_the_filters_only_without_a_screen(clip: float) -> None:
    settings = replace(EXACT, rates=replace(RATES, clip=clip))
    filters, books = bank(), state()
    for tick in range(1, 61):
        fast.take_in(settings, MOTOR, books, filters, measured(tick))
    widest = 3.0 + clip * filters.outlier_filter.deviation
    fast.take_in(settings, MOTOR, books, filters, measured(61, output=30.0))
    assert filters.outputs[0] == pytest.approx(widest if clip else 30.0, abs=1e-12)


def test_a_tick_that_comes_twice_moves_the_filters_once() -> None:
    filters, books = bank(), state()
    fast.take_in(EXACT, MOTOR, books, filters, measured(5, output=3.1))
    once = [*filters.outputs, *filters.inputs]
    fast.take_in(EXACT, MOTOR, books, filters, measured(5, output=3.5))
    assert [*filters.outputs, *filters.inputs] == once


@pytest.mark.parametrize(("voltage_V", "error"), [(290.0, 5900.0), (300.0, 0.0), (310.0, -6100.0)])
def test_the_sum_of_errors_grows_by_the_difference_of_the_squares(
    voltage_V: float, error: float
) -> None:
    books = state(error_sum=9.0 * voltage_V**2)
    before = books.error_sum
    regulate(books, voltage_V)
    assert books.limit == 0
    assert books.error_sum - before == pytest.approx(error)


@pytest.mark.parametrize(("power_W", "limit"), [(1e5, 1), (-1e5, -1)])
@pytest.mark.parametrize("voltage_V", [290.0, 310.0])
def test_at_a_limit_the_sum_of_errors_goes_away_from_it_only(
    power_W: float, limit: int, voltage_V: float
) -> None:
    books = state()
    regulate(books, voltage_V, power=power_W)
    error = 300.0**2 - voltage_V**2
    assert books.limit == limit
    assert books.error_sum - state().error_sum == (error if error * limit < 0.0 else 0.0)


@pytest.mark.parametrize(("highest_V", "ceiling_V"), [(250.0, 250.0), (150.0, 200.0)])
def test_a_load_holds_V_c_below_what_it_bears(highest_V: float, ceiling_V: float) -> None:
    books = state()
    assert fast.hold_back(books, STAGE, 300.0, 500.0, highest_V) == ceiling_V
    risen_V = fast.hold_back(books, STAGE, 300.0, 500.0, highest_V + 60.0)
    assert ceiling_V < risen_V < ceiling_V + 1.0


def test_too_much_power_holds_the_voltage_back_and_lets_it_rise_slowly() -> None:
    books = state(boost_reference_V=400.0)
    held = fast.hold_back(books, STAGE, 390.0, 1.21 * STAGE.load_power_max_W)
    assert held == pytest.approx(390.0 / 1.1)
    following = [fast.hold_back(books, STAGE, 350.0, 1000.0) for _ in range(200)]
    assert 0.0 < following[0] - held < 1.0
    assert following == sorted(following)
    assert following[-1] == 400.0
    at_just_its_power = state(boost_reference_V=400.0, ceiling_V=300.0)
    assert fast.hold_back(at_just_its_power, STAGE, 310.0, STAGE.load_power_max_W) > 300.0


@pytest.mark.parametrize("power_W", [2.0 * STAGE.load_power_max_W, math.inf])
def test_too_much_power_at_a_voltage_that_is_no_number_leaves_the_lowest_V_c(
    power_W: float,
) -> None:
    books = state(boost_reference_V=400.0)
    assert fast.hold_back(books, STAGE, math.nan, power_W) == STAGE.boost_reference_min_V
    assert fast.hold_back(books, STAGE, 300.0, 1000.0) < STAGE.boost_reference_min_V + 1.0


@pytest.mark.parametrize(("limited", "followed"), [(0, True), (12, True), (13, False)])
def test_a_tenth_of_a_period_at_a_limit_is_still_followed(limited: int, followed: bool) -> None:
    books = state()
    for n in range(120):
        books.limit = -1 if n < limited else 0
        fast.count_tick(books, 300.0, fresh=True)
    assert fast.close_period(books, EXACT)[1] is followed


KICKING = replace(STAGE, kick_ticks=3, kick_first=1.5, kick_second=-0.5)


def moving(voltage_V: float) -> fast.FastState:
    return fast.FastState(tick=0, boost_reference_V=voltage_V, error_sum=0.0)


def kicked(of: fast.FastState, ticks: int, stride: int = 1) -> list[float]:
    """V_c at each reading of so many ticks."""
    sent = []
    for _ in range(0, ticks, stride):
        of.tick += stride
        sent.append(fast.kick(of, KICKING, of.boost_reference_V, of.tick))
    return sent


def test_a_change_of_V_c_is_exaggerated_in_two_parts_and_then_held() -> None:
    of = moving(280.0)
    assert kicked(of, 5) == [280.0] * 5
    of.boost_reference_V = 290.0
    assert kicked(of, 10) == [305.0] * 3 + [285.0] * 3 + [290.0] * 4
    of.boost_reference_V = 286.0
    assert kicked(of, 4) == [280.0] * 3 + [288.0]
    of.boost_reference_V = 288.0
    assert kicked(of, 2) == [291.0] * 2
    polled = moving(280.0)
    kicked(polled, 9, stride=3)  # as many half-cycles, in fewer readings
    polled.boost_reference_V = 290.0
    assert kicked(polled, 12, stride=3) == [305.0, 285.0, 290.0, 290.0]


def test_a_kick_stays_within_the_limits_of_the_drive_and_of_its_power() -> None:
    of = moving(280.0)
    kicked(of, 1)
    of.boost_reference_V = 395.0
    assert kicked(of, 1) == [400.0]
    of.boost_reference_V = 205.0
    assert kicked(of, 1) == [200.0]
    of.boost_reference_V, of.ceiling_V = 300.0, 310.0
    assert kicked(of, 1) == [310.0]


@pytest.mark.parametrize(("asked_V", "set_V"), [(100.0, 200.0), (320.0, 320.0), (900.0, 400.0)])
def test_what_the_operator_sets_is_limited_and_not_kicked(asked_V: float, set_V: float) -> None:
    of = moving(280.0)
    kicked(of, 4)
    fast.set_by_hand(of, KICKING, asked_V)
    assert (of.boost_reference_V, of.by_hand) == (set_V, True)
    fast.set_by_hand(of, KICKING, math.nan)
    assert kicked(of, 8) == [set_V] * 8
    of.by_hand = False
    assert kicked(of, 2) == [set_V] * 2


@pytest.mark.parametrize("samples", [1, 7, 60])
def test_the_window_is_the_last_samples_of_a_period_with_its_end(samples: int) -> None:
    settings = replace(EXACT, rates=replace(EXACT.rates, samples=samples, clip=0.0))
    of, bank = moving(280.0), fast.new_filter_bank(MOTOR, TICK_s, 10.0, 3.0, 280.0)
    for tick in range(1, 2 * TICKS + 1):
        measurement = Measurement(tick, TICK_s, 280.0, 120.0, 430.0, float(tick))
        ends = fast.take_in(settings, MOTOR, of, bank, measurement)
        assert ends is (tick % TICKS == 0)
        if ends:
            assert bank.count == samples
            assert fast.take_means(bank)[0] == pytest.approx(tick - (samples - 1) / 2)
