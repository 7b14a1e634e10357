"""Settings that follow from an identified load, and the configuration's file with them."""

import math
import os
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from numpy.typing import NDArray
from scipy.signal import freqz, lfilter
from tomlkit.exceptions import TOMLKitError

from adaptdrive.analysis.replay import reconfigured
from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings
from adaptdrive.config.file import read_text
from adaptdrive.config.load import LoadTraits
from adaptdrive.config.root import Configuration
from adaptdrive.control.design.pole_placement import Plant, discrete_model
from adaptdrive.control.loads.load import to_input
from adaptdrive.control.signals import Estimate
from adaptdrive.identification import proposed_model
from adaptdrive.identification.result import IdentifiedLoad
from adaptdrive.util.errors import CommissionError, ConfigurationError, Flaw

Array = NDArray[np.float64]

_FREQUENCIES = 4000
_STEPS = 400

_RATIO_MIN = (0.1, 0.3)
_RATIO_MAX = (4.0, 10.0)
"""Range in which a bound of the estimates over the model is proposed."""

_FILTER_SHARE = 0.5
"""λ time constant over the sum of the time constants."""

_LAG_PERIODS = 10.0
"""Slow periods in the sum of the time constants for each of them, at least."""

_ROUND = (1.0, 2.0, 5.0, 10.0)
_SHORTEST_PERIOD_S = 0.1
_LONGEST_PERIOD_S = 3600.0
_FEWEST_READINGS = 3
_FEWEST_LATENCIES = 2
"""Shortest slow period, in readings of the drive, and in its dead times from sample to effect."""

_SAMPLED_SHARE = 0.75
"""Longest part of a slow period over which the output is averaged."""

_FAST_POLES = (0.50, 0.55, 0.60, 0.65)
"""Poles that are tried first for a bath whose sensor lags: what it shows late is asked for soon."""

_POLES = (0.70, 0.75, 0.80, 0.85, 0.90, 0.93, 0.95, 0.97)
_LEAST_GAIN = 2.0
_LEAST_DELAY = 0.5
"""Least delay margin in slow periods."""

_STEP_SHARE = 0.1
_EFFORT_SHARE = 0.5
"""Share of the range of V_c that a set-point step of a tenth of its range may take."""


@dataclass(frozen=True, slots=True)
class Margins:
    """Distance of a loop from instability, by its model.

    Attributes:
        gain: Factor of the load's gain at which the loop becomes unstable.
        delay_s: Additional dead time at which it becomes unstable.
        effort: Largest change of the load's input after a step of the set-point, over the step.
    """

    gain: float
    delay_s: float
    effort: float


def margins_of(configuration: Configuration) -> Margins:
    """Return the margins of the fixed controller on the configured model.

    Args:
        configuration: The drive, with the model of the load.
    """
    load, section = build_load(configuration), configuration.load
    settings = controller_settings(configuration)
    numerator, denominator = list(load.numerator), list(load.denominator)
    a, b = discrete_model(settings, load, numerator, denominator, section.period_s)
    plant = Plant(a, b)
    r, s = plant.place(plant.asked(section.pole))
    omega = np.linspace(math.pi / _FREQUENCIES, math.pi, _FREQUENCIES)
    _, loop = freqz(np.convolve(b, s), np.convolve(a, r), omega)
    return Margins(
        gain=_gain_margin(loop),
        delay_s=_delay_margin(loop, omega) * section.period_s,
        effort=_effort(plant, r, s),
    )


def _gain_margin(loop: NDArray[np.complex128]) -> float:
    """Return 1/|L| at the crossing of the negative real axis that is nearest to -1."""
    crossings = np.flatnonzero(np.diff(np.sign(loop.imag)) != 0)
    sizes = [abs(loop[i]) for i in crossings if loop[i].real < 0.0]
    below = [size for size in sizes if size < 1.0]
    return 1.0 / max(below) if below else math.inf


def _delay_margin(loop: NDArray[np.complex128], omega: Array) -> float:
    """Return the least phase margin over frequency, in slow periods."""
    crossings = np.flatnonzero(np.diff(np.sign(np.abs(loop) - 1.0)) != 0)
    margins = [((np.angle(loop[i]) + math.pi) % (2.0 * math.pi)) / omega[i] for i in crossings]
    return float(min(margins, default=math.inf))


def _effort(plant: Plant, r: list[float], s: list[float]) -> float:
    """Return the largest input after a unit step of the set-point."""
    closed = plant.closed([*r[1:], *s])
    inputs = lfilter(sum(s) * np.array(plant.a), closed, np.ones(_STEPS))
    return float(np.abs(inputs).max())


@dataclass(frozen=True, slots=True)
class Proposal:
    """Proposed settings.

    Attributes:
        values: New values by key.
        model: Those of `[load.model]` with their deviations, by name.
        configuration: The configuration with them.
        margins: Margins of the fixed controller with them.
    """

    values: dict[str, float | int]
    model: dict[str, Estimate]
    configuration: Configuration
    margins: Margins


def propose(
    identified: IdentifiedLoad, text: str, source: Path, resolution: float = 0.0
) -> Proposal:
    """Return settings for an identified load.

    Args:
        identified: The load.
        text: The present configuration.
        source: Its file, for messages.
        resolution: Smallest step of the output, where its noise is smaller; else 0.

    Raises:
        ConfigurationError: The proposed settings are not valid together with the others.
        CommissionError: No pole gives a loop with sufficient margins.
    """
    present = reconfigured(text, source, ())
    model = proposed_model(identified, present.load)
    values = _pace(identified, present)
    values |= _bounds(identified, present.load.traits, float(values["load.period_s"]))
    if resolution > 0.0:
        values["load.resolution"] = _rounded(resolution)
    values |= {f"load.model.{name}": _rounded(one.value) for name, one in model.items()}
    for pole in (*_FAST_POLES, *_POLES) if "lag_s" in model else _POLES:
        tried = {**values, "load.pole": pole}
        configuration = reconfigured(text, source, [f"{key}={tried[key]!r}" for key in tried])
        margins = margins_of(configuration)
        if _suffices(margins, configuration):
            return Proposal(tried, model, configuration, margins)
    raise CommissionError(
        f"no pole up to {_POLES[-1]:g} gives a gain margin of {_LEAST_GAIN:g}, "
        "a delay margin of half a slow period, and steps within [drive.limits]"
    )


def _pace(identified: IdentifiedLoad, present: Configuration) -> dict[str, float | int]:
    """Return slow period, samples and λ time constant for the pace of the load."""
    total_s = identified.denominator[-2] / identified.denominator[-1]
    lags = len(identified.denominator) - 1
    periods = max(present.load.traits.lag_periods, _LAG_PERIODS * lags)
    period_s = _period_s(total_s / periods, present)
    ticks = round(2.0 * present.drive.line_frequency_Hz * period_s)
    samples = min(present.load.samples, math.floor(_SAMPLED_SHARE * ticks))
    return {
        "load.period_s": period_s,
        "load.samples": max(1, samples),
        "estimator.tau_lambda_s": _rounded(_FILTER_SHARE * total_s, 2),
    }


def _period_s(wanted_s: float, present: Configuration) -> float:
    """Return a slow period near a time that is whole readings of the drive, and enough of them."""
    reading = present.bus.ticks_per_reading
    reading_s = 0.5 * reading / present.drive.line_frequency_Hz
    latencies = math.ceil(_FEWEST_LATENCIES * present.load.latency_ticks / reading)
    fewest = max(_FEWEST_READINGS, latencies)
    shortest_s = max(fewest * reading_s, _SHORTEST_PERIOD_S)
    period_s = min(_nice(max(wanted_s, shortest_s)), _LONGEST_PERIOD_S)
    readings = max(round(period_s / reading_s), fewest)
    whole_s = _rounded(readings * reading_s, 9)
    return period_s if math.isclose(whole_s, period_s, rel_tol=1e-6) else whole_s


def _bounds(identified: IdentifiedLoad, traits: LoadTraits, period_s: float) -> dict[str, float]:
    """Return the bounds of the estimates over the model: what the slow period suits."""
    periods = identified.denominator[-2] / identified.denominator[-1] / period_s
    ends = {
        "supervisor.ratio_min": (traits.lag_periods_min / periods, _RATIO_MIN),
        "supervisor.ratio_max": (traits.lag_periods_max / periods, _RATIO_MAX),
    }
    return {
        key: _rounded(min(max(ratio, low), high), 2) for key, (ratio, (low, high)) in ends.items()
    }


def _nice(value: float) -> float:
    """Return the nearest of 1, 2 and 5 times a power of ten, on a logarithmic scale."""
    scale = 10.0 ** math.floor(math.log10(value))
    nearest = min(_ROUND, key=lambda one: abs(math.log(one * scale / value)))
    return _rounded(nearest * scale, 1)


def _rounded(value: float, digits: int = 4) -> float:
    return float(f"{value:.{digits}g}")


def _suffices(margins: Margins, configuration: Configuration) -> bool:
    section, limits = configuration.load, configuration.drive.limits
    if not (math.isfinite(margins.effort) and margins.gain >= _LEAST_GAIN):
        return False
    if margins.delay_s < _LEAST_DELAY * section.period_s:
        return False
    load = build_load(configuration)
    low, high = (
        to_input(volts, load.input_gain, load.input_exponent)
        for volts in (limits.boost_reference_min_V, limits.boost_reference_max_V)
    )
    step = _STEP_SHARE * (section.reference_max - section.reference_min)
    return margins.effort * step <= _EFFORT_SHARE * (high - low)


# The configuration file with new values: other comments stay, and the old file is kept.

ORIGIN = "by adaptdrive commission"


def with_values(path: Path, text: str, values: Mapping[str, float | int]) -> str:
    """Return a TOML document with new values, in its order.

    A comment with a figure after a value that changes goes: it describes the old value.

    Args:
        path: The file that it is from.
        text: The document.
        values: New values by dotted key; a missing table is made.

    Raises:
        ConfigurationError: The document cannot be changed: its tables are too scattered.
    """
    try:
        document = tomlkit.parse(text)
    except TOMLKitError as problem:  # of some documents that are valid, too
        flaw = f"cannot be changed: {problem}; write the parts of each table one after another"
        raise ConfigurationError(path, [Flaw("file", flaw)]) from problem
    for key, value in values.items():
        *tables, name = key.split(".")
        table: Any = document
        for part in tables:
            table = table.setdefault(part, tomlkit.table())
        old = table.get(name)
        if old != value:
            stays = old is not None and not re.search(r"\d", old.trivia.comment)
            table[name] = value if stays else tomlkit.item(value).comment(ORIGIN)
    return tomlkit.dumps(document)


def write_values(path: Path, text: str) -> Path:
    """Replace a file at once, after a copy of it was made; its owner and its rights stay.

    Args:
        path: The file; where it is a symbolic link, the file that the link leads to is replaced.
        text: Its new content.

    Returns:
        The copy.

    Raises:
        ConfigurationError: The file or its copy cannot be written, or its owner cannot be kept.
    """
    with _writable(path) as file:
        backup = _free_backup(file)
        for place, content in ((backup, file.read_bytes()), (file, text.encode("utf-8"))):
            with _written(content, like=file) as new:
                new.replace(place)
    return backup


def _free_backup(file: Path) -> Path:
    """Return the path of a copy: what an earlier copy holds may be nowhere else."""
    names = (f"{file.name}.bak{number}" for number in chain([""], count(2)))
    return next(path for path in map(file.with_name, names) if not os.path.lexists(path))


def refuse_unwritable(path: Path) -> None:
    """Make sure that a file can be changed and replaced; it is as before.

    Raises:
        ConfigurationError: It cannot.
    """
    with_values(path, read_text(path), {})
    with _writable(path) as file, _written(file.read_bytes(), like=file):
        pass


@contextmanager
def _writable(path: Path) -> Iterator[Path]:
    """Name the file that is really written, and the configuration where that cannot be."""
    try:
        yield path.resolve(strict=True)
    except OSError as problem:
        flaw = Flaw("file", f"cannot be written: {problem}")
        raise ConfigurationError(path, [flaw]) from problem


@contextmanager
def _written(content: bytes, like: Path) -> Iterator[Path]:
    """Write a file next to another, with its owner and rights; it goes again unless it is moved."""
    handle, name = tempfile.mkstemp(dir=like.parent, prefix=f".{like.name}.")
    new = Path(name)
    try:
        with os.fdopen(handle, "wb") as stream:
            owner = like.stat()
            os.fchown(stream.fileno(), owner.st_uid, owner.st_gid)
            shutil.copystat(like, new)  # access control lists, too
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        yield new
    finally:
        new.unlink(missing_ok=True)
