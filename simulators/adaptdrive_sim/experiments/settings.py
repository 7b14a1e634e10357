"""Settings of the controller in an experiment, in the paper's design and in the exact one."""

from __future__ import annotations

import dataclasses
import math

from adaptdrive.app.settings import controller_settings
from adaptdrive.config.file import validate_configuration
from adaptdrive.control.methods import METHODS
from adaptdrive.control.settings import ControllerSettings, Jacket, Learning, Rates
from adaptdrive_sim.experiments.case import Design, Variant
from adaptdrive_sim.experiments.examples import FOLDER
from adaptdrive_sim.experiments.experiment import Experiment

_NEVER = 10**9
_METHODS = {"direct_rls": METHODS["rls"], "lm_rls": METHODS["lm-rls"]}


def case_settings(experiment: Experiment, variant: Variant, design: Design) -> ControllerSettings:
    """Settings of one controller of an experiment."""
    settings = daemon_settings(experiment)
    if design == "paper":
        settings = _as_printed(settings, experiment)
    method = _METHODS.get(variant, settings.learning.method)
    learning = dataclasses.replace(settings.learning, method=method)
    return dataclasses.replace(settings, learning=learning)


def daemon_settings(experiment: Experiment) -> ControllerSettings:
    """The daemon's default controller, for an experiment that starts at rest."""
    source = FOLDER / f"{experiment.name}.toml"
    settings = controller_settings(validate_configuration(experiment.tables(), source))
    learning = dataclasses.replace(settings.learning, settle_periods=0)
    jacket = dataclasses.replace(settings.jacket, warm_up_periods=_warm_up_periods(experiment))
    return dataclasses.replace(settings, learning=learning, jacket=jacket)


def _as_printed(settings: ControllerSettings, experiment: Experiment) -> ControllerSettings:
    """The paper's controller: one sample, a plain estimator, hardly any supervision."""
    paper, rates = experiment.paper, settings.rates
    learning = Learning(
        method=paper.method,
        forgetting=paper.forgetting,
        tau_lambda_s=paper.tau_lambda_s,
        dead_band=0.0,
        initial_covariance=paper.covariance,
        settle_periods=0,
        gate=0.0,
        output_scale=1.0,
        input_scale=1.0,
        start_at_nominal=False,
    )
    jacket = Jacket(
        warm_up_periods=_warm_up_periods(experiment),
        ratio_min=-math.inf,
        ratio_max=math.inf,
        patience_periods=_NEVER,
    )
    single = Rates(rates.ticks_per_period, rates.latency_ticks, 1, rates.nominal_tick_s)
    return ControllerSettings(
        exact=False, stage=settings.stage, rates=single, learning=learning, jacket=jacket
    )


def _warm_up_periods(experiment: Experiment) -> int:
    return round(experiment.paper.warm_up_s / experiment.period_s)
