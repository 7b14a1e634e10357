"""Results of a complete experiment: the load, the settings, the predicted response."""

from __future__ import annotations

from pathlib import Path

from adaptdrive.app.loads import build_load, candidate_loads
from adaptdrive.commission.evaluate import evaluate
from adaptdrive.commission.experiment import LoadExperiment
from adaptdrive.commission.prediction import predict, rest_voltage
from adaptdrive.commission.proposal import propose
from adaptdrive.commission.report import Commissioned
from adaptdrive.commission.sensor import SensorState
from adaptdrive.config.root import Configuration
from adaptdrive.errors import CommissionError


def judged(
    sensor: SensorState, experiment: LoadExperiment, present: Configuration, text: str, path: Path
) -> Commissioned:
    """Return all results of an experiment.

    Args:
        sensor: The sensor at rest.
        experiment: One that is complete.
        present: The configuration with which it was done.
        text: The same as text.
        path: Its file, for messages.

    Raises:
        AdaptdriveError: The samples do not determine the load, or no settings suit it.
    """
    outcome = experiment.outcome
    if outcome is None:
        raise CommissionError("the experiment is not complete")
    load = build_load(present)
    identified = evaluate(experiment, candidate_loads(present))
    proposal = propose(identified, text, path, experiment.record.coarseness())
    rest_V = rest_voltage(outcome.low_V, outcome.high_V, load)
    prediction = predict(identified, proposal.configuration, rest_V, experiment.target.move)
    return Commissioned(sensor, outcome, identified, proposal, prediction, present)
