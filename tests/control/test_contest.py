"""The replay of the law that is not in force, held against a second plant that it drives."""

from __future__ import annotations

import numpy as np
import pytest

from adaptdrive.control.compensator import control_law
from adaptdrive.control.contest import (
    Contest,
    asked_output,
    forgive,
    lose,
    replay_law,
    replay_load,
    start_replay,
    wait,
    weigh,
)
from adaptdrive.control.design import asked_loop, compensator_gains, discrete_model
from adaptdrive.control.reference_filter import new_reference_filter
from adaptdrive.control.ringing import Ringing
from adaptdrive.control.vectors import shift_in
from tests.closed_loop.bench import EXACT, MOTOR

A, B = discrete_model(EXACT, MOTOR, list(MOTOR.numerator), list(MOTOR.denominator), 1.0)
TAPS, ORDER = len(B) - 1, MOTOR.order
REST_V = 3.0 / 0.011
LOW, HIGH = 200.0, 400.0


def contest() -> Contest:
    state = Contest(
        inputs=[0.0] * TAPS,
        outputs=[0.0] * (ORDER + 1),
        pushes=[0.0] * TAPS,
        shifts=[0.0] * (ORDER + 1),
        filter=new_reference_filter(ORDER, TAPS),
        course=[3.0] * (2 * ORDER + TAPS + 1),
        ringing=Ringing(),
    )
    start_replay(state, [REST_V] * TAPS, [3.0] * (ORDER + 1), state.filter)
    return state


class Plant:
    """The discrete model, with a torque and the noise of the sensor."""

    def __init__(self) -> None:
        self.inputs = [REST_V] * len(B)
        self.states = [3.0] * ORDER

    def step(self, load_input: float, torque_V: float) -> float:
        shift_in(self.inputs, load_input)
        output = np.dot(B[1:], self.inputs[:-1]) + torque_V * sum(B) - np.dot(A[1:], self.states)
        shift_in(self.states, float(output))
        return float(output)


class Law:
    """A law on a history of its own."""

    def __init__(self, pole: float) -> None:
        self.gains = compensator_gains(A, B, ORDER, pole)
        self.inputs = [REST_V] * TAPS
        self.outputs = [3.0] * (ORDER + 1)

    def step(self, output: float, reference: float) -> float:
        shift_in(self.outputs, output)
        wanted = control_law(self.gains, self.inputs, self.outputs, reference)
        shift_in(self.inputs, min(max(wanted, LOW), HIGH))
        return self.inputs[0]


def test_the_replay_is_what_the_other_law_does_to_the_same_load() -> None:
    """With noise, a torque and limits: nothing of that is in the model."""
    state, noise = contest(), 0.003 * np.random.default_rng(4).standard_normal(300)
    real, other = Law(0.7), Law(0.6)
    mine, yours = Plant(), Plant()
    at_limit = 0
    for k in range(300):
        torque_V, reference = (20.0 if k > 150 else 0.0), 3.0 + 0.5 * (k // 60 % 2)
        output = mine.step(real.inputs[0], torque_V) + noise[k]
        expected = yours.step(other.inputs[0], torque_V) + noise[k]
        replay_load(state, A, B, real.inputs[0], output)
        assert state.outputs[0] == pytest.approx(expected, abs=1e-9)
        real.step(output, reference)
        at_limit += other.step(expected, reference) in {LOW, HIGH}
        replay_law(state, other.gains, reference, LOW, HIGH, filtered=False)
    assert at_limit > 5


def test_the_response_asked_for_is_that_of_a_loop_without_limits_and_noise() -> None:
    state, law, plant = contest(), Law(0.7), Plant()
    law.inputs = [REST_V] * TAPS
    for k in range(60):
        reference = 3.0 if k < 5 else 3.01
        output = plant.step(law.inputs[0], 0.0)
        expected = asked_output(state, asked_loop(B, ORDER, 0.7), B, reference)
        assert output == pytest.approx(expected, abs=1e-9)
        law.step(output, reference)


@pytest.mark.parametrize("adaptive", [True, False])
def test_each_cost_is_that_of_its_law(adaptive: bool) -> None:
    state = contest()
    state.adaptive = adaptive
    state.outputs[0] = 3.2
    for _ in range(1000):
        weigh(state, 3.1, 3.0, 0.02)
    costs = (state.adaptive_cost, state.fixed_cost)
    assert costs == pytest.approx((0.01, 0.04) if adaptive else (0.04, 0.01))


def waited(state: Contest) -> int:
    periods = 0
    while state.waiting_periods > 0 and periods < 10_000:
        wait(state)
        periods += 1
    return periods


def test_each_loss_waits_twice_as_long_as_the_one_before() -> None:
    state = contest()
    state.adaptive_cost, state.fixed_cost = 0.0, 1.0
    waits = []
    for _ in range(8):
        lose(state, 10)
        waits.append(waited(state))
    assert waits == [10, 20, 40, 80, 160, 320, 320, 320]


def test_the_wait_ends_only_when_the_replay_wins() -> None:
    state = contest()
    state.adaptive_cost, state.fixed_cost = 1.0, 0.5
    lose(state, 10)
    assert waited(state) == 10_000
    state.adaptive_cost = 0.4
    assert waited(state) == 1


def test_a_loss_is_forgotten_after_enough_time_in_force() -> None:
    state = contest()
    lose(state, 10)
    lose(state, 10)
    for _ in range(100):
        forgive(state, 50)
    assert state.losses == 2, "nothing is proved while the fixed law is in force"
    state.adaptive = True
    for _ in range(51):
        forgive(state, 50)
    assert state.losses == 1
