"""The paper's experiments.

A bath fills from 0.6 to 1.5 US gal (Fig. 4); a second and a third disk drop onto the shaft of a
motor (Fig. 9).
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial
from typing import Any

from adaptdrive.control.loads.bath import bath_load
from adaptdrive.control.loads.load import Load
from adaptdrive.control.loads.motor import motor_load
from adaptdrive_sim.experiments.examples import example_tables
from adaptdrive_sim.experiments.experiment import read_experiment
from adaptdrive_sim.plants.bath import Bath, BathParameters
from adaptdrive_sim.plants.coupling import CouplingParameters
from adaptdrive_sim.plants.motor import Motor, MotorParameters

NOMINAL_gal = 0.6


@cache
def true_bath(size: float) -> Load:
    """The bath's model at a multiple of its nominal volume."""
    coupling = CouplingParameters()
    bath = Bath(BathParameters(volume_gal=size * NOMINAL_gal))
    model = bath.model(coupling.ratio, coupling.droop_Ohm)
    return bath_load(
        model["resistance_K_per_W"],
        model["tau_s"],
        coupling.ratio,
        coupling.droop_Ohm,
        bath.resistance_Ohm,
    )


def _bath_tables() -> dict[str, Any]:
    """The example configuration of the daemon, with a bath in place of the motor."""
    found = example_tables("motor.toml")
    model = Bath(BathParameters(volume_gal=NOMINAL_gal)).model(0.25, 1.0)
    found["load"] = {
        "type": "bath",
        "period_s": 20.0,
        "pole": 0.80,
        "reference_max": 20.0,
        "model": {
            "resistance_K_per_W": model["resistance_K_per_W"],
            "tau_s": model["tau_s"],
            "turns_ratio": 0.25,
            "droop_Ohm": 1.0,
            "heater_Ohm": 7.87,
        },
    }
    found["estimator"] = {"method": "lm-rls", "forgetting": 0.99, "tau_lambda_s": 100.0}
    found["interlocks"]["output_max"] = 25.0
    return found


BATH = read_experiment(
    "bath",
    tables=_bath_tables,
    nominal=partial(true_bath, 1.0),
    plant=partial(Bath, BathParameters(volume_gal=NOMINAL_gal)),
    true_load=true_bath,
)


@cache
def true_motor(size: float) -> Load:
    """The motor's model with that many disks."""
    coupling = CouplingParameters()
    model = Motor(MotorParameters(), round(size)).model(coupling.ratio, coupling.droop_Ohm)
    return motor_load(model["gain"], model["tau_motor_s"], model["tau_filter_s"])


MOTOR = read_experiment(
    "motor",
    tables=partial(example_tables, "motor.toml"),
    nominal=partial(motor_load, gain=0.011, tau_motor_s=11.7, tau_filter_s=10.0),
    plant=partial(Motor, MotorParameters()),
    true_load=true_motor,
)
"""The experiment with a speed that stays: the change of the load is the only disturbance."""

DROPPED = replace(MOTOR, plant=partial(Motor, MotorParameters(dropped_at_rest=True)), dropped=True)
"""The published experiment: weights dropped onto the turning shaft share its momentum."""
