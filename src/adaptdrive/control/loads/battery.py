"""The battery: its admittance as seen from the boost voltage, and its charge.

Behind the dc/dc stage (N2, R_d) lie an EMF E, a series resistance R_0 and one relaxation element
R_1 || C_1. With R_s = R_d + R_0 the charging current y follows from

    H(s) = N2 (R_1 C_1 s + 1) / (R_s R_1 C_1 s + R_s + R_1),        y = H (v - E/N2)

H is proper but not strictly proper: a step of the voltage is a step of the current (direct term
β_0), and the EMF is a constant that the estimator needs a bias for.

The operator's set-point is the current. A slow integrator in front of the current loop lowers it
so that the terminal voltage stays at its limit,

    i_cv[k] = i_cv[k-1] + κ (V_max - V[k]) / R_0        0 <= i_cv <= set-point,

because one ampere less is R_0 volts less at the terminals. V comes from what is measured anyway,
V = N2 v_bst - R_d y. κ is small against the poles of the current loop, so that the two do not
meet. Charging is complete when the tapering current has stayed below its end value. A current that
leaves in one step, from several times that value, does not taper: the battery is disconnected.
A charge has a longest time, since a current that is measured too high never tapers to its end.
"""

from dataclasses import dataclass

from adaptdrive.control.loads import discretise, load
from adaptdrive.control.loads.load import Charging
from adaptdrive.control.thresholds import EARLIEST, WINDOW
from adaptdrive.control.vectors import Vector

# The battery: its driving-point admittance as seen from the boost voltage.

NAMES = ("direct_S", "gain_S", "tau_s")

PRODUCTS = {"series_resistance": {"direct_S": -1}, "resistance": {"gain_S": -1}}


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
        charging=charging,
        products=PRODUCTS,
        loss="emf",
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


# Charging: constant current until the terminal voltage is reached, then constant voltage.

TAPER_GAIN = 1.0 / WINDOW
"""κ: the taper follows a mean over a window, a twentieth of the way per slow period."""

_NEAR_LIMIT = 0.99
"""Share of the largest voltage that counts as reached: the taper never reaches all of it."""

ABOVE = 1.02
"""Terminal voltage that V_c may lead to, over V_max: the taper overshoots by less."""

_STEP = 4.0
"""Current, in end currents, that no taper loses in one slow period, even with a wrong R_0."""


@dataclass(slots=True)
class ChargeState:
    """State of the charger.

    Attributes:
        current_A: i_cv, the current that the voltage allows.
        ending_periods: Slow periods in a row below the end current.
        flowed_A: Last current that flowed, of those not below the end current; no more than was
            asked for.
        lasted_s: Time that the run has lasted, in every mode.
    """

    current_A: float
    ending_periods: int = 0
    flowed_A: float = 0.0
    lasted_s: float = 0.0


def begin_anew(state: ChargeState, current_A: float) -> None:
    """Begin a charge with the current that flows."""
    state.current_A = max(0.0, current_A)
    state.ending_periods, state.flowed_A = 0, 0.0


def terminal_voltage(charging: Charging, boost_voltage_V: float, current_A: float) -> float:
    """V at the battery's terminals."""
    return charging.turns_ratio * boost_voltage_V - charging.droop_Ohm * current_A


def proven_current(
    charging: Charging, current_A: float, boost_voltage_V: float, load_power_W: float
) -> float:
    """Return the current that lowers the terminals' voltage for certain.

    What the power from the boost capacitor cannot carry does not flow: a current that is measured
    too high must not raise the voltage of the battery.
    """
    carried_A = load_power_W / (charging.turns_ratio * max(boost_voltage_V, 1.0))
    return min(current_A, carried_A)


def boost_voltage(charging: Charging, share: float, current_A: float) -> float:
    """Return the v_bst at which the terminals are at a share of V_max, with a current into them."""
    dropped_V = charging.droop_Ohm * max(0.0, current_A)
    return (share * charging.voltage_max_V + dropped_V) / charging.turns_ratio


def taper(
    charging: Charging, state: ChargeState, setpoint_A: float, terminal_V: float, current_A: float
) -> float:
    """The current to ask for in this slow period.

    Args:
        charging: Limits.
        state: Overwritten.
        setpoint_A: The operator's current.
        terminal_V: V.
        current_A: y, for the end of the charge.
    """
    _note_flow(charging, state, setpoint_A, current_A)
    margin_V = charging.voltage_max_V - terminal_V
    allowed = state.current_A + TAPER_GAIN * margin_V / charging.internal_Ohm
    state.current_A = min(max(allowed, 0.0), setpoint_A)
    near = terminal_V >= _NEAR_LIMIT * charging.voltage_max_V
    tapers = allowed < setpoint_A  # a small set-point alone is not the end
    ending = near and tapers and max(state.current_A, current_A) < charging.end_current_A
    state.ending_periods = state.ending_periods + 1 if ending else 0
    return state.current_A


def _note_flow(charging: Charging, state: ChargeState, setpoint_A: float, current_A: float) -> None:
    """Keep the last current from before the end.

    The current lags what is asked for, which may be 0 while the current still tapers.
    """
    flows_A = min(state.current_A, current_A)
    if flows_A >= charging.end_current_A:
        state.flowed_A = flows_A
    elif current_A >= charging.end_current_A:
        state.flowed_A = min(state.flowed_A, current_A)
    state.flowed_A = min(state.flowed_A, setpoint_A)


def is_complete(charging: Charging, state: ChargeState) -> bool:
    """True when the battery is full: a decision, which noise alone must not bring about."""
    return _has_ended(state) and not is_disconnected(charging, state)


def is_disconnected(charging: Charging, state: ChargeState) -> bool:
    """True when the charge has ended because its current left in one step."""
    return _has_ended(state) and state.flowed_A > _STEP * charging.end_current_A


def is_too_long(charging: Charging, state: ChargeState) -> bool:
    """True when the charge has lasted for longer than it may."""
    return state.lasted_s > charging.longest_s


def _has_ended(state: ChargeState) -> bool:
    return state.ending_periods >= EARLIEST
