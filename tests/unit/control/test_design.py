"""From a load model to gains: delays of the loop, and both designs on the real chain of samples."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import cont2discrete, dlsim, lfilter

from adaptdrive.control.design.pole_placement import (
    Plant,
    discrete_model,
    kept_factor,
    past_inputs,
    reference_lead,
)
from adaptdrive.control.loads.battery import battery_load
from adaptdrive.control.loads.discretise import held_model
from adaptdrive.control.settings import ControllerSettings
from tests.integration.closed_loop.bench import EXACT, MOTOR, PAPER, RATES, TICK_s
from tests.unit.control.systems import Array, System, distance, impulse_invariant, motor_system

SINGLE = replace(EXACT, rates=replace(RATES, samples=1))


def model(settings: ControllerSettings, system: System) -> tuple[list[float], list[float]]:
    return discrete_model(settings, MOTOR, system.numerator, system.denominator, 1.0)


def measured_means(system: System, voltages: Array, samples: int) -> Array:
    """The motor behind a lag of three poles at 2/3, seen through a mean of fast samples."""
    commands = np.repeat(voltages, RATES.ticks_per_period)
    delayed = np.concatenate([np.zeros(RATES.latency_ticks), commands])
    lag = np.poly([2.0 / 3.0] * 3)
    boost = lfilter([0.0, 0.0, 0.0, sum(lag)], lag, delayed)
    *fast, _ = cont2discrete(system.state_space(), TICK_s, "zoh")
    _, y, *_ = dlsim((*fast, TICK_s), boost)
    means = lfilter(np.full(samples, 1.0 / samples), 1.0, y[:, 0])
    return np.asarray(means[: len(commands) : RATES.ticks_per_period])


@pytest.mark.parametrize("disks", [1, 3])
@pytest.mark.parametrize("settings", [EXACT, SINGLE])
def test_the_exact_model_predicts_what_the_loop_measures(
    settings: ControllerSettings, disks: int
) -> None:
    system = motor_system(disks)
    voltages = np.random.default_rng(1).normal(scale=50.0, size=40)
    a, b = model(settings, system)
    seen = measured_means(system, voltages, settings.rates.samples)
    assert np.abs(lfilter(b, a, voltages) - seen).max() < 1e-3 * np.abs(seen).max()


def test_the_delay_counts_latency_lag_and_half_a_sample() -> None:
    system, tick_s = motor_system(), 1.0 / RATES.ticks_per_period
    for settings, delay, window in ((EXACT, 2 + 9 - 0.5, 60), (SINGLE, 2 + 9, 0)):
        whole = held_model(
            system.numerator, system.denominator, 1.0, delay * tick_s, window * tick_s
        )
        assert model(settings, system) == whole
    lead = pytest.approx((2 + 9) / 120)
    assert reference_lead(EXACT, MOTOR) == reference_lead(SINGLE, MOTOR) == lead
    assert reference_lead(PAPER, MOTOR) == 0.0  # the paper leaves it out


@pytest.mark.parametrize(
    ("zero", "kept"), [(0.9, True), (0.71, True), (0.69, False), (1.5, False), (-0.9, False)]
)
def test_a_zero_between_the_pole_and_one_is_cancelled(zero: float, kept: bool) -> None:
    for gain in (0.2, -0.2):
        b = [0.0, *(gain * np.poly([zero, 0.1])).tolist()]
        expected = [1.0, -zero] if kept else [1.0]
        assert kept_factor(b, 0.7) == pytest.approx(expected)


def test_the_papers_design_uses_the_papers_model() -> None:
    a, b = model(PAPER, motor_system(2))
    assert [*a, *b] == pytest.approx(impulse_invariant(0.011, 33.4, 234.0, 1.0), rel=1e-12)
    assert past_inputs(PAPER, MOTOR) == 2


@pytest.mark.parametrize("settings", [EXACT, SINGLE, PAPER])
@pytest.mark.parametrize("disks", [1, 2, 3])
def test_four_poles_lie_at_070_and_the_others_at_zero(
    settings: ControllerSettings, disks: int
) -> None:
    a, b = model(settings, motor_system(disks))
    plant = Plant(a, b)
    gains = plant.gains(plant.asked(0.7))
    taps = past_inputs(settings, MOTOR)
    loop = np.polyadd(
        np.convolve(a, [1.0, *gains[:taps]])[::-1], np.convolve(b, gains[taps:])[::-1]
    )[::-1]
    poles = np.roots(loop)
    assert distance(poles, [0.7] * 4 + [0.0] * (len(poles) - 4)) < 2e-3


def test_what_responds_at_once_needs_no_lead() -> None:
    assert reference_lead(EXACT, battery_load(0.25, 1.2, 0.4, 30.0)) == 0.0
    assert reference_lead(EXACT, MOTOR) > 0.0
