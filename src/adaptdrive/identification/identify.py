"""Identification of a load from records, in closed loop too: values, deviations, and checks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control.loads.load import Load
from adaptdrive.identification.excerpt import Blocks, Excerpt, blocks_of, lost_of
from adaptdrive.identification.fit import Fitted, Problem, require_excitation, scan, settle, split
from adaptdrive.identification.result import IdentifiedLoad, autoregression, result_of
from adaptdrive.util.errors import IdentificationError

Array = NDArray[np.float64]

_LONGEST_DELAY = 10
"""Longest dead time that is tried, in blocks."""

_FEWEST_IN_PART = 15
"""Blocks of an uninterrupted part, after what shows its delayed input, below which it is left out:
more than the noise model has terms."""

_FEWEST_BLOCKS = 30
_ROUNDS = 3
"""Fits in turn of the load and of the noise model; the second one changes digits only."""


def identify(
    excerpts: Sequence[Excerpt],
    load: Load,
    *,
    block: int = 1,
    longest_delay: int | None = None,
) -> IdentifiedLoad:
    """Identify a load by prediction errors, and by a simulation next to them.

    Args:
        excerpts: Parts of a record, all at one rate; in closed loop each begins with a slow period.
        load: Its structure and input map; its nominal parameters are not used.
        block: Samples that are averaged before the fit; in closed loop a divisor of the slow
            period in samples, so that no block contains both a sample and the reaction to it.
        longest_delay: Longest dead time, in samples; ten blocks when None.

    Raises:
        IdentificationError: The data do not determine the load; the reason is the message.
    """
    lead = _LONGEST_DELAY * block if longest_delay is None else longest_delay
    counts = [(len(one.output) - lost_of(one, block, lead)) // block for one in excerpts]
    used = tuple(place for place, count in enumerate(counts) if count >= _FEWEST_IN_PART)
    usable = [excerpts[place] for place in used]
    _require_data(usable, sum(counts[place] for place in used), block, len(excerpts))
    problem = _problem(blocks_of(usable, load, block, lead), load)
    fitted = simulation = scan(problem)
    require_excitation(fitted.problem, fitted.solution)
    for number in range(_ROUNDS):
        noise, drift = _noise(fitted), _drift(fitted)
        if len(noise) == len(fitted.problem.noise) == 1 and not drift:
            break
        search = settle if number else scan
        changed = replace(fitted.problem, noise=noise, drift=drift)
        fitted = search(changed, fitted.solution.logarithms)
    fitted = settle(fitted.problem, fitted.solution.logarithms)
    white = replace(simulation.problem, drift=fitted.problem.drift)
    simulation = settle(white, simulation.solution.logarithms)
    return replace(result_of(load, fitted, simulation, usable[0].period_s), used=used)


def identify_any(
    excerpts: Sequence[Excerpt], loads: Sequence[Load], *, block: int = 1
) -> IdentifiedLoad:
    """Identify a load of one of several structures: that of least Bayesian information criterion.

    Args:
        excerpts: Parts of a record.
        loads: The structures.
        block: Samples that are averaged before the fit.

    Raises:
        IdentificationError: The data do not determine the load; the reason is the message.
    """
    return min((identify(excerpts, load, block=block) for load in loads), key=_criterion)


def _criterion(load: IdentifiedLoad) -> float:
    """Return the criterion, for each error."""
    count = sum(map(len, load.errors))
    fitted = len(load.denominator) + len(load.noise)
    return 2.0 * math.log(load.noise_std) + math.log(count) / count * fitted


def _noise(fitted: Fitted) -> Array:
    """Return the noise model of what the fit leaves."""
    problem = fitted.problem
    return autoregression(split(problem, problem.targets - fitted.solution.simulated))


def _drift(fitted: Fitted) -> tuple[float, ...]:
    """Return the fitted numerator for the charge, where it acts."""
    problem = fitted.problem
    if not problem.drift:
        return ()
    numerator = fitted.solution.weights[: len(problem.powers)]
    return tuple((numerator / np.abs(numerator).max()).tolist())


def _problem(parts: list[Blocks], load: Load) -> Problem:
    drift: tuple[float, ...] = ()
    if load.charging is not None:
        drift = tuple(1.0 if power == load.order else 0.0 for power in load.input_powers)
    return Problem(parts, load.order, load.input_powers, drift, noise=np.ones(1))


def _require_data(excerpts: Sequence[Excerpt], count: int, block: int, parts: int) -> None:
    if count < _FEWEST_BLOCKS:
        raise IdentificationError(
            f"{count} uninterrupted blocks of {block} samples in {len(excerpts)} of {parts} parts; "
            f"{_FEWEST_BLOCKS} are needed"
        )
    periods_s = [one.period_s for one in excerpts]
    if max(periods_s) > 1.001 * min(periods_s):
        rates = ", ".join(f"{period_s:.6g}" for period_s in sorted(set(periods_s)))
        raise IdentificationError(f"the excerpts have different sampling periods: {rates} s")
