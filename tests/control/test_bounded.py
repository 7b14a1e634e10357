"""A quadratic function within limits, against scipy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from adaptdrive.control.bounded import minimise

LOW, HIGH = -1.0, 2.0


def problem(seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows of a least-squares problem with decaying influence, as moves further ahead have it."""
    generator = np.random.default_rng(seed)
    rows = generator.standard_normal((count + 8, count)) * 0.6 ** np.arange(count)
    return rows, 3.0 * generator.standard_normal(count + 8)


def found(rows: np.ndarray, aims: np.ndarray) -> np.ndarray:
    flat = (rows.T @ rows).ravel().tolist()
    return np.array(minimise(flat, (rows.T @ aims).tolist(), LOW, HIGH))


@given(st.integers(0, 10**6), st.integers(1, 8))
def test_it_is_the_bounded_least_squares(seed: int, count: int) -> None:
    rows, aims = problem(seed, count)
    best = lsq_linear(rows, aims, (LOW, HIGH), method="bvls", tol=1e-14).x
    assert found(rows, aims) == pytest.approx(best, abs=1e-6)


@given(st.integers(0, 10**6))
def test_it_never_leaves_the_limits(seed: int) -> None:
    rows, aims = problem(seed, 6)
    x = found(rows, 100.0 * aims)
    assert np.all((x >= LOW) & (x <= HIGH))


def test_within_the_limits_it_is_plain_least_squares() -> None:
    rows, aims = problem(1, 6)
    best = np.linalg.lstsq(rows, 0.01 * aims, rcond=None)[0]
    assert np.all(np.abs(best) < 1.0)
    assert found(rows, 0.01 * aims) == pytest.approx(best, abs=1e-9)
