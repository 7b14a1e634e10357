"""The control law at rest and at its limits."""

import math
from typing import Final

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.signal import cont2discrete

from adaptdrive.control.compensator import control_law, lead_reference
from adaptdrive.control.discretise import held_model
from adaptdrive.control.pole_placement import desired_polynomial, place_poles
from tests.control.systems import Array, System, motor_system, stable_systems

LIMITS_V: Final = (200.0, 400.0)


def test_it_is_the_difference_equation_that_it_states() -> None:
    gains = [-1.3, 0.3, 5.0, -2.0, 1.0]
    by_hand = 1.3 * 280.0 - 0.3 * 270.0 + 4.0 * 3.2 - (5.0 * 3.0 - 2.0 * 2.9 + 1.0 * 2.8)
    assert control_law(gains, [280.0, 270.0], [3.0, 2.9, 2.8], 3.2) == pytest.approx(by_hand)


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
