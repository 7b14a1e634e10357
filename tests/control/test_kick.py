"""V_c as the fast half sends it: kicks after a change, the operator, and the first window."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from adaptdrive.control import fast_half as fast
from adaptdrive.control.rounding import rounding_error
from adaptdrive.control.signals import Measurement
from tests.closed_loop.bench import EXACT, MOTOR, STAGE, TICKS, TICK_s

KICKING = replace(STAGE, kick_ticks=3, kick_first=1.5, kick_second=-0.5)


def state(voltage_V: float) -> fast.FastState:
    return fast.FastState(tick=0, boost_reference_V=voltage_V, error_sum=0.0)


def kicked(of: fast.FastState, ticks: int, stride: int = 1) -> list[float]:
    """V_c at each reading of so many ticks."""
    sent = []
    for _ in range(0, ticks, stride):
        of.tick += stride
        sent.append(fast.kick(of, KICKING, of.boost_reference_V, of.tick))
    return sent


def test_a_change_of_V_c_is_exaggerated_in_two_parts_and_then_held() -> None:
    of = state(280.0)
    assert kicked(of, 5) == [280.0] * 5
    of.boost_reference_V = 290.0
    assert kicked(of, 10) == [305.0] * 3 + [285.0] * 3 + [290.0] * 4
    of.boost_reference_V = 286.0
    assert kicked(of, 4) == [280.0] * 3 + [288.0]
    of.boost_reference_V = 288.0
    assert kicked(of, 2) == [291.0] * 2


def test_a_kick_of_a_polled_drive_lasts_as_many_half_cycles() -> None:
    of = state(280.0)
    kicked(of, 9, stride=3)
    of.boost_reference_V = 290.0
    assert kicked(of, 12, stride=3) == [305.0, 285.0, 290.0, 290.0]


def test_a_kick_stays_within_the_limits_of_the_drive_and_of_its_power() -> None:
    of = state(280.0)
    kicked(of, 1)
    of.boost_reference_V = 395.0
    assert kicked(of, 1) == [400.0]
    of.boost_reference_V = 205.0
    assert kicked(of, 1) == [200.0]
    of.boost_reference_V, of.ceiling_V = 300.0, 310.0
    assert kicked(of, 1) == [310.0]


def test_what_the_operator_sets_is_not_kicked() -> None:
    of = state(280.0)
    kicked(of, 4)
    fast.set_by_hand(of, KICKING, 300.0)
    assert kicked(of, 8) == [300.0] * 8
    of.by_hand = False
    assert kicked(of, 2) == [300.0] * 2


@pytest.mark.parametrize(("asked_V", "set_V"), [(100.0, 200.0), (320.0, 320.0), (900.0, 400.0)])
def test_the_operator_sets_V_c_within_the_limits_of_the_drive(asked_V: float, set_V: float) -> None:
    of = state(280.0)
    fast.set_by_hand(of, STAGE, asked_V)
    assert (of.boost_reference_V, of.by_hand) == (set_V, True)
    fast.set_by_hand(of, STAGE, math.nan)
    assert of.boost_reference_V == set_V


@pytest.mark.parametrize("samples", [1, 7, 60])
def test_the_window_is_the_last_samples_of_a_period_with_its_end(samples: int) -> None:
    settings = replace(EXACT, rates=replace(EXACT.rates, samples=samples, clip=0.0))
    of, bank = state(280.0), fast.new_filter_bank(MOTOR, TICK_s, 10.0, 3.0, 280.0)
    for tick in range(1, 2 * TICKS + 1):
        measurement = Measurement(tick, TICK_s, 280.0, 120.0, 430.0, float(tick))
        ends = fast.take_in(settings, MOTOR, of, bank, measurement)
        assert ends is (tick % TICKS == 0)
        if ends:
            assert bank.count == samples
            assert fast.take_means(bank)[0] == pytest.approx(tick - (samples - 1) / 2)


def test_the_rounding_error_counts_the_changes_of_each_period_anew() -> None:
    bank = fast.new_filter_bank(MOTOR, TICK_s, 10.0, 3.0, 280.0)
    settings = replace(EXACT, learning=replace(EXACT.learning, resolution=0.01))
    shares = []
    for changes in (30, 60, 0):
        bank.grid.changes = changes
        shares.append(changes / TICKS)
        expected = rounding_error(0.01, sum(shares) / len(shares))
        assert fast.take_rounding(settings, bank) == pytest.approx((0.01, expected))
        assert bank.grid.changes == 0


def test_a_new_screen_is_as_wide_as_the_larger_of_present_and_expected_output() -> None:
    for output, largest in ((3.5, 3.5), (-3.5, 3.5), (1.0, 0.011 * 280.0)):
        screen = fast.new_filter_bank(MOTOR, TICK_s, 10.0, output, 280.0).screen
        assert screen.slope == 0.0
        at_rest = fast.new_filter_bank(MOTOR, TICK_s, 10.0, largest, 0.0).screen
        assert replace(screen, level=largest) == replace(at_rest, level=largest)
