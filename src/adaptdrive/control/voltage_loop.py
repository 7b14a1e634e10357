"""The fast loop: makes the boost voltage follow V_c by scaling the line current.

The boost stage is linear in x = v_bst² whatever the size of the step:

    x[n+1] = x[n] + b k - (2 T / C) p            b = 2 T V_rms² / C

and a scale k computed from frame n acts from frame n+1 to n+2. In I-P form (the proportional part
acts on x alone, the sum S leaves out the present sample)

    b k[n] = Ki S[n] - Kp x[n] + (2 T / C) p[n]          S[n+1] = S[n] + x_ref[n] - x[n]

the closed loop is z³ - 2 z² + (1 + Kp) z + Ki - Kp; Kp = 1/3 and Ki = 1/27 make it (z - 2/3)³: no
overshoot, settled in 0.16 s at 60 Hz. The last term feeds the measured load power forward, and
dividing by the measured line voltage keeps the poles there on a weak or a strong line. The sum
stands still while k is limited and the error would drive it further into the limit.
"""

from fractions import Fraction

_POLE = Fraction(2, 3)
"""Pole of the closed loop, a triple one: whatever Kp and Ki are, the three add up to 2."""

PROPORTIONAL = float(3 * _POLE**2 - 1)
"""Kp: 1/3, for the loop has 1 + Kp before z, and 3 p² with three poles at p."""

INTEGRAL = float((1 - _POLE) ** 3)
"""Ki: 1/27, for the loop is Ki at z = 1."""

LAG_TICKS = float(3 / (1 - _POLE))
"""Mean delay of the closed loop in ticks: 9, 3 for each pole."""


def initial_sum(boost_voltage_V: float) -> float:
    """Return the sum S at which the current equals that of the load, at the present voltage."""
    return PROPORTIONAL / INTEGRAL * boost_voltage_V * boost_voltage_V


def current_scale(
    error_sum: float,
    boost_voltage_V: float,
    load_power_W: float,
    line_voltage_V: float,
    tick_period_s: float,
    capacitance_F: float,
) -> float:
    """The line-current scale k in siemens, before limits.

    Args:
        error_sum: S, in V².
        boost_voltage_V: v_bst of this frame.
        load_power_W: Load power to feed forward; 0 for none.
        line_voltage_V: Line voltage, rms.
        tick_period_s: T, half a line cycle.
        capacitance_F: C, boost capacitor.
    """
    square = boost_voltage_V * boost_voltage_V
    wanted = INTEGRAL * error_sum - PROPORTIONAL * square
    power_W = wanted * capacitance_F / (2.0 * tick_period_s) + load_power_W
    return power_W / (line_voltage_V * line_voltage_V)


def advance_sum(error_sum: float, reference_V: float, boost_voltage_V: float, limit: int) -> float:
    """S for the next frame.

    Args:
        error_sum: S.
        reference_V: V_c.
        boost_voltage_V: v_bst of this frame.
        limit: 1 when k is held at its upper limit, -1 at its lower one, 0 when it is free.
    """
    error = reference_V * reference_V - boost_voltage_V * boost_voltage_V
    if error * limit > 0.0:
        return error_sum
    return error_sum + error
