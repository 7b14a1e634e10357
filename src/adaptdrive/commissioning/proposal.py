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
from scipy.signal import lfilter
from tomlkit.exceptions import TOMLKitError

from adaptdrive.analysis.model import LoopMargins, Model, model_of_configuration
from adaptdrive.analysis.replay import reconfigured
from adaptdrive.config.file import read_text
from adaptdrive.config.load import LoadTraits
from adaptdrive.config.root import Configuration
from adaptdrive.control.design.noise import DELAY_MARGIN, MODULUS_MARGIN
from adaptdrive.control.loads.load import to_input
from adaptdrive.control.signals import Estimate
from adaptdrive.identification import proposed_model
from adaptdrive.identification.result import IdentifiedLoad
from adaptdrive.util.errors import CommissionError, ConfigurationError, Flaw

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
_LEAST_GAIN = 1.0 / (1.0 - MODULUS_MARGIN)
"""Least gain margin: that of the adaptive law. No pole brings a load without a lag, such as a
battery, to 2: at half the sampling rate its L lies more than half the way to -1."""

_STEP_SHARE = 0.1
_EFFORT_SHARE = 0.5
"""Share of the range of V_c that a set-point step of a tenth of its range may take."""


def _effort(model: Model) -> float:
    """Return the largest input after a unit step of the set-point."""
    inputs = lfilter(model.s.sum() * model.a, model.closed_loop, np.ones(_STEPS))
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
    margins: LoopMargins


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
        loop = model_of_configuration(configuration)
        if _suffices(loop, configuration):
            return Proposal(tried, model, configuration, loop.margins)
    raise CommissionError(
        f"no pole up to {_POLES[-1]:g} gives a gain margin of {_LEAST_GAIN:.3g}, "
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


def _suffices(loop: Model, configuration: Configuration) -> bool:
    section, limits, margins = configuration.load, configuration.drive.limits, loop.margins
    if margins.gain < _LEAST_GAIN or margins.delay_s < DELAY_MARGIN * section.period_s:
        return False
    low, high = (
        to_input(volts, loop.load.input_gain, loop.load.input_exponent)
        for volts in (limits.boost_reference_min_V, limits.boost_reference_max_V)
    )
    step = _STEP_SHARE * (section.reference_max - section.reference_min)
    return _effort(loop) * step <= _EFFORT_SHARE * (high - low)


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
