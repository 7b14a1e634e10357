"""The motor: variable inertia, speed seen through a filtered tachometer.

    H(s) = g / ((τ_m s + 1)(τ_f s + 1))                             eq. (22)
         = (g/Π) / (s² + (S/Π) s + 1/Π)        S = τ_m + τ_f,  Π = τ_m τ_f

u is the boost voltage itself, so in the λ-transformed model (29) only λ²u enters. Everything is
kept in S and Π: with τ_λ near the time constants, noise makes the estimated pair complex about
every third time, and that is a legal model.
"""

from adaptdrive.control.loads.discretise import held_model
from adaptdrive.control.loads.load import Load
from adaptdrive.control.vectors import Vector

NAMES = ("gain", "tau_sum_s", "tau_product_s2")

PRODUCTS = {"inertia": {"tau_product_s2": 1, "gain": -1}, "damping": {"gain": -1}}
"""The inertia is τ_m times the damping R f + K², and the gain falls with that; while the filter
keeps its τ_f, Π does for τ_m."""


def motor_load(gain: float, tau_motor_s: float, tau_filter_s: float) -> Load:
    """A motor with the given nominal parameters.

    Args:
        gain: g_m, tachometer volts per boost volt.
        tau_motor_s: τ_m, mechanical time constant.
        tau_filter_s: τ_f, tachometer filter.
    """
    product = tau_motor_s * tau_filter_s
    return Load(
        numerator=(0.0, 0.0, gain / product),
        denominator=(1.0, (tau_motor_s + tau_filter_s) / product, 1.0 / product),
        input_powers=(2,),
        input_gain=1.0,
        input_exponent=1,
        names=NAMES,
        physical=physical,
        realise=realise,
        paper_model=paper_model,
        products=PRODUCTS,
        loss="friction",
    )


def physical(numerator: Vector, denominator: Vector) -> Vector:
    """g, τ_m + τ_f and τ_m τ_f of a model."""
    return [
        numerator[2] / denominator[2],
        denominator[1] / denominator[2],
        1.0 / denominator[2],
    ]


def realise(values: Vector) -> tuple[Vector, Vector]:
    """The model with given g, τ_m + τ_f and τ_m τ_f."""
    product = values[2]
    return [0.0, 0.0, values[0] / product], [1.0, values[1] / product, 1.0 / product]


def paper_model(numerator: Vector, denominator: Vector, period_s: float) -> tuple[Vector, Vector]:
    """The impulse-invariant model (24), with (25) as corrected.

    The response of H to an impulse is that of s H to a step. B keeps the trailing zero, so that
    the design has as many poles as the paper's.
    """
    a, b = held_model([*numerator[1:], 0.0], denominator, period_s, 0.0, 0.0)
    return a, [0.0, period_s * b[1], 0.0]
