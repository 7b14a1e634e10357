"""Speed control of a motor onto whose shaft a second and a third disk drop (the paper's Fig. 9)."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

from adaptdrive.control.load import Load
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
from adaptdrive_sim.plants.coupling import CouplingParameters
from adaptdrive_sim.plants.motor import Motor, MotorParameters


def new_motor() -> Motor:
    """Return a motor with one disk, whose speed stays when the inertia changes."""
    return Motor(MotorParameters())


def new_motor_with_momentum() -> Motor:
    """Return a motor with one disk; each further one is at rest when it lands on the shaft."""
    return Motor(MotorParameters(dropped_at_rest=True))


@cache
def true_motor(size: float) -> Load:
    """The motor's model with that many disks."""
    coupling = CouplingParameters()
    model = Motor(MotorParameters(), round(size)).model(coupling.ratio, coupling.droop_Ohm)
    return motor_load(model["gain"], model["tau_motor_s"], model["tau_filter_s"])


def nominal_motor() -> Load:
    """One disk, as the paper measured it."""
    return motor_load(gain=0.011, tau_motor_s=11.7, tau_filter_s=10.0)


def tables() -> dict[str, Any]:
    """The example configuration of the daemon."""
    return example_tables("motor.toml")


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
    tables=tables,
    nominal=nominal_motor,
    plant=new_motor,
    true_load=true_motor,
)
"""The experiment with a speed that stays: the change of the load is the only disturbance."""

DROPPED = replace(MOTOR, plant=new_motor_with_momentum, dropped=True)
"""The published experiment: weights dropped onto the turning shaft share its momentum."""
