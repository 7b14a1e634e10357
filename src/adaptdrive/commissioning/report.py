"""The results of commissioning: text, figure; and the experiment on a plant of the user."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from adaptdrive.analysis import closed_loop, record_load, style
from adaptdrive.analysis.figure import as_png
from adaptdrive.app import examine, loads
from adaptdrive.commissioning import course, evaluation
from adaptdrive.commissioning.course import build_target
from adaptdrive.commissioning.experiment import LoadExperiment
from adaptdrive.commissioning.proposal import Proposal, propose
from adaptdrive.config.file import read_text
from adaptdrive.config.root import Configuration
from adaptdrive.identification.result import IdentifiedLoad
from adaptdrive.util.errors import CommissionError

# The results of commissioning: load, settings and predicted response, as text and as a figure.


@dataclass(frozen=True, slots=True)
class Commissioned:
    """All results of an experiment.

    Attributes:
        sensor: The sensor at rest.
        outcome: Levels and movement of the test.
        load: The identified load.
        proposal: Proposed settings.
        prediction: Response of the proposed loop.
        before: The present configuration.
        refusal: Why the settings are not to be put to use, empty where they are.
    """

    sensor: evaluation.SensorState
    outcome: course.Outcome
    load: IdentifiedLoad
    proposal: Proposal
    prediction: evaluation.Prediction
    before: Configuration
    refusal: str = ""


def as_text(found: Commissioned) -> str:
    """Return the result as a table."""
    return "\n".join([*_checks(found), "", *_settings(found), "", *_loop(found)])


def _checks(found: Commissioned) -> Iterator[str]:
    sensor, outcome, load = found.sensor, found.outcome, found.load
    unit, given = found.before.load.output_unit, found.before.drive.given
    noise, resolution = f"noise {sensor.noise:.3g} {unit}", f"{sensor.resolution:.3g} {unit}"
    yield f"sensor          {noise}, resolution {resolution}"
    yield (
        f"test            {given.symbol} {outcome.low_V:.4g}…{given.text(outcome.high_V)} from "
        f"{outcome.rest:.4g} {unit}, time to rest {outcome.settling_s:.3g} s"
    )
    yield from record_load.checks(load, unit)
    yield from record_load.warnings(load)


def _settings(found: Commissioned) -> Iterator[str]:
    yield f"{'setting':<34}{'present':>12}{'proposed':>12}"
    for key, value in found.proposal.values.items():
        deviation = found.proposal.model.get(key.removeprefix("load.model."))
        margin = "" if deviation is None else f"  ± {deviation.std:.2g}"
        yield f"{key:<34}{_present(found.before, key):>12.5g}{value:>12.5g}{margin}"


def _present(configuration: Configuration, key: str) -> float:
    value: object = configuration
    for part in key.split("."):
        value = getattr(value, part)
    return float(value)  # type: ignore[arg-type]


def _loop(found: Commissioned) -> Iterator[str]:
    quality, margins = found.prediction.quality, found.proposal.margins
    overshoot, settling_s = 100.0 * quality.overshoot, quality.settling_s
    yield f"predicted overshoot {overshoot:.1f} %, settling {settling_s:.4g} s"
    yield f"gain margin {margins.gain:.3g}, delay margin {margins.delay_s:.3g} s"
    given = found.before.drive.given
    yield f"largest {given.name} after the step {given.text(quality.highest_V)}"
    if found.refusal:
        yield f"not to be applied: {found.refusal}"


def draw(found: Commissioned) -> bytes:
    """Draw the test with the simulated output, and the predicted response.

    Args:
        found: What to draw.

    Returns:
        A PNG.
    """
    load, prediction = found.load, found.prediction
    label = f"{found.before.load.output_name} ({found.before.load.output_unit or '1'})"
    with style.journal():
        figure = Figure(figsize=(style.WIDTH_in, 5.6), layout="constrained")
        test, response, volts = figure.subplots(3, 1, height_ratios=(1.4, 1.0, 0.8))
        simulated = np.concatenate(load.simulated)
        time_s = load.block_s * np.arange(len(simulated))
        measured = simulated + np.concatenate(load.residuals)
        test.plot(time_s, measured, label="measured", **style.REFERENCE)
        test.plot(time_s, simulated, label="identified load", **style.ADAPTIVE)
        test.set_ylabel(label)
        test.set_xlabel("time in the experiment (s)")
        style.legend_above(test, columns=2)
        response.plot(prediction.time_s, prediction.output, **style.ADAPTIVE)
        response.set_title("predicted response of the fixed controller to a step")
        response.set_ylabel(label)
        volts.plot(prediction.time_s, prediction.boost_voltage_V, **style.ADAPTIVE)
        volts.set_ylabel(found.before.drive.given.axis)
        volts.set_xlabel("time since the step (s)")
        return as_png(figure)


def judged(
    sensor: evaluation.SensorState,
    experiment: LoadExperiment,
    present: Configuration,
    text: str,
    path: Path,
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
    load = loads.build_load(present)
    identified = evaluation.evaluate(experiment, loads.candidate_loads(present))
    proposal = propose(identified, text, path, experiment.course.record.coarseness())
    rest_V = evaluation.rest_voltage(outcome.low_V, outcome.high_V, load)
    proposed, now = (
        evaluation.predict(identified, one, rest_V, experiment.course.target.move)
        for one in (proposal.configuration, present)
    )
    refusal = proposed.refusal(now)
    return Commissioned(sensor, outcome, identified, proposal, proposed, present, refusal)


# The experiment on a plant of the user, in virtual time.

_SAMPLE_S = 0.1
"""Time between two samples, as between two messages of the daemon."""

_LAG_S = 0.075
"""Lag of the boost voltage behind V_c."""

_WATCHED_S = 5.0
_LONGEST_S = 30 * 86400.0


class _Rig:
    """A plant behind a boost stage, sampled as telemetry is."""

    def __init__(self, plant: closed_loop.Plant, configuration: Configuration) -> None:
        self._plant = closed_loop.at_own_step(plant)
        self._step_s = configuration.timing.reading_s
        self._count = max(1, round(_SAMPLE_S / self._step_s))
        self._share = -math.expm1(-self._step_s / _LAG_S)
        self._taken = 0
        self.time_s = 0.0
        self.boost_V = max(configuration.drive.limits.boost_reference_min_V, 0.0)

    def sample(self, wanted_V: float) -> tuple[float, float, float]:
        """Advance by a sample under V_c; return its time, boost voltage and output."""
        output = 0.0
        for _ in range(self._count):
            before_V = self.boost_V
            self.boost_V += self._share * (wanted_V - before_V)
            mean_V = 0.5 * (before_V + self.boost_V)
            output, _ = closed_loop.advanced(self._plant, mean_V, self._step_s, self._taken)
            self._taken += 1
        self.time_s = self._taken * self._step_s
        return self.time_s, self.boost_V, output


def commission_plant(
    path: Path, plant: closed_loop.Plant, move_share: float, patience_s: float | None
) -> Commissioned:
    """Run the experiment on a plant and evaluate it.

    Args:
        path: Configuration with the limits of the drive and of the output.
        plant: The plant.
        move_share: Movement of the output as a share of the set-point range.
        patience_s: Shortest wait for a response; that of the kind of load when None.

    Raises:
        AdaptdriveError: The experiment cannot continue, or does not show the load.
    """
    text = read_text(path)
    configuration = examine.examine_text(text, path)
    target = build_target(configuration, move_share, patience_s)
    rig, standby = _Rig(plant, configuration), course.Samples()
    while rig.time_s < _WATCHED_S:
        standby.append(*rig.sample(target.low_V))
    sensor = evaluation.judge_sensor(standby, configuration, target.move)
    experiment = LoadExperiment(target)
    while not experiment.done:
        experiment.take(*rig.sample(experiment.course.voltage_V))
        if rig.time_s > _LONGEST_S:
            raise CommissionError("the experiment does not end within 30 days")
    return judged(sensor, experiment, configuration, text, path)
