"""Temperature control of a bath that fills from 0.6 to 1.5 US gal (the paper's Fig. 4)."""

from __future__ import annotations

from functools import cache
from typing import Any

from adaptdrive.control.load import Load
from adaptdrive.control.loads.bath import bath_load
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

NOMINAL_gal = 0.6


def new_bath() -> Bath:
    """Return a bath filled to 0.6 gal."""
    return Bath(BathParameters(volume_gal=NOMINAL_gal))


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


def nominal_bath() -> Load:
    """The bath at 0.6 gal."""
    return true_bath(1.0)


def tables() -> dict[str, Any]:
    """The example configuration of the daemon, with a bath in place of the motor."""
    found = example_tables("motor.toml")
    model = new_bath().model(0.25, 1.0)
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
    tables=tables,
    nominal=nominal_bath,
    plant=new_bath,
    true_load=true_bath,
)
