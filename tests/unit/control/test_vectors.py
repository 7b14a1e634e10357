"""Dense algebra against numpy."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from adaptdrive.control.vectors import (
    all_finite,
    is_stable,
    multiply,
    solve_linear,
    total,
)

entries = st.floats(-10.0, 10.0)
polynomials = st.lists(entries, min_size=1, max_size=7)


@given(st.data(), st.integers(1, 8))
def test_solves_what_numpy_solves(data: st.DataObject, size: int) -> None:
    matrix = np.array([data.draw(entries) for _ in range(size * size)]).reshape(size, size)
    right = np.array([data.draw(entries) for _ in range(size)])
    assume(np.abs(matrix).max() > 1e-3)
    assume(np.linalg.cond(matrix) < 1e6)
    expected = np.linalg.solve(matrix, right)
    solution = solve_linear(matrix.ravel().tolist(), right.tolist())
    assert np.abs(solution - expected).max() <= 1e-8 * max(1.0, np.abs(expected).max())
    assert solve_linear([0.0, 1.0, 2.0, 0.0], [3.0, 4.0]) == [2.0, 3.0]  # 0 on the diagonal


@pytest.mark.parametrize(
    "matrix",
    [
        [0.0],
        [0.0, 0.0, 0.0, 0.0],
        [1.0, 2.0, 2.0, 4.0],
        [1.0, 0.0, 2.0, 0.0],
        [math.nan, 1.0, 1.0, 1.0],
    ],
)
def test_a_singular_matrix_gives_nan(matrix: list[float]) -> None:
    size = math.isqrt(len(matrix))
    assert all(math.isnan(x) for x in solve_linear(matrix, [1.0] * size))


@st.composite
def root_sets(draw: st.DrawFn) -> list[complex]:
    roots: list[complex] = []
    for _ in range(draw(st.integers(1, 4))):
        root = draw(st.floats(0.0, 1.8)) * np.exp(1j * draw(st.floats(0.0, math.pi)))
        roots += [root, root.conjugate()] if draw(st.booleans()) else [complex(root.real)]
    return roots


@given(root_sets(), st.sampled_from([0.5, 0.9, 0.9999, 1.0]), st.sampled_from([1.0, -3.0]))
def test_is_stable_says_whether_every_root_lies_inside(
    roots: list[complex], radius: float, scale: float
) -> None:
    largest = max(abs(root) for root in roots)
    assume(abs(largest / radius - 1.0) > 0.01)
    assert is_stable((scale * np.poly(roots).real).tolist(), radius) == (largest < radius)


@pytest.mark.parametrize(
    "polynomial", [[1.0, math.nan], [1.0, 0.0, math.inf], [1.0, 1e300, 1e300], [math.nan, 0.5]]
)
def test_what_is_not_a_number_is_not_stable(polynomial: list[float]) -> None:
    assert not is_stable(polynomial, 0.9)


@given(polynomials, polynomials)
def test_polynomials_multiply_and_add_up_as_those_of_numpy(
    left: list[float], right: list[float]
) -> None:
    assert np.allclose(multiply(left, right), np.convolve(left, right), rtol=1e-12, atol=1e-12)
    assert total(left) == pytest.approx(np.polyval(left, 1.0), abs=1e-12)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_all_finite_sees_every_entry(bad: float) -> None:
    assert all_finite([0.0, 1e308, -1e-308])
    assert not all_finite([0.0, bad, 0.0])
