"""The charge among the parameters: a battery whose EMF rises while it is learnt."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import cont2discrete

from adaptdrive.control import estimator as est
from adaptdrive.control import fast_half as fast
from adaptdrive.control import regression as reg
from adaptdrive.control.loads.battery import battery_load
from adaptdrive.control.settings import Learning
from tests.closed_loop.bench import SCALED_LEARNING, TICK_s
from tests.control.systems import Array

TURNS, SERIES_OHM, RELAXATION_OHM, RELAXATION_S = 0.25, 1.2, 0.4, 30.0
RISE_V_PER_AS = 8.0 / 36000.0
BATTERY = battery_load(TURNS, SERIES_OHM, RELAXATION_OHM, RELAXATION_S)
TRUTH = BATTERY.physical(list(BATTERY.numerator), list(BATTERY.denominator))
TICKS, SECONDS = 120, 400
LEARNING = replace(
    SCALED_LEARNING,
    tau_lambda_s=20.0,
    output_scale=47.0,
    input_scale=300.0,
    initial_covariance=1e8,
    bias=True,
    charge=True,
)


def simulated() -> tuple[Array, Array]:
    """Boost voltage and current at the ticks: a mean of 12 A, and a ripple of some percent.

    State: voltage of the relaxation element, and charge; E = 72 V + rise · charge.
    """
    g = 1.0 / SERIES_OHM
    c = RELAXATION_S / RELAXATION_OHM
    a = np.array(
        [[-(g + 1.0 / RELAXATION_OHM) / c, -g * RISE_V_PER_AS / c], [-g, -g * RISE_V_PER_AS]]
    )
    b = np.array([[g / c], [g]])
    a, b, *_ = cont2discrete((a, b, np.zeros((1, 2)), 0.0), TICK_s)
    ticks = np.arange(SECONDS * TICKS)
    voltages = 364.8 + 0.25 * ticks * TICK_s * 0.02 + 2.0 * np.sign(np.sin(ticks * TICK_s / 7.0))
    state, currents = np.array([4.8, 0.0]), np.empty(ticks.size)
    for n, voltage in enumerate(voltages):
        driving = TURNS * voltage - 72.0
        currents[n] = g * (driving - state[0] - RISE_V_PER_AS * state[1])
        state = a @ state + b[:, 0] * driving
    return voltages, currents


def learnt(learning: Learning) -> est.EstimatorState:
    """An estimate from the tick-wise samples, which start at rest on the first ones."""
    voltages, currents = simulated()
    state = est.new_estimator(learning, BATTERY, 2)
    bank = fast.new_filter_bank(BATTERY, TICK_s, 20.0, float(currents[0]), float(voltages[0]))
    for n in range(1, voltages.size):
        fast.filter_sample(bank, float(currents[n]), float(voltages[n]), 1)
        if n % TICKS == 0:
            fast.accumulate(bank)
            y, *rest = fast.take_means(bank)
            state.charge = float(np.sum(currents[:n])) * TICK_s / 20.0 / learning.output_scale
            reg.fill_filtered_regressor(
                state.sample.regressor, learning, BATTERY, rest[:1], rest[1:]
            )
            reg.fill_charge(state.sample.regressor, learning, state.charge)
            est.learn(state, learning, BATTERY, y, usable=True)
    return state


def test_the_rise_of_an_emf_is_no_dynamics() -> None:
    state = learnt(LEARNING)
    found = BATTERY.physical(*reg.filtered_model(state.estimate.theta, LEARNING, BATTERY))
    assert found == pytest.approx(TRUTH, rel=0.02)
    ignorant = replace(LEARNING, charge=False)
    mistaken = BATTERY.physical(
        *reg.filtered_model(learnt(ignorant).estimate.theta, ignorant, BATTERY)
    )
    assert abs(mistaken[1] / TRUTH[1] - 1.0) > 0.2


def test_the_offset_is_the_emf_of_now() -> None:
    state = learnt(LEARNING)
    _, currents = simulated()
    emf_V = 72.0 + RISE_V_PER_AS * float(np.sum(currents)) * TICK_s
    offset_V = reg.input_offset(state.estimate.theta, LEARNING, BATTERY, state.charge)
    assert offset_V == pytest.approx(-emf_V / TURNS, rel=2e-3)
    assert emf_V - 72.0 > 0.8
