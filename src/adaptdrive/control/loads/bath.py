"""The bath: a stirred volume of liquid, heated, with a constant cold inflow.

    H(s) = R / (R C s + 1)                                          eq. (11)

y is the temperature above that of the inflow. u is the power into the heater, a square-law map of
the boost voltage (8): p = N2² v² R_h / (R_d + R_h)², inverted by (9).
"""

from __future__ import annotations

from adaptdrive.control.discretise import exponential
from adaptdrive.control.load import Load
from adaptdrive.control.vectors import Vector

NAMES = ("resistance_K_per_W", "tau_s")


def bath_load(
    resistance_K_per_W: float,
    tau_s: float,
    turns_ratio: float,
    droop_Ohm: float,
    heater_Ohm: float,
) -> Load:
    """A bath with the given nominal parameters.

    Args:
        resistance_K_per_W: R, thermal resistance to the inflow.
        tau_s: R C.
        turns_ratio: N2, secondary volts per boost volt.
        droop_Ohm: R_d of the dc/dc stage.
        heater_Ohm: R_h.
    """
    return Load(
        numerator=(0.0, resistance_K_per_W / tau_s),
        denominator=(1.0, 1.0 / tau_s),
        input_powers=(1,),
        input_gain=turns_ratio**2 * heater_Ohm / (droop_Ohm + heater_Ohm) ** 2,
        input_exponent=2,
        names=NAMES,
        physical=physical,
        realise=realise,
        paper_model=paper_model,
        paper_taps=1,
    )


def physical(numerator: Vector, denominator: Vector) -> Vector:
    """R and R C of a model."""
    return [numerator[1] / denominator[1], 1.0 / denominator[1]]


def realise(values: Vector) -> tuple[Vector, Vector]:
    """The model with given R and R C."""
    return [0.0, values[0] / values[1]], [1.0, 1.0 / values[1]]


def paper_model(numerator: Vector, denominator: Vector, period_s: float) -> tuple[Vector, Vector]:
    """The step-invariant model (12)-(13)."""
    resistance, tau_s = physical(numerator, denominator)
    a1 = -exponential(-period_s / tau_s)
    return [1.0, a1], [0.0, resistance * (1.0 + a1)]
