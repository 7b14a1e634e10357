"""One slow period of a battery: what its first current, and its voltage, may be."""

from __future__ import annotations

from dataclasses import replace

import pytest

from adaptdrive.control.charging import Charging
from adaptdrive.control.loads.battery import battery_load
from adaptdrive.control.slow_half import slow_step
from adaptdrive.control.slow_state import SlowSample, SlowState, new_slow_state
from tests.closed_loop.bench import AT_REST, EXACT

TURNS, SERIES_Ohm, END_A = 0.25, 1.2, 1.0
BATTERY = battery_load(TURNS, SERIES_Ohm, 0.3, 60.0, Charging(TURNS, 1.0, 0.2, 58.0, END_A))
JACKET = replace(EXACT.jacket, response_periods=10, response_distance=0.2)
SETTINGS = replace(EXACT, jacket=JACKET)
LOWEST_V, HIGHEST_V = 100.0, 400.0


def sample(output_A: float, reference_A: float, newest_V: float, oldest_V: float) -> SlowSample:
    """Return a sample of a battery; the second of the filtered inputs is not the terminal's."""
    return replace(
        AT_REST, output=output_A, reference=reference_A, adaptive=False, applied=newest_V,
        output_filtered=[output_A], input_filtered=[newest_V, oldest_V],
        low=LOWEST_V, high=HIGHEST_V,
    )  # fmt: skip


def below_the_emf(newest_V: float) -> SlowState:
    """Return a slow half that has just raised its input to `newest_V`; no current flows."""
    state = new_slow_state(SETTINGS, BATTERY, 0.0, newest_V)
    state.inputs[1:] = [newest_V - 30.0] * (len(state.inputs) - 1)
    state.charge.current_A = 100.0  # so that the voltage limit lowers no set-point here
    return state


@pytest.mark.parametrize(
    ("reference_A", "current_A"), [(8.0, 8.0), (5.0, 5.0), (0.5, END_A), (END_A, END_A)]
)
def test_below_its_emf_a_battery_is_raised_by_what_the_set_point_needs_at_once(
    reference_A: float, current_A: float
) -> None:
    """N2 ΔV_c over R_s is the current that flows at once, if the EMF is reached."""
    state, before_V = below_the_emf(200.0), 200.0
    raised = []
    for _ in range(12):
        asked = sample(0.0, reference_A, before_V, 0.0)
        now_V = slow_step(SETTINGS, BATTERY, state, asked)
        raised.append(TURNS * (now_V - before_V) / SERIES_Ohm)
        before_V = now_V
    assert max(raised) == pytest.approx(current_A)
    assert before_V <= HIGHEST_V


def test_a_battery_is_never_raised_above_the_highest_input() -> None:
    state = below_the_emf(395.0)
    assert slow_step(SETTINGS, BATTERY, state, sample(0.0, 20.0, 395.0, 0.0)) == HIGHEST_V


@pytest.mark.parametrize(("high_V", "unresponsive"), [(HIGHEST_V, False), (250.0, True)])
def test_below_its_own_voltage_a_battery_need_not_answer(
    high_V: float, *, unresponsive: bool
) -> None:
    """At the highest input it must: that is above the voltage of every battery it is made for."""
    state = new_slow_state(SETTINGS, BATTERY, 0.0, 200.0)
    for number in range(60):
        asked = sample(0.0, 20.0, 250.0 if number else 200.0, 0.0)
        asked = replace(asked, followed=number == 0, high=high_V)
        slow_step(SETTINGS, BATTERY, state, asked)
    assert state.unresponsive is unresponsive
