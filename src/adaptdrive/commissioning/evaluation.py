"""The load that an experiment shows, its sensor at rest, the response that follows; as a report."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from adaptdrive.analysis import figures, load_report
from adaptdrive.analysis.closed_loop import simulate
from adaptdrive.analysis.curves import Response, response_of
from adaptdrive.analysis.excerpts import IdentifiedPlant
from adaptdrive.app.examine import examine_text
from adaptdrive.app.loads import build_load, candidate_loads
from adaptdrive.commissioning.course import ExperimentCourse, Outcome, Samples
from adaptdrive.commissioning.proposal import Proposal, propose, with_values, write_values
from adaptdrive.config.file import digest_of, parse_configuration, read_text
from adaptdrive.config.root import Configuration
from adaptdrive.control.loads.load import Load, to_input
from adaptdrive.control.signals import Mode, Order, Stage
from adaptdrive.identification import identify, identify_any, result
from adaptdrive.identification.excerpt import Excerpt
from adaptdrive.safety.timing import timing_of
from adaptdrive.util.errors import CommissionError

# The load that an experiment shows.

_BLOCKS_TO_REST = 60
"""Blocks in the time to rest: a time constant has about fifteen."""

_MOST_BLOCKS = 4000
_LARGEST_DEVIATION = 0.5
"""Largest standard deviation of a parameter, relative to it."""

_SHORT_LAG = 0.05
"""Second lag over the sum of both that is shorter than a slow period, and so counts as none."""

_LONGEST_DELAY = 1
"""Longest dead time in samples: a tenth of a second is longer than any bus takes."""


def evaluate(record: Samples, outcome: Outcome, loads: Sequence[Load]) -> result.IdentifiedLoad:
    """Identify the load from the samples of an experiment.

    Args:
        record: The samples.
        outcome: What came of the experiment.
        loads: Structure and input map of the load; of several, which have any dead time, the one
            that the samples show.

    Raises:
        CommissionError: They leave a parameter open.
        IdentificationError: The samples do not determine the load.
    """
    excerpt = resampled(record, outcome.began_s)
    wanted = outcome.settling_s / _BLOCKS_TO_REST / excerpt.period_s
    block = max(1, math.ceil(len(excerpt.output) / _MOST_BLOCKS), math.floor(wanted))
    if len(loads) > 1:
        found = identify_any([excerpt], loads, block=block)
    else:
        found = identify([excerpt], loads[0], block=block, longest_delay=_LONGEST_DELAY)
    for name, one in found.parameters.items():
        if not _determined(name, found):
            raise CommissionError(
                f"the test does not determine {name} = {one.value:.4g} ± {one.std:.2g}: ask for a "
                "larger movement, or a longer wait"
            )
    return found


def _determined(name: str, found: result.IdentifiedLoad) -> bool:
    """Return whether a parameter is known well enough to control the load with it.

    The product of two lags vanishes where the load has a single one. It is then known where the
    second lag, which is the product over the sum, is shorter than a slow period two deviations up.
    """
    one = found.parameters[name]
    if one.value > 0.0 and one.std <= _LARGEST_DEVIATION * one.value:
        return True
    if name != "tau_product_s2":
        return False
    return one.value + 2.0 * one.std <= _SHORT_LAG * found.parameters["tau_sum_s"].value ** 2


def resampled(record: Samples, from_s: float) -> Excerpt:
    """Return the samples of a record from a time on, at a constant rate.

    Args:
        record: Samples at increasing times.
        from_s: First time.
    """
    times_s = np.array(record.times_s)
    first = int(np.searchsorted(times_s, from_s))
    times_s = times_s[first:]
    period_s = float(np.median(np.diff(times_s)))
    even_s = np.arange(times_s[0], times_s[-1], period_s)
    voltages_V = np.interp(even_s, times_s, np.array(record.voltages_V[first:]))
    outputs = np.interp(even_s, times_s, np.array(record.outputs[first:]))
    return Excerpt(voltages_V, outputs, period_s)


# The output's sensor while the drive is off.

_NOISE_SHARE = 1.0
"""Noise of one sample over the movement, above which the movement is hidden."""


def refuse_blind(standby: Samples, configuration: Configuration, move: float) -> None:
    """Refuse a sensor by which an experiment would not see the load.

    Args:
        standby: Samples while the drive was off.
        configuration: Limits of the output.
        move: Movement that the experiment aims at.

    Raises:
        CommissionError: Its output, noise or resolution is too large.
    """
    mean, noise, resolution = standby.mean(), standby.noise(), standby.resolution()
    section = configuration.load
    if mean > section.reference_max:
        raise CommissionError(
            f"{section.output_name} = {mean:.4g} {section.output_unit} while the drive is off is "
            f"above load.reference_max = {section.reference_max:g} {section.output_unit}: compare "
            "its scale and offset"
        )
    if max(noise, resolution) > _NOISE_SHARE * move:
        raise CommissionError(
            f"noise {noise:.3g} and resolution {resolution:.3g} of the sensor hide a "
            f"movement of {move:.3g} {section.output_unit}: ask for a larger one with --move"
        )


# Predicted response of the proposed loop: the daemon's controller on the identified load.

_PERIODS_BEFORE, _PERIODS_AFTER = 10, 60
_SETTLED = 10.0
"""Slow periods after the step over the time constant of the pole, 1 / (1 - pole), at least."""

_UNSEEN = 0.01
"""Overshoot, as a share of the step, that no present settings are compared with."""

_POWER_SHARE = 0.5
"""Power of the load at the highest V_c over the largest power of the drive."""


def refusal_of(proposed: Response, present: Response) -> str:
    """Return why settings are not to be put to use rather than the present ones.

    Args:
        proposed: Response with them.
        present: Response with the present ones.
    """
    overshoot, settling_s = proposed.quality.overshoot, proposed.quality.settling_s
    if proposed.fault:
        return f"the predicted loop trips: {proposed.fault}"
    shown = f"predicted overshoot {100.0 * overshoot:.1f} %"
    if not (math.isfinite(overshoot) and math.isfinite(settling_s)):
        return f"the loop does not settle: {shown}, settling {settling_s:.4g} s"
    before = present.quality.overshoot
    if overshoot > _UNSEEN and overshoot > before:
        return f"{shown}, with the present settings {100.0 * before:.1f} %"
    return ""


def predict(
    identified: result.IdentifiedLoad, configuration: Configuration, rest_V: float, move: float
) -> Response:
    """Run the fixed controller on the identified load over a step of the set-point.

    Args:
        identified: The load.
        configuration: The proposed settings.
        rest_V: Boost voltage before the step.
        move: Size of the step.

    Returns:
        Its response, with the time of the middle of each slow period since the step.
    """
    load, section = build_load(configuration), configuration.load
    gain = identified.numerator[-1] / identified.denominator[-1]
    fed = to_input(rest_V, load.input_gain, load.input_exponent)
    rest = gain * (fed + identified.input_offset.value)
    samples = configuration.ticks_per_period // configuration.bus.ticks_per_reading
    after = max(_PERIODS_AFTER, math.ceil(_SETTLED / (1.0 - section.pole)))
    held, stepped = (
        Order(Stage.RUN, reference, Mode.FIXED, section.pole) for reference in (rest, rest + move)
    )
    limits = configuration.drive.limits
    factor = _POWER_SHARE * limits.load_power_max_W / limits.boost_reference_max_V**2
    power = np.array([factor, 0.0, 0.0])  # of v², v and v·y in the power of the load
    period_s = timing_of(configuration).reading_s
    plant = IdentifiedPlant(identified, load, period_s, (rest_V, rest), power)
    course = [held] * (_PERIODS_BEFORE * samples) + [stepped] * (after * samples)
    run = simulate(configuration, plant, course, rest_V)
    middles = np.arange(0.5, len(run.columns["output"]) // samples)
    time_s = (middles - _PERIODS_BEFORE) * section.period_s
    return response_of(run.columns, samples, time_s, section, run.fault)


# The results of commissioning: load, settings and predicted response, as text and as a figure.


@dataclass(frozen=True, slots=True)
class Commissioned:
    """All results of an experiment.

    Attributes:
        standby: Samples of the sensor while the drive was off.
        outcome: Levels and movement of the test.
        load: The identified load.
        proposal: Proposed settings.
        prediction: Response of the proposed loop.
        before: The present configuration.
        refusal: Why the settings are not to be put to use, empty where they are.
    """

    standby: Samples
    outcome: Outcome
    load: result.IdentifiedLoad
    proposal: Proposal
    prediction: Response
    before: Configuration
    refusal: str = ""

    @property
    def reached(self) -> float:
        """An output to hold next: one that the experiment has led the load to."""
        load, reached = self.before.load, float(f"{self.outcome.rest + self.outcome.moved:.4g}")
        return min(max(reached, load.reference_min), load.reference_max)


def as_text(found: Commissioned) -> str:
    """Return the result as a table."""
    return "\n".join([*_checks(found), "", *_settings(found), "", *_loop(found)])


def _checks(found: Commissioned) -> Iterator[str]:
    standby, outcome, load = found.standby, found.outcome, found.load
    unit, given = found.before.load.output_unit, found.before.drive.given
    noise, resolution = f"{standby.noise():.3g} {unit}", f"{standby.resolution():.3g} {unit}"
    yield f"sensor          noise {noise}, resolution {resolution}"
    yield (
        f"test            {given.symbol} {outcome.low_V:.4g}…{given.text(outcome.high_V)} from "
        f"{outcome.rest:.4g} {unit}, time to rest {outcome.settling_s:.3g} s"
    )
    yield from load_report.checks(load, unit)


def _settings(found: Commissioned) -> Iterator[str]:
    yield f"{'setting':<34}{'present':>12}{'proposed':>12}"
    for key, value in found.proposal.values.items():
        deviation = found.proposal.model.get(key.removeprefix("load.model."))
        margin = "" if deviation is None else f"  ± {deviation.std:.2g}"
        present = float(attrgetter(key)(found.before))
        yield f"{key:<34}{present:>12.5g}{value:>12.5g}{margin}"


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
    """Return a PNG of the test with the simulated output, and of the predicted response."""
    load, prediction = found.load, found.prediction
    label = f"{found.before.load.output_name} ({found.before.load.output_unit or '1'})"
    with figures.journal():
        figure = Figure(figsize=(figures.WIDTH_in, 5.6), layout="constrained")
        test, response, volts = figure.subplots(3, 1, height_ratios=(1.4, 1.0, 0.8))
        simulated = np.concatenate(load.simulated)
        time_s = load.block_s * np.arange(len(simulated))
        measured = simulated + np.concatenate(load.residuals)
        test.plot(time_s, measured, label="measured", **figures.REFERENCE)
        test.plot(time_s, simulated, label="identified load", **figures.ADAPTIVE)
        test.set_ylabel(label)
        test.set_xlabel("time in the experiment (s)")
        figures.legend_above(test, columns=2)
        response.plot(prediction.time_s, prediction.output, **figures.ADAPTIVE)
        response.set_title("predicted response of the fixed controller to a step")
        response.set_ylabel(label)
        volts.plot(prediction.time_s, prediction.boost_voltage_V, **figures.ADAPTIVE)
        volts.set_ylabel(found.before.drive.given.axis)
        volts.set_xlabel("time since the step (s)")
        return figures.as_png(figure)


def judged(
    standby: Samples, experiment: ExperimentCourse, present: Configuration, text: str, path: Path
) -> Commissioned:
    """Return all results of an experiment.

    Args:
        standby: Samples of the sensor while the drive was off.
        experiment: One that is complete.
        present: The configuration with which it was done.
        text: The same as text.
        path: Its file, for messages.

    Raises:
        AdaptdriveError: The samples do not determine the load, or no settings suit it.
    """
    outcome, target, record = experiment.outcome, experiment.target, experiment.record
    if outcome is None:
        raise CommissionError("the experiment is not complete")
    identified = evaluate(record, outcome, candidate_loads(present))
    proposal = propose(identified, text, path, record.coarseness())
    rest_V = target.middle_V(outcome.low_V, outcome.high_V)
    proposed, now = (
        predict(identified, one, rest_V, target.move) for one in (proposal.configuration, present)
    )
    refusal = refusal_of(proposed, now)
    return Commissioned(standby, outcome, identified, proposal, proposed, present, refusal)


def write(path: Path, found: Commissioned) -> tuple[Path, str]:
    """Write the proposed settings to the configuration.

    Returns:
        A copy of the file before, and the digest of what was written.

    Raises:
        CommissionError: The predicted response is no good.
        ConfigurationError: The file was changed and is not valid with the settings, or cannot be
            written.
    """
    if found.refusal:
        raise CommissionError(f"{path} stays as it is: {found.refusal}")
    text = read_text(path)
    parse_configuration(text, path)
    proposed = with_values(path, text, found.proposal.values)
    examine_text(proposed, path)
    return write_values(path, proposed), digest_of(proposed)
