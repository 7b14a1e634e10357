"""Estimators that learn a course of samples tick by tick, as the controller has them learn."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from adaptdrive.control import fast
from adaptdrive.control.estimation.direct import DirectEstimator
from adaptdrive.control.estimation.estimator import LambdaEstimator
from adaptdrive.control.estimation.rls import Estimate
from adaptdrive.control.loads.bath import bath_load
from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import EstimatorSettings
from tests.integration.closed_loop.bench import AT_REST, SCALED_LEARNING
from tests.unit.control.systems import Array


def learn_course(
    estimator: LambdaEstimator,
    course: tuple[Array, Array],
    *,
    tick_s: float,
    ticks: int,
    samples: int = 1,
) -> Iterator[int]:
    """Learn a course; yield the number of the tick after each slow period.

    Args:
        estimator: What learns it.
        course: Voltage at the boost capacitor and output, at the ticks; at rest at first.
        tick_s: Duration of a tick.
        ticks: Ticks in a slow period.
        samples: The last ticks of a period, whose mean is learnt.
    """
    voltages, outputs = course
    load, first = estimator.load, (float(outputs[0]), float(voltages[0]))
    bank = fast.new_filter_bank(load, tick_s, estimator.learning.tau_lambda_s, *first)
    for n in range(1, len(outputs)):
        fast.filter_sample(bank, float(outputs[n]), float(voltages[n]), 1)
        if (n - 1) % ticks >= ticks - samples:
            fast.accumulate(bank)
        if n % ticks == 0:
            y, *rest = fast.take_means(bank)
            learn_sample(estimator, ticks * tick_s, y, rest[: load.order], rest[load.order :])
            yield n


def learn_sample(
    estimator: LambdaEstimator, period_s: float, y: float, outputs: list[float], inputs: list[float]
) -> None:
    """Learn the output at the end of a slow period from λy ... λ^m y and u, λu ... λ^m u."""
    sample = replace(
        AT_REST, period_s=period_s, output=y, output_filtered=outputs, input_filtered=inputs
    )
    estimator.take_sample(sample, [], [], usable=True)


def dense(estimate: Estimate) -> Array:
    """P as a matrix."""
    size = len(estimate.theta)
    return np.reshape(estimate.covariance(), (size, size))


WATCHED = replace(
    SCALED_LEARNING,
    forgetting=0.985,
    initial_covariance=1e8,
    bias=True,
    alert=True,
    initial_state=True,
)
"""A motor whose abrupt changes are explained."""

R, TAU_s = 0.021, 500.0
BATH = bath_load(R, TAU_s, 0.25, 1.0, 7.87)
BATH_TICK_s, BATH_TICKS = 0.5, 40
BATH_LEARNING = replace(
    SCALED_LEARNING,
    tau_lambda_s=100.0,
    output_scale=12.0,
    input_scale=570.0,
    initial_covariance=1e8,
    gate=1.2,
    bias=True,
    initial_state=True,
    alert=True,
)


def bath_temperatures(power_W: Array, inflow_K: Array, noise_K: Array) -> Array:
    """Temperature of a first-order bath at the ticks: the held heater and the inflow."""
    held = math.exp(-BATH_TICK_s / TAU_s)
    heated_K = lfilter([0.0, R * (1.0 - held)], [1.0, -held], power_W - 520.0) + R * 520.0
    cooled_K = lfilter([1.0 - held], [1.0, -held], inflow_K - inflow_K[0]) + inflow_K[0]
    return np.asarray(heated_K + cooled_K + noise_K)


def bath_values(estimator: LambdaEstimator, theta: list[float]) -> list[float]:
    """R and τ of an estimate."""
    return BATH.physical(*estimator.regression.model(theta))


def learn_sampled(
    learning: EstimatorSettings, load: Load, inputs: Array, outputs: Array
) -> tuple[list[float], list[float]]:
    """Learn A and B directly from inputs that were held and the outputs at their ends."""
    order = load.order
    estimator = DirectEstimator(learning, load, order)
    for k in range(order, len(inputs)):
        estimator.fill(outputs[k - order : k][::-1].tolist(), inputs[k - order : k][::-1].tolist())
        estimator.take_output(float(outputs[k]), usable=True)
    b, a = estimator.model()
    return a, b
