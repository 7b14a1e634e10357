"""The load that an experiment shows."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from adaptdrive.commission.course import Outcome
from adaptdrive.commission.experiment import LoadExperiment
from adaptdrive.commission.samples import Samples
from adaptdrive.control.load import Load
from adaptdrive.identification.excerpt import Excerpt
from adaptdrive.identification.identify import identify, identify_any
from adaptdrive.identification.result import IdentifiedLoad
from adaptdrive.util.errors import CommissionError

_BLOCKS_TO_REST = 60
"""Blocks in the time to rest: a time constant has about fifteen."""

_MOST_BLOCKS = 4000
_LARGEST_DEVIATION = 0.5
"""Largest standard deviation of a parameter, relative to it."""

_SHORT_LAG = 0.05
"""Second lag over the sum of both that is shorter than a slow period, and so counts as none."""

_LONGEST_DELAY = 1
"""Longest dead time in samples: a tenth of a second is longer than any bus takes."""


def evaluate(experiment: LoadExperiment, loads: Sequence[Load]) -> IdentifiedLoad:
    """Identify the load from the samples of an experiment.

    Args:
        experiment: One that is complete.
        loads: Structure and input map of the load; of several, which have any dead time, the one
            that the samples show.

    Raises:
        CommissionError: It is not complete, or leaves a parameter open.
        IdentificationError: The samples do not determine the load.
    """
    outcome = experiment.outcome
    if outcome is None:
        raise CommissionError("the experiment is not complete")
    excerpt = resampled(experiment.course.record, outcome.began_s)
    block = _block(outcome, excerpt)
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


def _determined(name: str, found: IdentifiedLoad) -> bool:
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


def _block(outcome: Outcome, excerpt: Excerpt) -> int:
    wanted = outcome.settling_s / _BLOCKS_TO_REST / excerpt.period_s
    fewest = math.ceil(len(excerpt.output) / _MOST_BLOCKS)
    return max(1, fewest, math.floor(wanted))
