"""Direct least squares on sampled signals, against the held model of scipy."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from adaptdrive.control import estimator as est
from adaptdrive.control import in_force
from adaptdrive.control.load import Load
from adaptdrive.control.loads.battery import battery_load
from adaptdrive.control.loads.motor import motor_load
from adaptdrive.control.methods import METHODS
from adaptdrive.control.settings import ControllerSettings
from adaptdrive.control.slow_state import SlowState, new_slow_state
from adaptdrive.control.supervisor import Verdict
from adaptdrive.control.vectors import shift_in
from tests.closed_loop.bench import AT_REST, MOTOR, PAPER, PLAIN_LEARNING, SCALED_LEARNING
from tests.control.systems import Array, held_polynomials, motor_system

DIRECT = replace(
    SCALED_LEARNING, method=METHODS["rls"], start_at_nominal=False, gate=0.0, bias=True,
    initial_covariance=1e6,
)  # fmt: skip
SETTINGS = replace(PAPER, learning=DIRECT)
OFFSET_V = 25.0


@cache
def held(disks: int) -> tuple[Array, Array]:
    return held_polynomials(motor_system(disks), 1.0)


def learn(
    settings: ControllerSettings, disks: list[int], noise: float = 0.0
) -> tuple[SlowState, Array]:
    """An estimator that has seen a motor with so many disks in each period; its innovations."""
    random = np.random.default_rng(5)
    state, learning = new_slow_state(settings, MOTOR, 3.0, 280.0), settings.learning
    outputs, inputs, innovations = [3.0, 3.0], [280.0, 280.0], []
    for count in disks:
        a, b = held(count)
        y = float(-np.dot(a[1:], outputs) + np.dot(b[1:], np.add(inputs, OFFSET_V)))
        outputs = [y, outputs[0]]
        sample = replace(AT_REST, output=y + noise * random.normal())
        learning.method.fill_regressor(state, learning, MOTOR, sample)
        target = learning.method.target(learning, sample)
        est.learn(state.estimator, learning, MOTOR, target, usable=True)
        innovations.append(state.estimator.innovation)
        shift_in(state.outputs, sample.output)
        inputs = [280.0 + 20.0 * random.normal(), inputs[0]]
        shift_in(state.inputs, inputs[0])
    return state, np.array(innovations)


def test_the_discrete_model_and_the_offset_of_the_input_are_found() -> None:
    state, _ = learn(SETTINGS, [2] * 600)
    method, estimator = DIRECT.method, state.estimator
    a, b, verdict = method.model(SETTINGS, MOTOR, state, 1.0)
    bottom, top = held(2)
    assert a == pytest.approx(bottom, rel=1e-5)
    assert b[:3] == pytest.approx(top, abs=1e-8)
    assert b[3:] == pytest.approx([0.0] * len(b[3:]), abs=1e-8)
    assert verdict == Verdict.TRUSTED
    assert state.values == pytest.approx([0.011, 33.4, 234.0], rel=1e-3)
    assert method.input_offset(estimator, DIRECT, MOTOR) == pytest.approx(OFFSET_V, rel=1e-3)


def test_its_parameters_are_no_model_in_s_and_have_no_deviations() -> None:
    method, state = DIRECT.method, new_slow_state(SETTINGS, MOTOR, 3.0, 280.0)
    assert not method.physical
    assert not any(est.nominal_theta(DIRECT, MOTOR, 2))
    values = [0.011, 33.4, 234.0]
    for known, count in ((method.root, 9), (method.shown_deviations, 3)):
        found = known(state.estimator, DIRECT, MOTOR, values)
        assert len(found) == count
        assert all(math.isnan(one) for one in found)


@pytest.mark.parametrize("load", [motor_load(0.011, 11.7, 10.0), battery_load(0.25, 1.2, 0.4, 30)])
@pytest.mark.parametrize("bias", [False, True])
def test_it_has_a_parameter_for_each_past_sample(load: Load, *, bias: bool) -> None:
    learning = replace(PLAIN_LEARNING, method=METHODS["rls"], bias=bias)
    assert learning.method.parameter_count(learning, load, 4) == load.order + 4 + bias


def test_a_load_that_changes_abruptly_is_learnt_anew_where_that_is_watched() -> None:
    """Two disks drop: P opens, so that some samples later the innovations are noise again.

    What they were before does not count any more.
    """
    errors, shown = {}, {}
    for alert in (False, True):
        learning = replace(DIRECT, alert=alert, forgetting=0.999)
        settings = replace(SETTINGS, learning=learning)
        state, innovations = learn(settings, [1] * 200 + [3] * 60, noise=1e-4)
        errors[alert] = math.sqrt(float(np.mean(innovations[-30:] ** 2)))
        shown[alert] = in_force.residual_noise(state.estimator) * learning.output_scale
        assert state.estimator.surprise.alarms == (1 if alert else 0)
    assert shown[True] == pytest.approx(errors[True], rel=0.5)
    assert errors[True] < 5e-4
    assert errors[False] > 2.0 * errors[True]
