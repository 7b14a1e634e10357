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
    x = found(rows, aims)
    assert x == pytest.approx(best, abs=1e-6)
    assert np.all((x >= LOW) & (x <= HIGH))
