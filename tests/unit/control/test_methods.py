"""The estimation methods: what is the λ-method's own, direct least squares, and a third one."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.signal import cont2discrete

from adaptdrive.control import fast
from adaptdrive.control.estimation.estimator import LambdaEstimator
from adaptdrive.control.loads.battery import battery_load
from adaptdrive.control.settings import ControllerSettings, EstimatorSettings
from adaptdrive.control.signals import Mode
from adaptdrive.control.supervision.redesign import judged_model
from adaptdrive.control.supervision.state import SlowState
from adaptdrive.control.supervision.supervisor import Verdict
from adaptdrive.control.vectors import shift_in
from tests.integration.closed_loop.bench import (
    AT_REST,
    EXACT,
    MOTOR,
    PAPER,
    SCALED_LEARNING,
    Bench,
    TICK_s,
    order,
    square_wave,
)
from tests.unit.control.systems import Array, held_polynomials, motor_system


def innovations(method: str) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    bench = Bench(replace(EXACT, learning=replace(EXACT.learning, method=method)))
    bench.motor.disks = 2
    for second in range(480):
        bench.run(1.0, order(square_wave(second), Mode.FIXED))
    return np.array([decision.innovation for decision in bench.decisions])


MEASURED = replace(
    AT_REST,
    output=3.3,
    output_filtered=[3.2, 3.1],
    input_filtered=[300.0, 290.0, 285.0],
)
TAU_s = SCALED_LEARNING.tau_lambda_s


def test_the_regressor_of_a_motor_is_equation_29_and_the_initial_state_since_the_origin() -> None:
    """The sample ends 60 s after the start, 20 s after the origin."""
    estimator = LambdaEstimator(replace(SCALED_LEARNING, initial_state=True, bias=True), MOTOR, 2)
    estimator.sample.time_s, estimator.estimate.origin_s = 59.0, 40.0
    estimator.take_sample(MEASURED, [3.0] * 3, [280.0] * 3, usable=True)
    ratio = 20.0 / TAU_s
    expected = [-3.2 / 3.0, -3.1 / 3.0, 285.0 / 280.0]
    expected += [math.exp(-ratio), ratio * math.exp(-ratio), 1.0]
    assert estimator.sample.regressor == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("options", "share"),
    [
        ({}, 0.1),
        ({"charge": True}, 1.0),
        ({"drifts": True}, 1.0),
        ({"start_at_nominal": False}, 1.0),
        ({"initial_covariance": 1e7}, math.sqrt(0.1)),
        ({"initial_covariance": 1e4}, 1.0),
    ],
)
def test_an_offset_that_rests_is_expected_within_a_tenth_of_the_input(
    options: dict[str, Any], share: float
) -> None:
    """P[0] is a deviation of 1 at the least σ: an EMF or the drift of an inflow may be as large."""
    usual = {"alert": True, "bias": True, "initial_covariance": 1e8}
    learning = replace(SCALED_LEARNING, **(usual | options))
    variance = share**2 * learning.initial_covariance
    assert LambdaEstimator(learning, MOTOR, 2).estimate.diagonal[-1] == pytest.approx(
        variance, rel=1e-12
    )


DIRECT = replace(
    SCALED_LEARNING, method="rls", start_at_nominal=False, gate=0.0, bias=True,
    initial_covariance=1e6,
)  # fmt: skip
SETTINGS = replace(PAPER, learning=DIRECT)
OFFSET_V = 25.0


@cache
def held(disks: int) -> tuple[Array, Array]:
    return held_polynomials(motor_system(disks), 1.0)


def learnt(
    settings: ControllerSettings, disks: list[int], noise: float = 0.0
) -> tuple[SlowState, Array]:
    """An estimator that has seen a motor with so many disks in each period; its innovations."""
    random = np.random.default_rng(5)
    state = SlowState(settings, MOTOR, 3.0, 280.0)
    outputs, inputs, innovations = [3.0, 3.0], [280.0, 280.0], []
    for count in disks:
        a, b = held(count)
        y = float(-np.dot(a[1:], outputs) + np.dot(b[1:], np.add(inputs, OFFSET_V)))
        outputs = [y, outputs[0]]
        sample = replace(AT_REST, output=y + noise * random.normal())
        state.estimator.take_sample(sample, state.outputs, state.inputs, usable=True)
        innovations.append(state.estimator.innovation)
        shift_in(state.outputs, sample.output)
        inputs = [280.0 + 20.0 * random.normal(), inputs[0]]
        shift_in(state.inputs, inputs[0])
    return state, np.array(innovations)


def test_the_discrete_model_and_the_offset_of_the_input_are_found() -> None:
    state, _ = learnt(SETTINGS, [2] * 600)
    a, b, verdict = judged_model(SETTINGS, MOTOR, state, 1.0)
    bottom, top = held(2)
    assert a == pytest.approx(bottom, rel=1e-5)
    assert b[:3] == pytest.approx(top, abs=1e-8)
    assert b[3:] == pytest.approx([0.0] * len(b[3:]), abs=1e-8)
    assert verdict == Verdict.TRUSTED
    assert state.values == pytest.approx([0.011, 33.4, 234.0], rel=1e-3)
    assert state.estimator.input_offset() == pytest.approx(OFFSET_V, rel=1e-3)


def test_a_load_that_changes_abruptly_is_learnt_anew_where_that_is_watched() -> None:
    """Two disks drop: P opens, so that some samples later the innovations are noise again.

    What they were before does not count any more.
    """
    errors, shown = {}, {}
    for alert in (False, True):
        learning = replace(DIRECT, alert=alert, forgetting=0.999)
        settings = replace(SETTINGS, learning=learning)
        state, innovations = learnt(settings, [1] * 200 + [3] * 60, noise=1e-4)
        errors[alert] = math.sqrt(float(np.mean(innovations[-30:] ** 2)))
        count = len(state.estimator.estimate.theta)
        shown[alert] = state.estimator.residuals.noise(count) * learning.output_scale
        assert state.estimator.detector.alarms == (1 if alert else 0)
    assert shown[True] == pytest.approx(errors[True], rel=0.5)
    assert errors[True] < 5e-4
    assert errors[False] > 2.0 * errors[True]


TURNS, SERIES_OHM, RELAXATION_OHM, RELAXATION_S = 0.25, 1.2, 0.4, 30.0
RISE_V_PER_AS = 8.0 / 36000.0
CHARGED = battery_load(TURNS, SERIES_OHM, RELAXATION_OHM, RELAXATION_S)
TRUTH = CHARGED.physical(list(CHARGED.numerator), list(CHARGED.denominator))
TICKS, SECONDS = 120, 400
CHARGE_LEARNING = replace(
    SCALED_LEARNING,
    tau_lambda_s=20.0,
    output_scale=47.0,
    input_scale=300.0,
    initial_covariance=1e8,
    bias=True,
    charge=True,
)


def simulated_charge() -> tuple[Array, Array]:
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


def learnt_charge(learning: EstimatorSettings) -> LambdaEstimator:
    """An estimate from the tick-wise samples, which start at rest on the first ones."""
    voltages, currents = simulated_charge()
    estimator = LambdaEstimator(learning, CHARGED, 2)
    regressor, regression = estimator.sample.regressor, estimator.regression
    bank = fast.new_filter_bank(CHARGED, TICK_s, 20.0, float(currents[0]), float(voltages[0]))
    for n in range(1, voltages.size):
        fast.filter_sample(bank, float(currents[n]), float(voltages[n]), 1)
        if n % TICKS == 0:
            fast.accumulate(bank)
            y, *rest = fast.take_means(bank)
            estimator.charge = float(np.sum(currents[:n])) * TICK_s / 20.0 / learning.output_scale
            regression.fill_signals(regressor, rest[:1], rest[1:])
            regression.fill_charge(regressor, estimator.charge)
            estimator.take_output(y, usable=True)
    return estimator


def test_the_rise_of_an_emf_is_no_dynamics() -> None:
    found = CHARGED.physical(*learnt_charge(CHARGE_LEARNING).model())
    assert found == pytest.approx(TRUTH, rel=0.02)
    ignorant = replace(CHARGE_LEARNING, charge=False)
    mistaken = CHARGED.physical(*learnt_charge(ignorant).model())
    assert abs(mistaken[1] / TRUTH[1] - 1.0) > 0.2


def test_the_offset_is_the_emf_of_now() -> None:
    offset_V = learnt_charge(CHARGE_LEARNING).input_offset()
    _, currents = simulated_charge()
    emf_V = 72.0 + RISE_V_PER_AS * float(np.sum(currents)) * TICK_s
    assert offset_V == pytest.approx(-emf_V / TURNS, rel=2e-3)
    assert emf_V - 72.0 > 0.8
