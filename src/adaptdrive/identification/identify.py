"""Identification of a load from records, in closed loop too: values, deviations, and checks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control.load import Load
from adaptdrive.errors import IdentificationError
from adaptdrive.identification.excerpt import Blocks, Excerpt, blocks_of
from adaptdrive.identification.fit import Problem, Solution, refine, require_excitation, split
from adaptdrive.identification.noise_model import autoregression
from adaptdrive.identification.result import Choice, IdentifiedLoad, result_of
from adaptdrive.identification.starts import start

Array = NDArray[np.float64]

DELAYS = (0, 1, 2, 3)
"""Dead times that are tried, in samples."""

_FEWEST_BLOCKS = 30
_ROUNDS = 3
"""Fits in turn of the load and of the noise model; the second one changes digits only."""


def identify(
    excerpts: Sequence[Excerpt],
    load: Load,
    *,
    block: int = 1,
    delays: Sequence[int] = DELAYS,
) -> IdentifiedLoad:
    """Identify a load by prediction errors.

    Args:
        excerpts: Parts of a record, all at one rate; in closed loop each begins with a slow period.
        load: Its structure and input map; its nominal parameters are not used.
        block: Samples that are averaged before the fit; in closed loop a divisor of the slow
            period in samples, so that no block contains both a sample and the reaction to it.
        delays: Dead times to choose from, in samples.

    Raises:
        IdentificationError: The data do not determine the load; the reason is the message.
    """
    longest = max(delays)
    usable = [one for one in excerpts if len(one.output) >= longest + 5 * block]
    _require_data(usable, longest, block)
    problems = {
        delay: _problem(blocks_of(usable, load, block, delay, longest), load) for delay in delays
    }
    first = problems[min(delays)]
    solution = refine(first, start(first))
    require_excitation(first, solution)
    choice = _fit_each(problems, solution)
    for _ in range(_ROUNDS):
        noise, drift = _noise(choice), _drift(choice)
        if len(noise) == len(choice.problem.noise) == 1 and not drift:
            break
        problems = {
            delay: replace(one, noise=noise, drift=drift) for delay, one in problems.items()
        }
        choice = _fit_each(problems, choice.solution)
    return result_of(load, choice, usable[0].period_s)


def _noise(choice: Choice) -> Array:
    """Return the noise model of what the fit leaves."""
    problem = choice.problem
    return autoregression(split(problem, problem.targets - choice.solution.simulated))


def _drift(choice: Choice) -> tuple[float, ...]:
    """Return the fitted numerator for the charge, where it acts."""
    problem = choice.problem
    if not problem.drift:
        return ()
    numerator = choice.solution.weights[: len(problem.powers)]
    return tuple((numerator / np.abs(numerator).max()).tolist())


def _problem(parts: list[Blocks], load: Load) -> Problem:
    drift: tuple[float, ...] = ()
    if load.charging is not None:
        drift = tuple(1.0 if power == load.order else 0.0 for power in load.input_powers)
    return Problem(parts, load.order, load.input_powers, drift, noise=np.ones(1))


def _require_data(excerpts: Sequence[Excerpt], lost: int, block: int) -> None:
    count = sum(len(one.output) // block - math.ceil(lost / block) for one in excerpts)
    if count < _FEWEST_BLOCKS:
        raise IdentificationError(
            f"{count} uninterrupted blocks of {block} samples; {_FEWEST_BLOCKS} are needed"
        )
    periods_s = [one.period_s for one in excerpts]
    if max(periods_s) > 1.001 * min(periods_s):
        rates = ", ".join(f"{period_s:.6g}" for period_s in sorted(set(periods_s)))
        raise IdentificationError(f"the excerpts have different sampling periods: {rates} s")


def _fit_each(problems: dict[int, Problem], near: Solution) -> Choice:
    """Return the fit with each dead time."""
    fits = {delay: refine(problem, near.logarithms) for delay, problem in problems.items()}
    return Choice(problems, fits)
