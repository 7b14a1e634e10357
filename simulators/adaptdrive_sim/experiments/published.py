"""The paper's experiments.

A bath fills from 0.6 to 1.5 US gal (Fig. 4); a second and a third disk drop onto the shaft of a
motor (Fig. 9).
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial
from typing import Any

from adaptdrive.control.load import Load
from adaptdrive.control.loads.bath import bath_load
from adaptdrive.control.loads.motor import motor_load
from adaptdrive.control.methods import METHODS
from adaptdrive_sim.experiments.examples import example_tables
from adaptdrive_sim.experiments.experiment import (
    Experiment,
    LoadChange,
    PaperSettings,
    SweepSettings,
    square,
)
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


BATH = Experiment(
    name="bath",
    duration_s=10_800.0,
    reference=square(10.0, 13.0, 2400.0),
    period_s=20.0,
    pole=0.80,
    changes=(LoadChange(5400.0, 2.5, over_s=300.0),),
    noise=0.05 / 3.0,
    paper=PaperSettings(
        method=METHODS["rls"],
        forgetting=0.99,
        tau_lambda_s=100.0,
        covariance=1.0e4,
        warm_up_s=600.0,
    ),
    sweep=SweepSettings(
        forgetting=(0.90, 0.93, 0.95, 0.97, 0.98, 0.99, 0.995),
        tau_lambda_s=(10.0, 20.0, 40.0, 70.0, 100.0, 200.0, 400.0, 700.0, 1500.0, 3000.0),
        methods=("rls", "lm-rls"),
    ),
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


MOTOR = Experiment(
    name="motor",
    duration_s=1320.0,
    reference=square(3.0, 3.2, 120.0),
    period_s=1.0,
    pole=0.70,
    changes=(LoadChange(600.0, 2.0), LoadChange(960.0, 3.0)),
    noise=0.002,
    paper=PaperSettings(
        method=METHODS["lm-rls"],
        forgetting=0.97,
        tau_lambda_s=10.0,
        covariance=1.0e4,
        warm_up_s=90.0,
    ),
    sweep=SweepSettings(
        forgetting=(0.90, 0.93, 0.95, 0.96, 0.97, 0.98, 0.985, 0.99, 0.995),
        tau_lambda_s=(1.0, 2.0, 3.5, 5.0, 7.0, 10.0, 15.0, 25.0, 50.0, 100.0, 200.0),
        methods=("lm-rls",),
    ),
    tables=partial(example_tables, "motor.toml"),
    nominal=partial(motor_load, gain=0.011, tau_motor_s=11.7, tau_filter_s=10.0),
    plant=partial(Motor, MotorParameters()),
    true_load=true_motor,
)
"""The experiment with a speed that stays: the change of the load is the only disturbance."""

DROPPED = replace(MOTOR, plant=partial(Motor, MotorParameters(dropped_at_rest=True)), dropped=True)
"""The published experiment: weights dropped onto the turning shaft share its momentum."""
