"""The bath: a stirred volume of liquid, heated, with a constant cold inflow.

    H(s) = R / (R C s + 1)                                          eq. (11)

Where the sensor lags too, H has a second lag τ_s, which is kept in sum and product as a motor's is,
and a dead time. y is the temperature above that of the inflow. u is the power into the heater, a
square-law map of the boost voltage (8): p = N2² v² R_h / (R_d + R_h)², inverted by (9).
"""

from dataclasses import replace

from adaptdrive.control.loads import discretise, load, motor
from adaptdrive.control.vectors import Vector

NAMES = ("resistance_K_per_W", "tau_s")


def bath_load(
    resistance_K_per_W: float,
    tau_s: float,
    turns_ratio: float,
    droop_Ohm: float,
    heater_Ohm: float,
    lag_s: float = 0.0,
    delay_s: float = 0.0,
) -> load.Load:
    """A bath with the given nominal parameters.

    Args:
        resistance_K_per_W: R, thermal resistance to the inflow.
        tau_s: R C.
        turns_ratio: N2, secondary volts per boost volt.
        droop_Ohm: R_d of the dc/dc stage.
        heater_Ohm: R_h.
        lag_s: τ_s; 0 for a sensor that follows at once.
        delay_s: Dead time.
    """
    input_gain = turns_ratio**2 * heater_Ohm / (droop_Ohm + heater_Ohm) ** 2
    if lag_s > 0.0:
        lagging = motor.motor_load(resistance_K_per_W, tau_s, lag_s)
        names = (NAMES[0], *lagging.names[1:])
        return replace(
            lagging,
            input_gain=input_gain,
            input_exponent=2,
            names=names,
            delay_s=delay_s,
            products=_products("tau_product_s2"),
            loss="heat_loss",
        )
    return load.Load(
        numerator=(0.0, resistance_K_per_W / tau_s),
        denominator=(1.0, 1.0 / tau_s),
        input_powers=(1,),
        input_gain=input_gain,
        input_exponent=2,
        names=NAMES,
        physical=physical,
        realise=realise,
        paper_model=paper_model,
        delay_s=delay_s,
        products=_products("tau_s"),
        loss="heat_loss",
    )


def _products(lag: str) -> load.Products:
    """Heat capacity, with a sensor that lags times that lag, and conductance."""
    return {"heat_capacity": {lag: 1, NAMES[0]: -1}, "conductance": {NAMES[0]: -1}}


def physical(numerator: Vector, denominator: Vector) -> Vector:
    """R and R C of a model."""
    return [numerator[1] / denominator[1], 1.0 / denominator[1]]


def realise(values: Vector) -> tuple[Vector, Vector]:
    """The model with given R and R C."""
    return [0.0, values[0] / values[1]], [1.0, 1.0 / values[1]]


def paper_model(numerator: Vector, denominator: Vector, period_s: float) -> tuple[Vector, Vector]:
    """The step-invariant model (12)-(13)."""
    return discretise.held_model(numerator, denominator, period_s, 0.0, 0.0)
