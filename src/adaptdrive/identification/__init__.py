"""Batch identification of a load from records, and the model that is proposed from it."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from adaptdrive.config.load import AnyLoad, BathModel, BathSection, BatterySection, MotorSection
from adaptdrive.control.loads.load import Load
from adaptdrive.control.signals import Estimate
from adaptdrive.identification import excerpt, fit, result
from adaptdrive.util.errors import IdentificationError

# Identification of a load from records, in closed loop too: values, deviations, and checks.

_LONGEST_DELAY = 10
"""Longest dead time that is tried, in blocks."""

_FEWEST_IN_PART = 15
"""Blocks of an uninterrupted part, after what shows its delayed input, below which it is left out:
more than the noise model has terms."""

_FEWEST_BLOCKS = 30
_ROUNDS = 3
"""Fits in turn of the load and of the noise model; the second one changes digits only."""


def identify(
    excerpts: Sequence[excerpt.Excerpt],
    load: Load,
    *,
    block: int = 1,
    longest_delay: int | None = None,
) -> result.IdentifiedLoad:
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
    counts = [(len(one.output) - excerpt.lost_of(one, block, lead)) // block for one in excerpts]
    used = tuple(place for place, count in enumerate(counts) if count >= _FEWEST_IN_PART)
    usable = [excerpts[place] for place in used]
    _require_data(usable, sum(counts[place] for place in used), block, len(excerpts))
    drift: tuple[float, ...] = ()
    if load.charging is not None:
        drift = tuple(1.0 if power == load.order else 0.0 for power in load.input_powers)
    parts = excerpt.blocks_of(usable, load, block, lead)
    problem = fit.Problem(parts, load.order, load.input_powers, drift, noise=np.ones(1))
    fitted = simulation = fit.scan(problem)
    fit.require_excitation(fitted)
    for number in range(_ROUNDS):
        noise, drift = _noise(fitted), _drift(fitted)
        if len(noise) == len(fitted.problem.noise) == 1 and not drift:
            break
        search = fit.settle if number else fit.scan
        changed = replace(fitted.problem, noise=noise, drift=drift)
        fitted = search(changed, fitted.logarithms)
    fitted = fit.settle(fitted.problem, fitted.logarithms)
    white = replace(simulation.problem, drift=fitted.problem.drift)
    simulation = fit.settle(white, simulation.logarithms)
    return replace(result.result_of(load, fitted, simulation, usable[0].period_s), used=used)


def identify_any(
    excerpts: Sequence[excerpt.Excerpt], loads: Sequence[Load], *, block: int = 1
) -> result.IdentifiedLoad:
    """Identify a load of one of several structures: that of least Bayesian information criterion.

    Args:
        excerpts: Parts of a record.
        loads: The structures.
        block: Samples that are averaged before the fit.

    Raises:
        IdentificationError: The data do not determine the load; the reason is the message.
    """

    def criterion(load: result.IdentifiedLoad) -> float:
        """Return the criterion, for each error."""
        count, fitted = sum(map(len, load.errors)), len(load.denominator) + len(load.noise)
        return 2.0 * math.log(load.noise_std) + math.log(count) / count * fitted

    return min((identify(excerpts, load, block=block) for load in loads), key=criterion)


def _noise(fitted: fit.Solution) -> excerpt.Array:
    """Return the noise model of what the fit leaves."""
    problem = fitted.problem
    return result.autoregression(fit.split(problem, problem.targets - fitted.simulated))


def _drift(fitted: fit.Solution) -> tuple[float, ...]:
    """Return the fitted numerator for the charge, where it acts."""
    problem = fitted.problem
    if not problem.drift:
        return ()
    numerator = fitted.weights[: len(problem.powers)]
    return tuple((numerator / np.abs(numerator).max()).tolist())


def _require_data(excerpts: Sequence[excerpt.Excerpt], count: int, block: int, parts: int) -> None:
    if count < _FEWEST_BLOCKS:
        raise IdentificationError(
            f"{count} uninterrupted blocks of {block} samples in {len(excerpts)} of {parts} parts; "
            f"{_FEWEST_BLOCKS} are needed"
        )
    periods_s = [one.period_s for one in excerpts]
    if max(periods_s) > 1.001 * min(periods_s):
        rates = ", ".join(f"{period_s:.6g}" for period_s in sorted(set(periods_s)))
        raise IdentificationError(f"the excerpts have different sampling periods: {rates} s")


# `[load.model]` from an identified load.

_SHOWN = 3.0
"""Dead time over its deviation above which the record shows it."""


def proposed_model(identified: result.IdentifiedLoad, section: AnyLoad) -> dict[str, Estimate]:
    """Return the keys of `[load.model]` that a record determines; the others stay.

    Args:
        identified: The load.
        section: `[load]`, whose model gives the dc/dc stage and says which time constant of a
            motor is the filter's: the nearer one. A load whose parameters are the keys of its
            model needs nothing here.
    """
    match section:
        case MotorSection(model=model):
            return _motor(identified, model.tau_motor_s, model.tau_filter_s)
        case BatterySection(model=model):
            return _battery(identified, model.turns_ratio, model.droop_Ohm)
        case BathSection(model=bath):
            return _bath(identified, bath)


def _bath(identified: result.IdentifiedLoad, model: BathModel) -> dict[str, Estimate]:
    """Return resistance and time constant, and what the record shows of a sensor that lags."""
    gain, *taus_s = time_constants(identified).values()
    found = dict(zip(("resistance_K_per_W", "tau_s", "lag_s"), (gain, *taus_s), strict=False))
    if identified.delay_s > _SHOWN * identified.delay_std_s:
        found["delay_s"] = Estimate(identified.delay_s, identified.delay_std_s)
    gone = [name for name in ("lag_s", "delay_s") if name not in found and getattr(model, name)]
    return found | dict.fromkeys(gone, Estimate(0.0, 0.0))


def time_constants(identified: result.IdentifiedLoad) -> dict[str, Estimate]:
    """Return gain and time constants of a load of one or two lags, the longer one first."""
    if "tau_product_s2" not in identified.parameters:
        return dict(identified.parameters)
    names = ("gain", "tau_1_s", "tau_2_s")
    return dict(zip(names, _motor(identified, 1.0, 0.0).values(), strict=True))


def _motor(
    identified: result.IdentifiedLoad, tau_motor_s: float, tau_filter_s: float
) -> dict[str, Estimate]:
    """Return the gain and both time constants; equal ones where the pair is complex."""
    total, product = (identified.parameters[name] for name in ("tau_sum_s", "tau_product_s2"))
    square = 0.25 * total.value**2 - product.value
    slopes = np.array([0.5 * total.value, -1.0])
    square_std = math.sqrt(slopes @ identified.covariance[1:, 1:] @ slopes)
    gap_s = math.sqrt(max(0.0, square))
    # The root is not linear near 0: the deviation is the way to the root at one deviation more.
    gap_std_s = math.sqrt(max(0.0, square) + square_std) - gap_s
    std_s = math.hypot(0.5 * total.std, gap_std_s)
    middle_s = 0.5 * total.value
    slow, fast = Estimate(middle_s + gap_s, std_s), Estimate(middle_s - gap_s, std_s)
    motor, tachometer = (slow, fast) if tau_motor_s >= tau_filter_s else (fast, slow)
    return {
        "gain": next(iter(identified.parameters.values())),
        "tau_motor_s": motor,
        "tau_filter_s": tachometer,
    }


def _battery(
    identified: result.IdentifiedLoad, turns_ratio: float, droop_Ohm: float
) -> dict[str, Estimate]:
    def resistances(admittances: excerpt.Array) -> excerpt.Array:
        direct_S, gain_S, tau_s = admittances
        series_Ohm, total_Ohm = turns_ratio / direct_S, turns_ratio / gain_S
        relaxation_s = tau_s * total_Ohm / series_Ohm
        return np.array([series_Ohm - droop_Ohm, total_Ohm - series_Ohm, relaxation_s])

    names = ("internal_Ohm", "relaxation_Ohm", "relaxation_s")
    values = np.array([one.value for one in identified.parameters.values()])
    slopes = result.slopes_of(resistances, values, values)
    deviations = np.sqrt(np.diag(slopes @ identified.covariance @ slopes.T))
    estimates = map(Estimate, resistances(values).tolist(), deviations.tolist())
    return dict(zip(names, estimates, strict=True))
