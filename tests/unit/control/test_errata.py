"""The errors of the printed paper: each test shows what the print gives, and what is right.

Stability alone would let some of them pass, so poles are held to their places.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from adaptdrive.control import fast
from adaptdrive.control.design.pole_placement import desired_polynomial
from adaptdrive.control.estimation.estimator import LambdaEstimator
from adaptdrive.control.estimation.rls import Estimate
from adaptdrive.control.loads.bath import bath_load
from adaptdrive.control.loads.load import Load, to_voltage
from adaptdrive.control.loads.motor import motor_load, paper_model
from adaptdrive.control.settings import EstimatorSettings
from adaptdrive.control.slow import control_law
from tests.unit.control.learning import learn_sampled
from tests.unit.control.systems import (
    Array,
    System,
    distance,
    held_polynomials,
    matrix_of,
    motor_system,
    place_poles,
)

GAIN, MOTOR_s, FILTER_s = 0.011, 11.7, 10.0
POLE = 0.7


@dataclass(frozen=True, slots=True)
class Coefficients:
    """a_1, a_2 and b_1 of (24)."""

    a1: float
    a2: float
    b1: float

    def gains(self) -> list[float]:
        """Of the compensator (26) as corrected, for this model."""
        r, s = place_poles(
            [1.0, self.a1, self.a2], [0.0, self.b1, 0.0], desired_polynomial(POLE, 4)
        )
        return [*r[1:], *s]


def printed(period_s: float, motor_s: float = MOTOR_s) -> Coefficients:
    """(25) to the letter."""
    slow, fast_ = math.exp(-period_s / motor_s), math.exp(-period_s / FILTER_s)
    return Coefficients(
        a1=-(slow - fast_), a2=slow * fast_, b1=GAIN / (motor_s - FILTER_s) * (slow - fast_)
    )


def corrected(period_s: float, motor_s: float = MOTOR_s) -> Coefficients:
    """(25) with its three corrections, as the controller uses it."""
    load = motor_load(GAIN, motor_s, FILTER_s)
    a, b = paper_model(list(load.numerator), list(load.denominator), period_s)
    return Coefficients(a[1], a[2], b[1])


def loop_poles(gains: list[float], period_s: float, motor_s: float = MOTOR_s) -> Array:
    """Poles of the law with the impulse response of the motor, sampled by scipy."""
    system = System(
        [0.0, 0.0, GAIN / (motor_s * FILTER_s)],
        [1.0, (motor_s + FILTER_s) / (motor_s * FILTER_s), 1.0 / (motor_s * FILTER_s)],
    )
    a, b, c, _, _ = cont2discrete(system.state_space(), period_s, "impulse")

    def step(z: Array) -> Array:
        x, inputs, outputs = z[:2], z[2:4], z[4:]
        seen = [float(c[0] @ x), *outputs]
        u = control_law(gains, inputs.tolist(), seen, 0.0)
        return np.concatenate([a @ x + b[:, 0] * u, [u], inputs[:-1], seen[:-1]])

    poles = np.linalg.eigvals(matrix_of(step, 6))
    return np.asarray(sorted(poles, key=abs)[2:])


def radius(poles: Array) -> float:
    return float(np.abs(poles).max())


@pytest.mark.parametrize("period_s", [0.5, 1.0, 2.0])
def test_corrected_the_four_poles_lie_at_070_whatever_the_period(period_s: float) -> None:
    poles = loop_poles(corrected(period_s).gains(), period_s)
    assert distance(poles, [POLE] * 4) < 2e-3


def test_a1_is_the_sum_of_the_decays_not_their_difference() -> None:
    right = corrected(1.0)
    wrong = replace(right, a1=printed(1.0).a1)
    assert radius(loop_poles(wrong.gains(), 1.0)) == pytest.approx(3.1, abs=0.05)


@pytest.mark.parametrize(
    ("period_s", "expected"),
    [
        (0.5, [0.895 + 0.182j, 0.895 - 0.182j, 0.863, 0.334]),
        (2.0, [0.797 + 0.035j, 0.797 - 0.035j, 0.499 + 0.359j, 0.499 - 0.359j]),
    ],
)
def test_b1_has_the_period_as_a_factor(period_s: float, expected: list[complex]) -> None:
    right = corrected(period_s)
    wrong = replace(right, b1=printed(period_s).b1)
    poles = loop_poles(wrong.gains(), period_s)
    assert radius(poles) < 1.0  # stable: only the positions tell
    assert distance(poles, expected) < 2e-3


def test_at_a_period_of_one_second_the_missing_factor_does_not_show() -> None:
    assert printed(1.0).b1 == pytest.approx(corrected(1.0).b1, rel=1e-12)


def test_the_period_is_that_of_the_load_loop_not_of_the_voltage_loop() -> None:
    poles = loop_poles(corrected(1.0 / 120.0).gains(), 1.0)
    assert radius(poles) > 1000.0


def test_equal_time_constants_have_a_limit_where_the_print_divides_by_zero() -> None:
    with pytest.raises(ZeroDivisionError):
        printed(1.0, motor_s=FILTER_s)
    poles = loop_poles(corrected(1.0, motor_s=FILTER_s).gains(), 1.0, motor_s=FILTER_s)
    assert distance(poles, [POLE] * 4) < 2e-3


def test_the_coefficients_of_the_past_voltages_are_one_plus_d1_and_minus_d1() -> None:
    model, gains = corrected(1.0), corrected(1.0).gains()
    d1 = POLE**4 / model.a2
    assert gains[:2] == pytest.approx([-(1.0 + d1), d1], rel=1e-9)
    poles = loop_poles([-d1, -(d1 - 1.0), *gains[2:]], 1.0)
    assert radius(poles) < 1.0  # stable: only the positions tell
    expected = [0.85j, -0.85j, 0.90 + 0.03j, 0.90 - 0.03j]
    assert distance(poles, expected) < 0.01
    a, b, s = [1.0, model.a1, model.a2], [0.0, model.b1, 0.0], gains[2:]
    for r, dc_gain in (([1.0, -d1, 1.0 - d1], 0.42), ([1.0, *gains[:2]], 1.0)):
        loop = np.convolve(a, r) + np.convolve(b, s)
        assert sum(s) * sum(b) / sum(loop) == pytest.approx(dc_gain, abs=0.01)


def test_a_forgetting_factor_of_099_remembers_33_minutes_of_20_s_not_60() -> None:
    own = Estimate(1)
    own.open_up(1e4)
    for _ in range(5000):
        own.update([1.0], 0.0, 0.99)
    periods = 0
    while own.theta[0] < 1.0 - math.exp(-1.0):
        own.update([1.0], 1.0, 0.99)
        periods += 1
    assert periods * 20.0 / 60.0 == pytest.approx(33.0, abs=1.0)


MOTOR = motor_load(GAIN, MOTOR_s, FILTER_s)
BATH = bath_load(0.02104, 200.0, 0.25, 1.0, 7.87)


@pytest.mark.parametrize("filtered", [True, False])
@pytest.mark.parametrize(("load", "period_s", "input_"), [(MOTOR, 1.0, 280.0), (BATH, 20.0, 600.0)])
def test_either_estimator_is_there_for_either_load(
    load: Load, period_s: float, input_: float, *, filtered: bool
) -> None:
    """The print calls the bath's estimator LM-RLS in one section and plain RLS in the next."""
    system = System(list(load.numerator), list(load.denominator))
    learning = EstimatorSettings(
        method="lm-rls" if filtered else "rls",
        forgetting=1.0,
        tau_lambda_s=10.0 * period_s,
        initial_covariance=1e8,
        settle_periods=0,
        gate=0.0,
        output_scale=system.dc_gain * input_,
        input_scale=input_,
        start_at_nominal=False,
    )
    learn = _learn_filtered if filtered else _learn_direct
    inputs = input_ * (1.0 + 0.2 * np.random.default_rng(1).choice([-1.0, 1.0], 200))
    found, expected = learn(learning, load, system, period_s, inputs)
    assert found == pytest.approx(expected, rel=1e-3)


def _learn_filtered(
    learning: EstimatorSettings, load: Load, system: System, period_s: float, inputs: Array
) -> tuple[list[float], list[float]]:
    ticks = 60
    bottom, top = held_polynomials(system, period_s / ticks)
    start = float(inputs[0])
    held = np.repeat(inputs, ticks)
    outputs = system.dc_gain * start + lfilter(top, bottom, held - start)
    voltage_V = to_voltage(start, load.input_gain, load.input_exponent)
    bank = fast.new_filter_bank(
        load, period_s / ticks, learning.tau_lambda_s, float(outputs[0]), voltage_V
    )
    estimator = LambdaEstimator(learning, load, load.order)
    for n, output in enumerate(outputs):
        bank.inputs[0] = bank.late[-1] = float(held[max(0, n - 1)])  # held from its beginning
        fast.filter_sample(bank, float(output), bank.inputs[0], 1)
        if n % ticks == 0 and n:
            powers = [float(held[n - 1]), *bank.inputs[1:]]
            estimator.regression.fill_signals(estimator.sample.regressor, bank.outputs[1:], powers)
            estimator.take_output(float(output), usable=True)
    return load.physical(*estimator.model()), load.physical(
        list(load.numerator), list(load.denominator)
    )


def _learn_direct(
    learning: EstimatorSettings, load: Load, system: System, period_s: float, inputs: Array
) -> tuple[list[float], list[float]]:
    bottom, top = held_polynomials(system, period_s)
    outputs = system.dc_gain * inputs[0] + lfilter(top, bottom, inputs - inputs[0])
    a, b = learn_sampled(learning, load, inputs, outputs)
    return [*a[1:], *b[1:]], [*bottom[1:].tolist(), *top[1:].tolist()]


def test_on_a_motor_whose_input_is_held_the_papers_poles_land_elsewhere() -> None:
    """No error of the print, but of its use with a drive that holds its voltage."""
    bottom, top = held_polynomials(motor_system(), 1.0)
    gains = corrected(1.0).gains()
    loop = np.polyadd(np.convolve(bottom, [1.0, *gains[:2]]), np.convolve(top, gains[2:]))
    expected = [0.67 + 0.30j, 0.67 - 0.30j, 0.80 + 0.05j, 0.80 - 0.05j]
    assert distance(np.roots(loop), expected) < 0.02
