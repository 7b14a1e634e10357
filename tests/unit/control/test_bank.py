"""What the bank makes of an alarm: courses of a motor by scipy, filtered by scipy."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from scipy.signal import lsim
from scipy.stats import norm

from adaptdrive.control import thresholds
from adaptdrive.control.estimation.bank import Bank
from adaptdrive.control.estimation.change import DISTURBANCE, LOAD, Branch, ChangeDetector
from adaptdrive.control.estimation.estimator import LambdaEstimator
from adaptdrive.control.estimation.regression import Observation, Regression
from tests.integration.closed_loop.bench import MOTOR
from tests.unit.control.learning import WATCHED, learn_sample
from tests.unit.control.systems import Array

LEARNING = replace(WATCHED, settle_periods=5)
REGRESSION = Regression(LEARNING, MOTOR)
STEP_s, TAU_s, STEPS = 0.02, 10.0, 50
CHANGE_s, END_s = 200, 320
NOISE = 3e-4


def motion(disks: float) -> tuple[list[list[float]], list[list[float]], list[list[float]], float]:
    tau_s = 11.7 * disks
    return [[-1.0 / tau_s, 0.0], [0.1, -0.1]], [[0.011 / tau_s], [0.0]], [[0.0, 1.0]], 0.0


def course(disks: tuple[float, float], offsets_V: tuple[float, float]) -> tuple[Array, Array]:
    """Voltage and output under a square wave; inertia and torque jump in the middle."""
    time_s = np.arange(END_s * STEPS) * STEP_s
    voltages = 280.0 + 12.0 * (time_s // 30 % 2)
    outputs, state = np.empty_like(voltages), np.full(2, 0.011 * (280.0 + offsets_V[0]))
    middle = CHANGE_s * STEPS
    for part, piece in enumerate((slice(0, middle + 1), slice(middle, None))):
        elapsed_s = time_s[piece] - time_s[piece][0]
        driven = voltages[piece] + offsets_V[part]
        system = motion(disks[part])
        _, outputs[piece], states = lsim(system, driven, elapsed_s, state, interp=False)
        state = states[-1]
    return np.asarray(voltages), outputs


def lagged(signal: Array, *, held: bool) -> Array:
    """A signal after the λ filter, from rest."""
    time_s = np.arange(len(signal)) * STEP_s
    _, rising, _ = lsim(([1.0], [TAU_s, 1.0]), signal - signal[0], time_s, interp=not held)
    return np.asarray(signal[0] + rising)


@dataclass
class Seen:
    """What was seen of the estimator in each slow period."""

    estimator: LambdaEstimator
    values: list[list[float]] = field(default_factory=list)
    shown: list[list[float]] = field(default_factory=list)
    doubtful: list[bool] = field(default_factory=list)
    alarms: list[int] = field(default_factory=list)
    branches: list[int] = field(default_factory=list)
    decided: list[int] = field(default_factory=list)


def learn_course(voltages: Array, outputs: Array, spike: float = 0.0) -> Seen:
    noisy = outputs + 0.0
    y1, u1 = lagged(outputs, held=False), lagged(voltages, held=True)
    y2, u2 = lagged(y1, held=False), lagged(u1, held=False)
    random = np.random.default_rng(4)
    seen = Seen(LambdaEstimator(LEARNING, MOTOR, 2))
    for second in range(1, END_s):
        n = second * STEPS
        output = float(noisy[n] + NOISE * random.normal())
        output += spike if second == CHANGE_s else 0.0
        u = float(voltages[n - 1])
        learn_second(seen, output, [float(y1[n]), float(y2[n])], [u, float(u1[n]), float(u2[n])])
    return seen


def learn_second(seen: Seen, output: float, y: list[float], u: list[float]) -> None:
    estimator = seen.estimator
    learn_sample(estimator, 1.0, output, y, u)
    values = MOTOR.physical(*REGRESSION.model(estimator.estimate.theta))
    seen.values.append(values)
    seen.shown.append(estimator.shown_deviations(values))
    seen.doubtful.append(estimator.is_doubtful())
    seen.decided.append(estimator.decided)
    seen.branches.append(len(estimator.bank.branches))
    seen.alarms.append(estimator.detector.alarms)


def truth(disks: float) -> Array:
    return np.array([0.011, 11.7 * disks + 10.0, 117.0 * disks])


def error(values: list[float], disks: float) -> float:
    return float(np.max(np.abs(np.array(values) / truth(disks) - 1.0)))


@pytest.fixture
def other_load() -> Seen:
    return learn_course(*course((1.0, 2.5), (0.0, 0.0)))


@pytest.fixture
def torque() -> Seen:
    return learn_course(*course((2.0, 2.0), (0.0, -25.0)))


@pytest.fixture
def spike() -> Seen:
    return learn_course(*course((2.0, 2.0), (0.0, 0.0)), spike=0.02)


def test_another_load_is_noticed_and_learnt(other_load: Seen) -> None:
    assert error(other_load.values[CHANGE_s - 2], 1.0) < 0.05
    assert other_load.alarms[CHANGE_s - 2] == 0
    assert other_load.alarms[CHANGE_s + 30] >= 1
    assert max(other_load.branches[: CHANGE_s - 1]) == 1
    assert max(other_load.branches[CHANGE_s : CHANGE_s + 30]) > 1
    assert error(other_load.values[-1], 2.5) < 0.05


def test_a_torque_is_noticed_and_leaves_the_load_as_it_was(torque: Seen) -> None:
    assert torque.alarms[CHANGE_s - 2] == 0
    assert torque.alarms[CHANGE_s + 30] >= 1
    assert max(error(values, 2.0) for values in torque.values[CHANGE_s:]) < 0.1
    offset_V = REGRESSION.input_offset(torque.estimator.estimate.theta, 0.0)
    assert offset_V == pytest.approx(-25.0, rel=0.1)


def test_what_has_changed_is_decided(other_load: Seen, torque: Seen, spike: Seen) -> None:
    """Another load may look like a disturbance at first, a disturbance not like a load."""
    last = [one for one in other_load.decided[CHANGE_s - 1 :] if one][-1]
    assert last == LOAD
    assert {*torque.decided[CHANGE_s - 1 :]} == {0, DISTURBANCE}
    assert LOAD not in spike.decided[CHANGE_s - 1 :]


def test_an_offset_is_known_to_its_deviation(torque: Seen) -> None:
    estimator = torque.estimator
    estimator.shown_deviations(torque.values[-1])
    deviation_V = estimator.offset_deviation()
    assert abs(estimator.input_offset() + 25.0) < 4.0 * deviation_V
    assert deviation_V < 5.0


def test_a_spike_is_an_alarm_of_nothing_and_is_hardly_learnt(spike: Seen) -> None:
    before = list(spike.values[CHANGE_s - 2])
    assert spike.alarms[CHANGE_s - 2] == 0
    assert spike.alarms[CHANGE_s] >= 1
    assert spike.values[CHANGE_s + 40] == pytest.approx(before, rel=0.05)
    assert error(spike.values[-1], 2.0) < 0.05


def test_while_it_is_explained_the_load_is_in_doubt_and_shown_so(other_load: Seen) -> None:
    assert all(other_load.doubtful[CHANGE_s + 2 : CHANGE_s + 10])
    after = range(CHANGE_s + 3, CHANGE_s + 110)
    held = [
        np.abs(np.array(other_load.values[k]) - truth(2.5)) <= 3.0 * np.array(other_load.shown[k])
        for k in after
    ]
    assert np.mean(held) > 0.9


def parameters(disks: float, offset_V: float) -> Array:
    """θ of the motor, with an offset of the input and no initial state."""
    values = REGRESSION.theta_of(*MOTOR.realise(truth(disks).tolist()))
    return np.array([*values, 0.0, 0.0, values[2] * offset_V / LEARNING.input_scale])


@pytest.mark.parametrize(
    ("disks", "offsets_V"),
    [((1, 3), (0.0, 0.0)), ((3, 1), (-20.0, -20.0)), ((2, 2), (0.0, -20.0)), ((1, 2), (0.0, 15.0))],
)
def test_what_a_change_leaves_follows_from_the_change(
    disks: tuple[float, float], offsets_V: tuple[float, float]
) -> None:
    """What a change of θ leaves in the filters is known from the samples at the change."""
    voltages, outputs = course(disks, offsets_V)
    y, u = outputs / LEARNING.output_scale, voltages / LEARNING.input_scale
    y1, u1, one = lagged(y, held=False), lagged(u, held=True), np.ones_like(y)
    y2, u2 = lagged(y1, held=False), lagged(u1, held=False)
    plain = np.stack([-y1, -y2, u2, 0 * one, 0 * one, one], 1)
    lowered = np.stack([-y, -y1, u1, 0 * one, 0 * one, one], 1)
    new = parameters(disks[1], offsets_V[1])
    step, change = new - parameters(disks[0], offsets_V[0]), CHANGE_s * STEPS
    h = (np.arange(len(y)) - change)[change:] * STEP_s / TAU_s
    left = -(plain[change] @ step + h * (lowered[change] @ step)) * np.exp(-h)
    assert np.max(np.abs(left)) > 0.002
    np.testing.assert_allclose((y - plain @ new)[change:], left, atol=2e-5)


def two_branches(outputs: tuple[float, float]) -> tuple[Bank, ChangeDetector, Observation]:
    """A settled bank of two branches that predict these outputs, the first with the smaller P."""
    regression = Regression(replace(LEARNING, gate=0.0), MOTOR)
    bank, detector, sample = Bank(regression), ChangeDetector(), Observation(regression.size)
    detector.samples, detector.power = 100, 4e-6
    bank.branches.append(Branch(regression))
    sample.regressor[-1] = 1.0
    for one, output, variance in zip(bank.branches, outputs, (0.5, 40.0), strict=True):
        one.theta[:], one.diagonal[:], one.age = [0.0] * 5 + [output], [variance] * 6, 20
    return bank, detector, sample


@pytest.mark.parametrize("output", [0.0, 0.001, -0.003, 0.008])
def test_branches_are_weighed_by_the_densities_of_their_predictions(output: float) -> None:
    """With P in σ², what is predicted has the variance σ² (ρ + rᵀPr)/ρ of a forgetting filter."""
    bank, detector, sample = two_branches((0.0, 0.001))
    sample.target = output
    first, second = bank.branches
    rho, power = LEARNING.forgetting, detector.power
    first.predict_sample(sample)
    length = float(np.dot(sample.regressor, sample.regressor))
    bank.learn(detector, sample)
    deviations = [math.sqrt(power * (rho + variance * length) / rho) for variance in (0.5, 40.0)]
    expected = norm.logpdf(output, 0.001, deviations[1]) - norm.logpdf(output, 0.0, deviations[0])
    assert second.score - first.score == pytest.approx(expected, abs=1e-9)


def test_however_many_alarms_there_are_the_bank_keeps_its_size_and_its_estimate() -> None:
    bank, detector, sample = two_branches((0.0, 0.001))
    random = np.random.default_rng(3)
    for second in range(60):
        sample.time_s, sample.target = float(second), float(random.normal())
        bank.estimate.predict_sample(sample)
        bank.learn(detector, sample)
        assert 1 <= len(bank.branches) <= 12
        assert any(one is bank.estimate for one in bank.branches)
        assert max(one.score for one in bank.branches) == 0.0
    assert detector.alarms > 3


def test_a_branch_ends_when_it_is_improbable_and_not_before_ten_samples() -> None:
    bank, detector, sample = two_branches((0.0, 0.02))
    second = bank.branches[1]
    second.diagonal[:], second.age = [0.5] * 6, 0
    lengths = []
    for _ in range(12):
        bank.estimate.predict_sample(sample)
        sample.regressor[-1], second.theta[-1] = 1.0, 0.02
        bank.learn(detector, sample)
        lengths.append(len(bank.branches))
    assert lengths == [2] * 10 + [1] * 2


@pytest.mark.parametrize("age", [100, 151])
def test_an_estimate_of_any_age_that_falls_behind_is_still_followed(age: int) -> None:
    """Odds of e^5 change the estimate, and only clear odds end a branch."""
    for lead, changes in ((0.98, False), (1.02, True)):
        known = Bank(REGRESSION)
        before, other = known.estimate, Branch(REGRESSION)
        before.age, before.score, other.age, other.score = age, -lead * thresholds.RARE, 3, 0.0
        known.branches.append(other)
        assert known._choose() is changes
        assert known.estimate is (other if changes else before)
        assert any(one is before for one in known.branches)
