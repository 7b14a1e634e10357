"""Forgetting beside a random walk, against dense matrices and the Kalman filter of a textbook."""

from __future__ import annotations

import numpy as np
import pytest

from adaptdrive.control.estimation.rls import Estimate
from tests.unit.control.learning import dense
from tests.unit.control.systems import Array

COVARIANCE = 100.0
Filter = tuple[Array, Array]


class Beside:
    """An estimate whose last entries follow a random walk."""

    def __init__(self, size: int, walks: int, walk: float, forgetting: float, gate: float) -> None:
        self.walks, self.walk, self.forgetting, self.gate = walks, walk, forgetting, gate
        self.own = Estimate(size)
        self.own.open_up(COVARIANCE)

    def take(self, r: Array, target: float) -> None:
        self.own.update_beside(r.tolist(), target, self.forgetting, self.gate, self.walks)
        for i in range(len(r) - self.walks, len(r)):
            self.own.widen_entry(i, self.walk**2)


def kalman(filter_: Filter, r: Array, target: float, process: Array) -> Filter:
    """Measurement update and time update of a random walk (Ljung 1999, section 11.2)."""
    theta, p = filter_
    gain = p @ r / (1.0 + r @ p @ r)
    return theta + gain * (target - r @ theta), p - np.outer(gain, r @ p) + process


def forgotten(p: Array, r: Array, walks: int, forgetting: float) -> Array:
    """P after forgetting in the density of d alone, by its definition.

    d has the covariance P_dd, w = G d + what is left with covariance C. With w incremental out a
    sample is r̃ᵀd plus noise. Kulhavy's forgetting of d keeps all but (1 - ρ) of the information
    along r̃: P_dd⁻¹ ← P_dd⁻¹ - (1 - ρ) r̃ r̃ᵀ/(r̃ᵀ P_dd r̃).
    """
    d = len(r) - walks
    p_dd, g = p[:d, :d], np.linalg.solve(p[:d, :d], p[:d, d:]).T
    left = p[d:, d:] - g @ p_dd @ g.T
    seen = r[:d] + g.T @ r[d:]
    information = np.linalg.inv(p_dd)
    information -= (1.0 - forgetting) * np.outer(seen, seen) / (seen @ p_dd @ seen)
    wide = np.linalg.inv(information)
    return np.block([[wide, wide @ g.T], [g @ wide, g @ wide @ g.T + left]])


def drifting(count: int, walk: float, jump: int) -> tuple[Array, Array, Array, Array]:
    """Regressors (two that move, a 1), targets with noise of deviation 1, dynamics and bias."""
    random = np.random.default_rng(20)
    r = np.column_stack([random.normal(size=(count, 2)) * 3.0, np.ones(count)])
    dynamics = np.where(np.arange(count)[:, None] < jump, [2.0, -1.0], [1.0, -3.0])
    bias = np.cumsum(random.normal(size=count) * walk)
    return r, np.sum(r[:, :2] * dynamics, axis=1) + bias + random.normal(size=count), dynamics, bias


@pytest.mark.parametrize("walks", [1, 2])
def test_without_forgetting_it_is_the_kalman_filter_of_a_random_walk(walks: int) -> None:
    random = np.random.default_rng(walks)
    found, expected = Beside(5, walks, 0.3, 1.0, 0.0), (np.zeros(5), COVARIANCE * np.eye(5))
    process = np.diag([0.0] * (5 - walks) + [0.09] * walks)
    for _ in range(200):
        r, target = random.normal(size=5), float(random.normal())
        found.take(r, target)
        expected = kalman(expected, r, target, process)
    assert found.own.theta == pytest.approx(expected[0], rel=1e-7, abs=1e-9)
    assert np.allclose(dense(found.own), expected[1], rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("walks", [1, 2])
def test_what_does_not_walk_is_forgotten_as_if_the_rest_were_integrated_out(walks: int) -> None:
    random = np.random.default_rng(10 + walks)
    found, expected = Beside(5, walks, 0.3, 0.97, 0.0), (np.zeros(5), COVARIANCE * np.eye(5))
    process = np.diag([0.0] * (5 - walks) + [0.09] * walks)
    for _ in range(200):
        r, target = random.normal(size=5), float(random.normal())
        found.take(r, target)
        wide = forgotten(expected[1], r, walks, 0.97)
        expected = kalman((expected[0], wide), r, target, process)
    assert found.own.theta == pytest.approx(expected[0], rel=1e-7, abs=1e-9)
    assert np.allclose(dense(found.own), expected[1], rtol=1e-7, atol=1e-12)


def test_eight_hours_at_rest_widen_nothing_but_the_walk() -> None:
    found = Beside(4, 1, 0.2, 0.97, 1.2)
    random = np.random.default_rng(5)
    for _ in range(100):
        found.take(np.append(random.normal(size=3), 1.0), float(random.normal()))
    known = np.diag(dense(found.own))[:3].copy()
    for _ in range(30_000):
        found.take(np.array([1.0, -1.0, 0.5, 1.0]), float(random.normal()))
    assert np.all(np.diag(dense(found.own))[:3] < 10.0 * known)
    assert all(np.isfinite(found.own.theta))


def test_a_walk_is_followed_and_a_change_of_the_rest_is_learnt() -> None:
    r, targets, dynamics, bias = drifting(1000, 0.5, 500)
    found = Beside(3, 1, 0.5, 0.97, 0.0)
    errors: list[Array] = []
    claimed: list[Array] = []
    biases: list[float] = []
    for sample, target in zip(r, targets, strict=True):
        found.take(sample, float(target))
        errors.append(np.array(found.own.theta[:2]) - dynamics[len(errors)])
        claimed.append(np.sqrt(np.diag(dense(found.own))[:2]))
        biases.append(found.own.theta[2])
    off, sure = np.abs(np.array(errors)), np.array(claimed)
    for settled in (slice(100, 500), slice(650, 1000)):
        assert np.mean(off[settled] < 2.0 * sure[settled]) > 0.85
        assert np.max(off[settled]) < 0.5
    assert np.sqrt(np.mean((np.array(biases) - bias)[650:] ** 2)) < 1.0


def test_forgetting_along_the_sample_alone_would_keep_the_old_dynamics() -> None:
    r, targets, dynamics, _ = drifting(1000, 0.5, 500)
    along, beside = Estimate(3), Beside(3, 1, 0.5, 0.97, 0.0)
    along.open_up(COVARIANCE)
    for sample, target in zip(r, targets, strict=True):
        along.update_beside(sample.tolist(), float(target), 0.97, 0.0, 0)
        along.widen_entry(2, 0.25)
        beside.take(sample, float(target))
    wrong = [np.abs(np.array(one.theta[:2]) - dynamics[-1]) for one in (along, beside.own)]
    sure = np.sqrt(np.diag(dense(along))[:2])
    assert np.all(wrong[0] > 25.0 * sure)
    assert np.all(wrong[1] < 0.1)


@pytest.mark.parametrize(("gate", "limit"), [(2.0, 0.06), (40.0, 0.5)])
@pytest.mark.parametrize("share", [0.999, 1.001])
def test_a_sample_teaches_the_dynamics_from_its_limit_on(
    gate: float, limit: float, share: float
) -> None:
    """With a diagonal P: x = r_d² P_dd, c = r_w² P_ww, and the limit is a share of 1 + c."""
    one = Beside(2, 1, 0.0, 0.97, gate)
    p_d, p_w, r_w = 0.25, 2.0, 1.5
    one.own.diagonal[:] = p_d, p_w
    noise = 1.0 + r_w**2 * p_w
    r = np.array([np.sqrt(share * limit * noise / p_d), r_w])
    one.take(r, 1.0)
    if share > 1.0:
        assert one.own.theta[0] > 0.0
        assert dense(one.own)[0, 0] != pytest.approx(p_d, rel=1e-6)
        return
    assert one.own.theta == pytest.approx([0.0, p_w * r_w / noise])
    assert dense(one.own)[0, 0] == pytest.approx(p_d, rel=1e-9)
