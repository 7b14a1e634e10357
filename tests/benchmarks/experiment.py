"""The motor experiment: the simulator against a textbook script, and against real time."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import padasip
from scipy.signal import cont2discrete

from adaptdrive_sim.experiments.case import Case, Disturbance, case_settings, run_case
from adaptdrive_sim.experiments.published import MOTOR
from tests.benchmarks.rows import Extent, Row

GAIN, TAU_MOTOR_S, TAU_FILTER_S, TAU_LAMBDA_S = 0.011, 11.7, 10.0, 10.0
TICK_S, TICKS = 1.0 / 120.0, 120
POLE = 0.70


def rows(extent: Extent) -> Iterator[Row]:
    """All rows of this file."""
    ours, textbook = [], []
    for _ in range(extent.pick(3, 1, 1)):
        ours.append(_ours())
        textbook.append(_textbook())
    simulated = MOTOR.duration_s
    note = "adaptive, 120 Hz, both halves, boost stage and motor"
    yield Row(
        "motor experiment, 1320 s", min(ours), "s", min(textbook), "textbook script", note=note
    )
    faster = simulated / min(ours)
    yield Row("motor experiment against real time", faster, "x", note="simulated over wall time")


def _ours() -> float:
    settings = case_settings(MOTOR, "adaptive", "paper")
    case = Case(MOTOR, "adaptive", settings, Disturbance(MOTOR.noise), 0)
    began_s = time.perf_counter()
    run_case(case)
    return time.perf_counter() - began_s


def _textbook() -> float:
    began_s = time.perf_counter()
    textbook_experiment()
    return time.perf_counter() - began_s


def _held(numerator: list[float], denominator: list[float], step_s: float) -> list[np.ndarray]:
    """A transfer function as a discrete state-space system."""
    system = (np.array(numerator), np.array(denominator))
    return list(cont2discrete(_state_space(*system), step_s)[:4])


def _state_space(
    numerator: np.ndarray, denominator: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    from scipy.signal import tf2ss  # noqa: PLC0415 - as such scripts do

    found = tf2ss(numerator, denominator)
    return found[0], found[1], found[2], found[3]


def _motor(disks: int) -> list[np.ndarray]:
    tau_s = TAU_MOTOR_S * disks
    denominator = [tau_s * TAU_FILTER_S, tau_s + TAU_FILTER_S, 1.0]
    return _held([GAIN], denominator, TICK_S)


def textbook_experiment() -> list[float]:
    """The paper's controller as one would write it: scipy plant, numpy loops, padasip RLS."""
    noise = np.random.default_rng(0)
    lag = _held([1.0], [TAU_LAMBDA_S, 1.0], TICK_S)
    decay, rise = float(lag[0][0, 0]), float(lag[1][0, 0] * lag[2][0, 0])
    rls = padasip.filters.FilterRLS(n=3, mu=0.97, eps=1e-4)
    plant, state = _motor(1), np.zeros((2, 1))
    chain_y, chain_u = np.zeros(2), np.zeros(3)
    outputs, past_y, past_u = [], np.zeros(3), np.zeros(3)
    design, voltage, boost = np.array([60.0, -100.0, 50.0, 0.5, 0.0]), 3.0 / GAIN, 3.0 / GAIN
    state = np.linalg.solve(np.eye(2) - plant[0], plant[1]) * voltage
    for n in range(1320 * TICKS):
        if n in (600 * TICKS, 960 * TICKS):
            plant = _motor(2 if n == 600 * TICKS else 3)
        boost = boost + 0.05 * (voltage - boost)
        state = plant[0] @ state + plant[1] * boost
        y = float((plant[2] @ state)[0, 0]) + 0.0004 * noise.normal()
        chain_y[0] = decay * chain_y[0] + rise * y
        chain_y[1] = decay * chain_y[1] + rise * chain_y[0]
        chain_u[0] = decay * chain_u[0] + rise * boost
        chain_u[1] = decay * chain_u[1] + rise * chain_u[0]
        if n % TICKS == 0:
            outputs.append(y)
            regressor = np.array([-chain_y[0], -chain_y[1], chain_u[1]])
            rls.adapt(y, regressor)
            _design(rls.w)
            reference = 3.2 if n // TICKS % 120 < 60 else 3.0
            past_y, past_u = np.roll(past_y, 1), np.roll(past_u, 1)
            past_y[0], past_u[0] = y, voltage
            wanted = past_u[0] + design[0] * (reference - past_y[0])
            voltage = float(np.clip(wanted, 200.0, 400.0))
    return outputs


def _design(theta: np.ndarray) -> np.ndarray:
    """Pole placement by the Sylvester matrix of the estimated load."""
    scale = 1.0 + theta[0] + theta[1]
    denominator = [TAU_LAMBDA_S**2, TAU_LAMBDA_S * (2.0 + theta[0]), max(scale, 1e-3)]
    discrete = cont2discrete(([max(theta[2], 1e-6)], denominator), 1.0)
    b, a = np.ravel(discrete[0])[1:], np.ravel(discrete[1])
    loop = np.convolve(a, [1.0, -1.0])
    matrix = np.zeros((5, 5))
    for i in range(2):
        matrix[i : i + 4, i] = loop
    for i in range(3):
        matrix[i + 1 : i + 3, 2 + i] = b
    solution: np.ndarray = np.linalg.lstsq(matrix, np.poly([POLE] * 4), rcond=None)[0]
    return solution
