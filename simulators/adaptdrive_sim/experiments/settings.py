"""Settings of the controller in an experiment, in the paper's design and in the exact one.

Both are the daemon's: the paper's design is its `load.design = "paper"`.
"""

from __future__ import annotations

import dataclasses
from typing import Any

from adaptdrive.app.settings import controller_settings
from adaptdrive.config.file import validate_configuration
from adaptdrive.control.methods import METHODS
from adaptdrive.control.settings import ControllerSettings
from adaptdrive_sim.experiments.case import Design, Variant
from adaptdrive_sim.experiments.examples import FOLDER
from adaptdrive_sim.experiments.experiment import Experiment

_METHODS = {"direct_rls": METHODS["rls"], "lm_rls": METHODS["lm-rls"]}


def case_settings(experiment: Experiment, variant: Variant, design: Design) -> ControllerSettings:
    """Settings of one controller of an experiment."""
    exact = design == "exact"
    settings = daemon_settings(experiment) if exact else paper_settings(experiment)
    method = _METHODS.get(variant, settings.learning.method)
    learning = dataclasses.replace(settings.learning, method=method)
    return dataclasses.replace(settings, learning=learning)


def daemon_settings(experiment: Experiment) -> ControllerSettings:
    """The daemon's default controller, for an experiment that starts at rest."""
    settings = _from_tables(experiment, experiment.tables())
    learning = dataclasses.replace(settings.learning, settle_periods=0)
    jacket = dataclasses.replace(settings.jacket, warm_up_periods=_warm_up_periods(experiment))
    return dataclasses.replace(settings, learning=learning, jacket=jacket)


def paper_settings(experiment: Experiment) -> ControllerSettings:
    """The daemon's controller with the paper's design, and with the paper's numbers."""
    tables, paper = experiment.tables(), experiment.paper
    tables["load"]["design"] = "paper"
    tables["estimator"] = {
        "method": next(name for name, one in METHODS.items() if one is paper.method),
        "forgetting": paper.forgetting,
        "tau_lambda_s": paper.tau_lambda_s,
        "initial_covariance": paper.covariance,
    }
    tables["supervisor"] = {"warm_up_s": paper.warm_up_s}
    return _from_tables(experiment, tables)


def _from_tables(experiment: Experiment, tables: dict[str, Any]) -> ControllerSettings:
    source = FOLDER / f"{experiment.name}.toml"
    return controller_settings(validate_configuration(tables, source))


def _warm_up_periods(experiment: Experiment) -> int:
    return round(experiment.paper.warm_up_s / experiment.period_s)
