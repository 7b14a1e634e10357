"""Estimates of a motor: those of the real estimator for hours, and months drawn from its errors."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
from scipy.signal import cont2discrete, lfilter

from adaptdrive.control.estimation.estimator import LambdaEstimator
from adaptdrive.control.loads.load import derived
from adaptdrive.control.signals import Decision, Estimate, Mode, Order, Snapshot, Stage
from adaptdrive.recording.health import HourRow
from adaptdrive.recording.records import HealthSettings
from adaptdrive.runtime.reports import LoadReport
from tests.integration.closed_loop.bench import MOTOR
from tests.unit.control.learning import WATCHED, learn_sample
from tests.unit.control.systems import Array

LEARNING = replace(WATCHED, gate=1.2, settle_periods=5)
STEP_s, TAU_s, STEPS = 0.1, 10.0, 10
NOISE = 3e-4
TRUTH = {"gain": 0.011, "tau_sum_s": 21.7, "tau_product_s2": 117.0, "input_offset": -20.0}
TRUTH |= derived(MOTOR.products, MOTOR.loss, TRUTH)
SETTINGS = HealthSettings(
    products=MOTOR.products,
    loss=MOTOR.loss,
    share=1.0 - LEARNING.forgetting,
    least_excitation=LEARNING.gate * (1.0 - LEARNING.forgetting),
)
BEGIN = datetime(2026, 1, 5, tzinfo=UTC)
SETTLED_S = 300


def filtered(signal: Array, parts: list[list[float]], method: str) -> Array:
    """A signal behind a linear system, from rest at its first value."""
    numerator, denominator, _ = cont2discrete(parts, STEP_s, method)
    return np.asarray(signal[0] + lfilter(numerator.ravel(), denominator, signal - signal[0]))


def motor_hours(hours: float, seed: int) -> list[LoadReport]:
    """The slow steps of a motor whose voltage changes every half minute."""
    count = round(hours * 3600 * STEPS)
    time_s = np.arange(count) * STEP_s
    random = np.random.default_rng(seed)
    levels = random.uniform(280.0, 300.0, math.ceil(count / (30 * STEPS)))
    voltages = levels[(time_s // 30).astype(int)]
    driven, outputs = voltages + TRUTH["input_offset"], np.empty(count)
    outputs = 0.011 * filtered(driven, [[1.0], [117.0, 21.7, 1.0]], "zoh")
    lag = [[1.0], [TAU_s, 1.0]]
    y1, u1 = filtered(outputs, lag, "foh"), filtered(voltages, lag, "zoh")
    y2, u2 = filtered(y1, lag, "foh"), filtered(u1, lag, "foh")
    estimator = LambdaEstimator(LEARNING, MOTOR, 2)
    found = []
    for second in range(1, count // STEPS):
        n = second * STEPS
        u = float(voltages[n - 1])
        output = float(outputs[n] + NOISE * random.normal())
        learn_sample(
            estimator, 1.0, output, [float(y1[n]), float(y2[n])], [u, float(u1[n]), float(u2[n])]
        )
        found.append(report(estimator, second))
    return found


def report(estimator: LambdaEstimator, second: int) -> LoadReport:
    """The slow step of an estimator, accepted once it has settled."""
    values = MOTOR.physical(*estimator.model())
    shown = [*estimator.shown_deviations(values), estimator.offset_deviation()]
    values = [*values, estimator.input_offset()]
    names = (*MOTOR.names, "input_offset")
    estimates = {n: Estimate(v, s) for n, v, s in zip(names, values, shown, strict=True)}
    order = Order(Stage.RUN, 3.0, Mode.ADAPTIVE, 0.7)
    snapshot = Snapshot(
        second, second * 120, 1.0, order, 3.0, (3.0, 3.0), (280.0,) * 3, 280.0, True, 0
    )
    decision = Decision(
        k=second,
        boost_reference_V=280.0,
        controller=Mode.ADAPTIVE,
        accepted=second > SETTLED_S,
        reason="",
        estimates=estimates,
        gains=(0.0,),
        innovation=estimator.innovation,
        excitation=estimator.excitation,
        handover_step_V=0.0,
    )
    return LoadReport(snapshot, decision, float(second))


HOURS = range(8, 18)
"""Hours of a day with excitation."""

MEMORY_h = 10.0
"""Hours for which a disturbance of the load lasts."""


def months(
    weeks: float, seed: int, course: Callable[[float], float] = lambda _: 1.0
) -> list[HourRow]:
    """Hours of a motor: its friction follows a course over the weeks, of 1 at the begin."""
    random = np.random.default_rng(seed)
    rows, slow, kept = [], 0.0, math.exp(-1.0 / MEMORY_h)
    for hour in range(round(weeks * 168)):
        time = BEGIN + timedelta(hours=hour)
        slow = kept * slow + math.sqrt(1.0 - kept * kept) * 0.01 * random.normal()
        if time.hour in HOURS and time.weekday() < 5:
            value = TRUTH["friction"] * course(hour / 168) * (1.0 + slow)
            std = 0.02 * TRUTH["friction"] * random.choice([0.5, 1.0, 3.0])
            found = float(value + std * random.normal()), float(std)
            rows.append(HourRow(time, BEGIN, 1.0, 0, {"friction": found}))
    return rows
