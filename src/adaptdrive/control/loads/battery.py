"""The battery: its driving-point admittance as seen from the boost voltage.

Behind the dc/dc stage (N2, R_d) lie an EMF E, a series resistance R_0 and one relaxation element
R_1 || C_1. With R_s = R_d + R_0 the charging current y follows from

    H(s) = N2 (R_1 C_1 s + 1) / (R_s R_1 C_1 s + R_s + R_1),        y = H (v - E/N2)

H is proper but not strictly proper: a step of the voltage is a step of the current (direct term
β_0), and the EMF is a constant that the estimator needs a bias for.
"""

from adaptdrive.control.loads import discretise, load
from adaptdrive.control.loads.charging import Charging
from adaptdrive.control.vectors import Vector

NAMES = ("direct_S", "gain_S", "tau_s")


def battery_load(
    turns_ratio: float,
    series_Ohm: float,
    relaxation_Ohm: float,
    relaxation_s: float,
    charging: Charging | None = None,
) -> load.Load:
    """A battery with the given nominal parameters.

    Args:
        turns_ratio: N2, secondary volts per boost volt.
        series_Ohm: R_s = R_d + R_0.
        relaxation_Ohm: R_1.
        relaxation_s: R_1 C_1.
        charging: How it is charged; None to hold the current whatever the voltage.
    """
    scale = series_Ohm * relaxation_s
    return load.Load(
        numerator=(turns_ratio / series_Ohm, turns_ratio / scale),
        denominator=(1.0, (series_Ohm + relaxation_Ohm) / scale),
        input_powers=(0, 1),
        input_gain=1.0,
        input_exponent=1,
        names=NAMES,
        physical=physical,
        realise=realise,
        paper_model=paper_model,
        paper_taps=2,
        charging=charging,
    )


def physical(numerator: Vector, denominator: Vector) -> Vector:
    """Direct admittance, dc admittance and time constant of a model."""
    return [numerator[0], numerator[1] / denominator[1], 1.0 / denominator[1]]


def realise(values: Vector) -> tuple[Vector, Vector]:
    """The model with given direct admittance, dc admittance and time constant."""
    return [values[0], values[1] / values[2]], [1.0, 1.0 / values[2]]


def paper_model(numerator: Vector, denominator: Vector, period_s: float) -> tuple[Vector, Vector]:
    """The step-invariant model; the direct term reaches the next sample, as one period's delay.

    A sample taken at the slow instant cannot contain the voltage that is computed from it, so the
    direct term acts one period later: B is that of the load delayed by a whole period.
    """
    return discretise.held_model(numerator, denominator, period_s, period_s, 0.0)
