"""Recursive least squares against batch least squares and the textbook recursion."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.control.estimation.rls import COVARIANCE_CEILING, Estimate
from tests.unit.control.learning import dense
from tests.unit.control.systems import Array


def fresh(size: int, covariance: float = 1e4) -> Estimate:
    """θ = 0, and the same P whatever it was before."""
    own = Estimate(size)
    own.upper[:], own.diagonal[:] = [9.0] * (size * size), [9.0] * size
    own.open_up(covariance)
    return own


def learnt(own: Estimate, regressors: Array, targets: Array, forgetting: float = 1.0) -> Estimate:
    """The same estimate after more samples."""
    for r, y in zip(regressors.tolist(), targets.tolist(), strict=True):
        own.update(r, y, forgetting)
    return own


def is_sound(own: Estimate) -> bool:
    positive = all(d > 0.0 and math.isfinite(d) for d in own.diagonal)
    return positive and bool(np.isfinite([*own.upper, *own.theta]).all())


def textbook(
    regressors: Array, targets: Array, covariance: float, forgetting: float
) -> tuple[Array, Array]:
    """Equation (3), as printed."""
    size = regressors.shape[1]
    theta, p = np.zeros(size), covariance * np.eye(size)
    for r, y in zip(regressors, targets, strict=True):
        error = y - r @ theta
        gain = p @ r / (forgetting + r @ p @ r)
        theta += gain * error
        p = (p - np.outer(gain, r @ p)) / forgetting
    return theta, p


def data(size: int, count: int) -> tuple[Array, Array]:
    random = np.random.default_rng(size)
    regressors = random.normal(size=(count, size)) * random.uniform(0.3, 3.0, size)
    return regressors, regressors @ random.normal(size=size) + 0.1 * random.normal(size=count)


@pytest.mark.parametrize("size", [1, 2, 3, 5, 8])
def test_without_forgetting_it_is_regularised_batch_least_squares(size: int) -> None:
    regressors, targets = data(size, 80)
    recursive = learnt(fresh(size), regressors, targets)
    prior = np.eye(size) / math.sqrt(1e4)
    stacked = np.vstack([prior, regressors])
    batch, *_ = np.linalg.lstsq(stacked, np.concatenate([np.zeros(size), targets]))
    assert recursive.theta == pytest.approx(batch, rel=1e-9)
    assert np.allclose(dense(recursive), np.linalg.inv(stacked.T @ stacked), rtol=1e-9)


@pytest.mark.parametrize("forgetting", [0.9, 0.97, 0.99, 1.0])
@pytest.mark.parametrize("size", [2, 3, 6])
def test_with_good_excitation_it_is_the_textbook_recursion(size: int, forgetting: float) -> None:
    regressors, targets = data(size, 400)
    recursive = learnt(fresh(size), regressors, targets, forgetting)
    theta, p = textbook(regressors, targets, 1e4, forgetting)
    assert recursive.theta == pytest.approx(theta, rel=1e-9)
    assert np.abs(dense(recursive) - p).max() <= 1e-9 * np.abs(p).max()


def test_forgetting_weighs_the_past_exponentially() -> None:
    regressors, targets = data(3, 60)
    recursive = learnt(fresh(3, 1e9), regressors, targets, 0.9)
    root = 0.9 ** (0.5 * np.arange(59, -1, -1))
    batch, *_ = np.linalg.lstsq(regressors * root[:, None], targets * root)
    assert recursive.theta == pytest.approx(batch, rel=1e-6)


@given(st.lists(st.tuples(*[st.floats(-100.0, 100.0)] * 4), max_size=40), st.floats(0.9, 1.0))
def test_whatever_arrives_p_stays_positive_definite(
    samples: list[tuple[float, float, float, float]], forgetting: float
) -> None:
    recursive = fresh(3)
    for *regressor, target in samples:
        recursive.update(regressor, target, forgetting)
        assert is_sound(recursive)
        recursive.predict(regressor, target)
        assert recursive.excitation >= 0.0


POOR: dict[str, Callable[[int], Array]] = {
    "nothing": lambda _: np.zeros(3),
    "one direction": lambda _: np.array([-3.0, -3.0, 280.0]),
    "one direction and rounding noise": lambda n: np.array(
        [-3.0 + 1e-13 * math.sin(n), -3.0 + 1e-13 * math.cos(3 * n), 280.0]
    ),
    "very weak": lambda n: 1e-9 * np.array([math.sin(n), math.cos(n), 1.0]),
    "a burst now and then": lambda n: (
        np.array([-3.0, -3.0, 280.0]) if n % 5000 else np.array([-3.2, -3.1, 300.0])
    ),
}


@pytest.mark.parametrize("kind", POOR)
def test_p_stays_positive_definite_and_finite_without_excitation(kind: str) -> None:
    recursive, target = fresh(3), np.array([-1.8, 0.8, 0.011])
    regressors = np.array([POOR[kind](n) for n in range(30_000)])
    learnt(recursive, regressors, regressors @ target, 0.97)
    assert is_sound(recursive)
    assert max(recursive.diagonal) <= COVARIANCE_CEILING
    regressors, _ = data(3, 600)
    learnt(recursive, regressors, regressors @ target, 0.97)
    assert recursive.theta == pytest.approx(target, rel=1e-6)


def test_the_textbook_recursion_breaks_where_the_factored_one_does_not() -> None:
    regressors = np.tile([-3.0, -3.0, 280.0], (60_000, 1))
    with np.errstate(all="ignore"):
        _, p = textbook(regressors, np.zeros(len(regressors)), 1e4, 0.97)
    assert not np.isfinite(p).all()


@pytest.mark.proof
def test_p_stays_positive_definite_after_ten_million_poor_updates() -> None:
    recursive, lowest = fresh(3), math.inf
    for n in range(10_000_000):
        wobble = 1e-12 * math.sin(0.1 * n)
        regressor = [-3.0 + wobble, -3.0 - wobble, 280.0]
        recursive.update(regressor, 3.0, 0.97)
        lowest = min(lowest, *recursive.diagonal)
    assert lowest > 0.0
    assert max(recursive.diagonal) <= COVARIANCE_CEILING
    assert is_sound(recursive)


def test_directional_forgetting_forgets_only_along_the_sample() -> None:
    """Information afterwards: Λ - (1 - ρ)/(rᵀPr) r rᵀ + r rᵀ."""
    random = np.random.default_rng(3)
    upper = np.triu(random.normal(size=(3, 3)), 1) + np.eye(3)
    diagonal, r = [2.0, 0.5, 3.0], random.normal(size=3)
    before = upper @ np.diag(diagonal) @ upper.T
    information = np.linalg.inv(before)
    information += (1.0 - (1.0 - 0.97) / (r @ before @ r)) * np.outer(r, r)
    own = Estimate(3)
    own.upper[:], own.diagonal[:] = upper.ravel().tolist(), diagonal
    own.theta[:] = [0.1, 0.2, 0.3]
    own.update_beside(r.tolist(), 1.5, 0.97, 0.0, 0)
    found = dense(own)
    np.testing.assert_allclose(np.linalg.inv(found), information, rtol=1e-9)
    gain = found @ r
    expected = np.array([0.1, 0.2, 0.3]) + gain * (1.5 - r @ [0.1, 0.2, 0.3])
    np.testing.assert_allclose(own.theta, expected, rtol=1e-9)
