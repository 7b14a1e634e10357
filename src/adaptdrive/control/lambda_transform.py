"""Between a continuous-time model and its λ-transformed parameters, for any order.

With p = (1 - λ)/(λ τ_λ) the model (4)

    H(s) = (b_0 s^m + b_1 s^(m-1) + ... + b_m) / (s^m + a_1 s^(m-1) + ... + a_m)

becomes (7)

    y + α_1 λy + ... + α_m λ^m y = β_0 u + β_1 λu + ... + β_m λ^m u

    α_j = Σ_(i<=j) a_i τ_λ^i C(m-i, j-i) (-1)^(j-i)          a_0 = 1, and β from b in the same way
    a_i = τ_λ^-i Σ_(j<=i) α_j C(m-j, i-j)                    α_0 = 1, and b from β in the same way

(multiply the model by λ^m and collect powers of λ; back: put λ = 1/(τ_λ s + 1) and collect powers
of s). For the motor this is (30), with a direct term β_0 and any order besides.
"""

from __future__ import annotations

from adaptdrive.control.vectors import Vector


def to_lambda(coefficients: Vector, tau_lambda_s: float) -> Vector:
    """α (or β) of a polynomial in s.

    Args:
        coefficients: c_0 ... c_m, highest power of s first.
        tau_lambda_s: Time constant of the λ filters.

    Returns:
        The m + 1 coefficients of λ^0 ... λ^m.
    """
    order = len(coefficients) - 1
    result = [0.0] * (order + 1)
    for j in range(order + 1):
        for i in range(j + 1):
            sign = -1.0 if (j - i) % 2 else 1.0
            result[j] += sign * binomial(order - i, j - i) * tau_lambda_s**i * coefficients[i]
    return result


def from_lambda(coefficients: Vector, tau_lambda_s: float) -> Vector:
    """The polynomial in s whose λ transform is given: the inverse of `to_lambda`."""
    order = len(coefficients) - 1
    result = [0.0] * (order + 1)
    for i in range(order + 1):
        for j in range(i + 1):
            result[i] += binomial(order - j, i - j) * coefficients[j]
        result[i] /= tau_lambda_s**i
    return result


def binomial(n: int, k: int) -> float:
    """Number of ways to choose k out of n, as a float."""
    result = 1.0
    for i in range(1, k + 1):
        result = result * (n - k + i) / i
    return result
