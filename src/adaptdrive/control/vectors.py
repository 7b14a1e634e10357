"""Small dense algebra over flat sequences of floats.

The numerical kernels of this package are plain functions over floats and flat vectors: the
interpreter runs them, and mypyc compiles the very same source. A matrix is a flat vector in row
order. A `Vector` is a list, which is faster than an array at these sizes.
"""

import math

Vector = list[float]


def exceeds(value: float, limit: float) -> bool:
    """Return whether a value is above a limit, or no number."""
    return not value <= limit


def reaches(value: float, limit: float) -> bool:
    """Return whether a value is at a limit, above it, or no number."""
    return not value < limit


def lacks(value: float, least: float) -> bool:
    """Return whether a value is not above the least one, or no number."""
    return not value > least


def copy_into(target: Vector, source: Vector) -> None:
    """Overwrite the first entries of `target` with `source`."""
    for i in range(len(source)):
        target[i] = source[i]


def unit(size: int, index: int) -> Vector:
    """Return the unit vector along one entry."""
    direction = [0.0] * size
    direction[index] = 1.0
    return direction


def identity(size: int) -> Vector:
    """Return the unit matrix, flat."""
    matrix = [0.0] * (size * size)
    for i in range(size):
        matrix[i * size + i] = 1.0
    return matrix


def shift_in(history: Vector, value: float) -> None:
    """Make `value` the newest (first) entry of a history; the oldest one goes."""
    for i in range(len(history) - 1, 0, -1):
        history[i] = history[i - 1]
    history[0] = value


def all_finite(values: Vector) -> bool:
    """True when no entry is NaN or infinite."""
    return all(math.isfinite(value) for value in values)


def total(values: Vector) -> float:
    """Sum of the entries: a polynomial's value at 1."""
    result = 0.0
    for value in values:
        result += value
    return result


def dot(left: Vector, right: Vector) -> float:
    """Sum of the products of two vectors."""
    result = 0.0
    for i in range(len(left)):
        result += left[i] * right[i]
    return result


def multiply(left: Vector, right: Vector) -> Vector:
    """Product of two polynomials given by their coefficients."""
    product = [0.0] * (len(left) + len(right) - 1)
    for i in range(len(left)):
        factor = left[i]
        for j in range(len(right)):
            product[i + j] += factor * right[j]
    return product


def follow(polynomial: Vector, past: Vector, inputs: Vector) -> Vector:
    """Return a course, oldest first, and its continuation behind 1/polynomial in q^-1.

    Args:
        polynomial: Coefficients, the first one 1.
        past: The course so far, newest first, no shorter than the polynomial less one.
        inputs: What the polynomial makes of the continuation, oldest first.
    """
    values = past[::-1] + inputs
    for k in range(len(past), len(values)):
        result = values[k]
        for j in range(1, len(polynomial)):
            result -= polynomial[j] * values[k - j]
        values[k] = result
    return values


def solve_linear(matrix: Vector, right: Vector) -> Vector:
    """Solve M x = b by elimination with partial pivoting.

    Args:
        matrix: M, flat, n by n; overwritten.
        right: b, n entries; overwritten.

    Returns:
        x, or NaNs where M is singular.
    """
    return substitute(matrix, eliminate(matrix, len(right)), right)


def eliminate(matrix: Vector, size: int) -> Vector:
    """Bring a matrix into the form that `substitute` solves for any right side.

    Args:
        matrix: M, flat, n by n; overwritten by its factors L below the diagonal, and U.
        size: n.

    Returns:
        The row that changes places with each row; NaNs where M is singular.
    """
    pivots = [0.0] * size
    for column in range(size):
        pivot = _pivot_row(matrix, column, size)
        if lacks(abs(matrix[pivot * size + column]), 0.0):
            return [math.nan] * size
        pivots[column] = pivot
        _swap_rows(matrix, size, pivot, column)
        for row in range(column + 1, size):
            factor = matrix[row * size + column] / matrix[column * size + column]
            matrix[row * size + column] = factor
            for j in range(column + 1, size):
                matrix[row * size + j] -= factor * matrix[column * size + j]
    return pivots


def _pivot_row(matrix: Vector, column: int, size: int) -> int:
    best = column
    for row in range(column + 1, size):
        if abs(matrix[row * size + column]) > abs(matrix[best * size + column]):
            best = row
    return best


def _swap_rows(matrix: Vector, size: int, one: int, other: int) -> None:
    for j in range(size):
        a, b = one * size + j, other * size + j
        matrix[a], matrix[b] = matrix[b], matrix[a]


def substitute(matrix: Vector, pivots: Vector, right: Vector) -> Vector:
    """Solve M x = b.

    Args:
        matrix: What `eliminate` has made of M.
        pivots: What it has returned.
        right: b, n entries; overwritten.

    Returns:
        x, or NaNs where M is singular.
    """
    size = len(right)
    if math.isnan(pivots[0]):
        return [math.nan] * size
    for row in range(size):
        pivot = int(pivots[row])
        right[row], right[pivot] = right[pivot], right[row]
    for column in range(size):
        for row in range(column + 1, size):
            right[row] -= matrix[row * size + column] * right[column]
    solution = [0.0] * size
    for row in range(size - 1, -1, -1):
        rest = right[row]
        for j in range(row + 1, size):
            rest -= matrix[row * size + j] * solution[j]
        solution[row] = rest / matrix[row * size + row]
    return solution


def is_stable(polynomial: Vector, radius: float) -> bool:
    """True when every root of z^n + c1 z^(n-1) + ... + cn lies inside a circle about 0.

    The Schur-Cohn recursion (Astrom and Wittenmark, Computer-Controlled Systems, section 3.3).

    Args:
        polynomial: Coefficients, highest power first, the first one nonzero.
        radius: Radius of the circle.
    """
    order = len(polynomial) - 1
    row = [polynomial[i] / polynomial[0] / radius**i for i in range(order + 1)]
    for degree in range(order, 0, -1):
        reflection = row[degree] / row[0]
        if reaches(abs(reflection), 1.0):
            return False
        for i in range(degree // 2 + 1):
            first, last = row[i], row[degree - i]
            row[i] = first - reflection * last
            row[degree - i] = last - reflection * first
    return True
