"""The voltage loop against the boost stage's own equation, and on the simulated stage."""

import math

import numpy as np
import pytest

from adaptdrive.control.fast import (
    INTEGRAL,
    LAG_TICKS,
    PROPORTIONAL,
    advance_sum,
    current_scale,
    initial_sum,
)
from adaptdrive_sim.plants.boost import Boost, BoostParameters
from tests.unit.control.systems import Array, distance, matrix_of

TICK_s = 1.0 / 120.0
FARAD = 1e-3
LINE_V = 120.0
SCALE_MAX_S = 0.15


def stage(x: float, scale_S: float, load_W: float, line_V: float = LINE_V) -> float:
    """x[n+1] of x = v²: what one half cycle adds and takes."""
    return x + 2.0 * TICK_s / FARAD * (scale_S * line_V**2 - load_W)


def loop_matrix(line_V: float, measured_V: float) -> Array:
    """Transition matrix of (x, latched k, S), in steps of a volt squared around a rest."""
    rest, load_W = 300.0**2, 500.0
    rest_k = load_W / line_V**2

    def step(z: Array) -> Array:
        x, latched, error_sum = rest + z[0], rest_k + z[1], initial_sum(300.0) + z[2]
        k = current_scale(error_sum, math.sqrt(x), load_W, measured_V, TICK_s, FARAD)
        following = advance_sum(error_sum, 300.0, math.sqrt(x), 0)
        moved = stage(x, latched, load_W, line_V)
        return np.array([moved - rest, k - rest_k, following - initial_sum(300.0)])

    return matrix_of(step, 3)


@pytest.mark.parametrize("line_V", [108.0, 120.0, 132.0])
def test_three_poles_lie_at_two_thirds_on_any_line_that_is_measured(line_V: float) -> None:
    matrix = loop_matrix(line_V, line_V)
    assert np.poly(matrix) == pytest.approx(np.poly([2.0 / 3.0] * 3), abs=1e-8)
    assert distance(np.linalg.eigvals(matrix), [2.0 / 3.0] * 3) < 0.01


def test_the_lag_is_the_mean_delay_of_the_step_response() -> None:
    x, latched, error_sum, missing = 0.0, 0.0, 0.0, 0.0
    for _ in range(300):
        missing += 1.0 - x
        wanted = INTEGRAL * error_sum - PROPORTIONAL * x
        error_sum += 1.0 - x
        x, latched = x + latched, wanted
    assert missing == pytest.approx(LAG_TICKS)


class MotorLikeStage:
    """The simulated boost stage with the load current of a motor that turns at 150 rad/s."""

    conductance_S, offset_A = 0.25**2 / 4.0, 0.25 * 45.0 / 4.0

    def __init__(self, voltage_V: float) -> None:
        self.boost = Boost(BoostParameters(FARAD), voltage_V)
        load_W = voltage_V * (self.conductance_S * voltage_V - self.offset_A)
        self.boost.settle(voltage_V, load_W)
        self.latched_S = load_W / LINE_V**2

    def step(self, scale_S: float, line_V: float = LINE_V) -> None:
        boost = self.boost
        boost.advance(self.latched_S, line_V, (self.conductance_S, self.offset_A), TICK_s)
        self.latched_S = scale_S


def follow(
    plant: MotorLikeStage, error_sum: float, reference_V: float, ticks: int, line_V: float = LINE_V
) -> tuple[list[float], float]:
    """Voltages under the limited loop, and the sum that is left."""
    voltages = []
    for _ in range(ticks):
        boost = plant.boost
        v, p = boost.voltage_V, boost.mean_load_W
        wanted = current_scale(error_sum, v, p, line_V, TICK_s, FARAD)
        scale = min(max(wanted, 0.0), SCALE_MAX_S)
        limit = (wanted > scale) - (wanted < scale)
        error_sum = advance_sum(error_sum, reference_V, v, limit)
        plant.step(scale, line_V)
        voltages.append(boost.voltage_V)
    return voltages, error_sum


def test_a_step_of_the_reference_settles_in_016_s_without_overshoot() -> None:
    x, latched, error_sum, voltages = 300.0**2, 500.0 / LINE_V**2, initial_sum(300.0), []
    for _ in range(60):
        k = current_scale(error_sum, math.sqrt(x), 500.0, LINE_V, TICK_s, FARAD)
        error_sum = advance_sum(error_sum, 350.0, math.sqrt(x), 0)
        x, latched = stage(x, latched, 500.0), k
        voltages.append(math.sqrt(x))
    assert max(voltages) < 350.0 + 1e-6
    assert voltages[round(0.16 / TICK_s)] > 300.0 + 0.97 * 50.0
    assert voltages[-1] == pytest.approx(350.0, abs=0.01)


def test_with_the_proportional_part_on_the_error_it_would_overshoot_by_16_v() -> None:
    x, latched, error_sum, peak = 300.0**2, 0.0, 0.0, 0.0
    for _ in range(60):
        error = 350.0**2 - x
        x, latched = x + latched, INTEGRAL * error_sum + PROPORTIONAL * error
        error_sum += error
        peak = max(peak, x)
    assert math.sqrt(peak) - 350.0 == pytest.approx(16.0, abs=1.0)


def dip_V(*, feed_forward: bool, seen_at_once: bool, reference_V: float = 350.0) -> float:
    """How far the voltage dips when 500 W more are drawn from half cycle 5 on."""
    x, latched, error_sum, lowest = reference_V**2, 0.0, initial_sum(reference_V), reference_V
    for n in range(60):
        load_W = 500.0 if n >= 5 else 0.0
        seen_W = 500.0 if n > 5 or (n == 5 and seen_at_once) else 0.0
        v = math.sqrt(x)
        fed = seen_W if feed_forward else 0.0
        k = current_scale(error_sum, v, fed, LINE_V, TICK_s, FARAD)
        error_sum = advance_sum(error_sum, reference_V, v, 0)
        x, latched = stage(x, latched, load_W), k
        lowest = min(lowest, math.sqrt(x))
    return reference_V - lowest


def test_the_dip_under_a_load_step_depends_on_how_soon_its_power_is_known() -> None:
    assert dip_V(feed_forward=True, seen_at_once=True) == pytest.approx(12.0, abs=0.5)
    assert dip_V(feed_forward=True, seen_at_once=False) == pytest.approx(24.7, abs=0.5)
    assert dip_V(feed_forward=False, seen_at_once=False) == pytest.approx(37.0, abs=0.5)


def test_a_long_sag_does_not_wind_up_the_sum() -> None:
    plant = MotorLikeStage(380.0)
    settled, error_sum = follow(plant, initial_sum(380.0), 380.0, 60)
    sagged, error_sum = follow(plant, error_sum, 380.0, 1200, line_V=40.0)
    assert settled[-1] == pytest.approx(380.0, abs=0.1)
    assert sagged[-1] < 330.0
    recovered, _ = follow(plant, error_sum, 380.0, 120)
    assert max(recovered) < 405.0
    assert recovered[-1] == pytest.approx(380.0, abs=0.1)
