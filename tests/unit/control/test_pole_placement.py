"""Pole placement against loops that are closed step by step, and the paper's closed forms."""

import math
from typing import Final

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.signal import cont2discrete

from adaptdrive.control.design.pole_placement import Plant, desired_polynomial
from adaptdrive.control.design.reference import lead_reference
from adaptdrive.control.loads.discretise import held_model
from adaptdrive.control.slow import control_law
from tests.unit.control.systems import (
    Array,
    System,
    distance,
    matrix_of,
    motor_system,
    place_poles,
    stable_systems,
)

DISKS = [1, 2, 3]


def loop_matrix(plant: Array, b: Array, c: Array, gains: list[float], taps: int) -> Array:
    """Transition matrix of a plant in state space under the control law.

    The state holds the plant, the past inputs and the past outputs.
    """
    order = len(plant)

    def step(z: Array) -> Array:
        x, inputs, outputs = z[:order], z[order : order + taps], z[order + taps :]
        seen = [float(c @ x), *outputs]
        u = control_law(gains, inputs.tolist(), seen, 0.0)
        return np.concatenate([plant @ x + b * u, [u], inputs[:-1], seen[:-1]])

    return matrix_of(step, order + taps + len(gains) - taps - 1)


def law_gains(r: list[float], s: list[float]) -> tuple[list[float], int]:
    return [*r[1:], *s], len(r) - 1


@pytest.mark.parametrize("disks", DISKS)
def test_the_exact_design_puts_the_poles_of_the_held_motor_at_070(disks: int) -> None:
    system = motor_system(disks)
    a, b, c, _, _ = cont2discrete(system.state_space(), 1.0, "zoh")
    model = held_model(system.numerator, system.denominator, 1.0, 0.0, 0.0)
    gains, taps = law_gains(*place_poles(*model, desired_polynomial(0.7, 4)))
    matrix = loop_matrix(a, b[:, 0], c[0], gains, taps)
    zeros = len(matrix) - 4
    assert distance(np.linalg.eigvals(matrix), [0.7] * 4 + [0.0] * zeros) < 1e-3
    expected = np.concatenate([np.poly([0.7] * 4), np.zeros(zeros)])
    assert np.allclose(np.poly(matrix), expected, atol=1e-8)


def published_gains(disks: int, pole: float) -> tuple[float, list[float], list[float]]:
    """x4/a2, h1...h3 and the model's a1, a2, b1: (28) with (25) as corrected."""
    fast, slow = math.exp(-0.1), math.exp(-1.0 / (11.7 * disks))
    a1, a2 = -(fast + slow), fast * slow
    b1 = 0.011 * (slow - fast) / (11.7 * disks - 10.0)
    _, x1, x2, x3, x4 = np.poly([pole] * 4)
    d1 = x4 / a2
    h1 = (x1 + d1 - a1 + 1.0) / b1
    h2 = (x2 + d1 * (a1 - 1.0) + a1 - a2) / b1
    h3 = (x3 + d1 * (a2 - a1) + a2) / b1
    return d1, [h1, h2, h3], [a1, a2, b1]


@pytest.mark.parametrize("disks", DISKS)
@pytest.mark.parametrize("pole", [0.5, 0.7, 0.85])
def test_it_is_the_papers_compensator_with_its_coefficients_corrected(
    disks: int, pole: float
) -> None:
    d1, h, (a1, a2, b1) = published_gains(disks, pole)
    r, s = place_poles([1.0, a1, a2], [0.0, b1, 0.0], desired_polynomial(pole, 4))
    assert r == pytest.approx([1.0, -(1.0 + d1), d1], rel=1e-9)
    assert s == pytest.approx(h, rel=1e-9)


@given(st.floats(-0.999, -0.3), st.floats(0.01, 100.0), st.floats(0.1, 0.95))
def test_for_a_first_order_load_it_is_the_bath_compensator(a1: float, b1: float, m: float) -> None:
    r, s = place_poles([1.0, a1], [0.0, b1], desired_polynomial(m, 2))
    assert r == [1.0, -1.0]
    assert desired_polynomial(m, 2) == pytest.approx([1.0, -2.0 * m, m * m], rel=1e-14)
    assert s == pytest.approx([(1.0 - 2.0 * m - a1) / b1, (m * m + a1) / b1], rel=1e-9, abs=1e-9)


@given(stable_systems(), st.sampled_from([0.0, 0.1, 0.6, 1.3]), st.floats(0.3, 0.9))
def test_any_load_gets_the_desired_polynomial_an_integrator_and_unit_gain(
    system: System, delay_s: float, pole: float
) -> None:
    a, b = held_model(system.numerator, system.denominator, 1.0, delay_s, 0.5)
    r, s = place_poles(a, b, desired_polynomial(pole, 2 * system.order))
    forward, back = np.convolve(a, r), np.convolve(b, s)
    loop = np.polyadd(forward[::-1], back[::-1])[::-1]
    wanted = np.zeros(len(loop))
    wanted[: 2 * system.order + 1] = np.poly([pole] * (2 * system.order))
    rounding = np.convolve(np.abs(a), np.abs(r)).max() + np.convolve(np.abs(b), np.abs(s)).max()
    assert np.abs(loop - wanted).max() <= 1e-12 * rounding
    assert abs(sum(r)) <= 1e-13 * sum(abs(x) for x in r)
    assert sum(s) * sum(b) == pytest.approx(sum(wanted), abs=1e-11 * rounding)
    assert np.isfinite([*r, *s]).all()
    assert np.allclose(Plant(a, b).closed([*r[1:], *s]), loop, rtol=0.0, atol=1e-14 * rounding)


@pytest.mark.parametrize(
    ("a", "b"),
    [
        ([1.0, -0.5], [0.0, 0.0]),
        ([1.0, -0.75, 0.125], [0.0, 1.0, -0.5]),
        ([1.0, -0.5], [0.0, math.nan]),
    ],
)
def test_a_load_that_cannot_be_controlled_gives_nan(a: list[float], b: list[float]) -> None:
    r, s = place_poles(a, b, desired_polynomial(0.7, 2))
    assert not np.isfinite([*r, *s]).all()


LIMITS_V: Final = (200.0, 400.0)


def test_a_lead_moves_a_step_of_the_reference_forward_and_leaves_the_rest() -> None:
    assert lead_reference(3.2, 3.0, 0.1) == pytest.approx(3.22)
    assert lead_reference(3.2, 3.2, 0.1) == 3.2


@given(stable_systems(), st.floats(0.3, 0.9), st.floats(-400.0, 400.0), st.floats(-10.0, 10.0))
def test_at_rest_any_gains_of_the_design_keep_the_input(
    system: System, pole: float, rest_input: float, rest_output: float
) -> None:
    a, b = held_model(system.numerator, system.denominator, 1.0, 0.1, 0.5)
    r, s = place_poles(a, b, desired_polynomial(pole, 2 * system.order))
    assume(all(map(math.isfinite, r)))  # a pole that a zero cancels has no gains
    inputs, outputs = [rest_input] * (len(r) - 1), [rest_output] * len(s)
    rounding = 1e-13 * sum(abs(x) for x in r) * (1.0 + abs(rest_input))
    assert control_law([*r[1:], *s], inputs, outputs, rest_output) == pytest.approx(
        rest_input, abs=rounding
    )


def limited_run(disks: int, *, remember_limited: bool) -> Array:
    """A jump of the reference far past the limits, on the held motor."""
    system = motor_system(disks)
    a, b, c, _, _ = cont2discrete(system.state_space(), 1.0, "zoh")
    r, s = place_poles(
        *held_model(system.numerator, system.denominator, 1.0, 0.0, 0.0),
        desired_polynomial(0.7, 4),
    )
    rest = 3.0 / 0.011
    x = np.linalg.solve(np.eye(2) - a, b[:, 0] * rest)
    inputs, outputs, trace = [rest] * (len(r) - 1), [3.0] * len(s), []
    for _ in range(120):
        outputs = [float(c[0] @ x), *outputs[:-1]]
        wanted = control_law([*r[1:], *s], inputs, outputs, 3.8)
        applied = min(max(wanted, LIMITS_V[0]), LIMITS_V[1])
        inputs = [applied if remember_limited else wanted, *inputs[:-1]]
        x = a @ x + b[:, 0] * applied
        trace.append(outputs[0])
    return np.array(trace)


@pytest.mark.parametrize("disks", [1, 2, 3])
def test_the_loop_comes_back_from_its_limits_because_it_remembers_what_was_applied(
    disks: int,
) -> None:
    recovered = limited_run(disks, remember_limited=True)
    wound_up = limited_run(disks, remember_limited=False)
    assert recovered[-1] == pytest.approx(3.8, abs=1e-3)
    assert recovered.max() - 3.8 < 0.04
    assert wound_up.max() - 3.8 > 2.0 * max(0.04, recovered.max() - 3.8)
