"""The checkpoint: trusted estimates, and the resolution of the sensor, that survive a restart.

One small JSON file beside the other state of a drive, replaced as a whole. It counts only for the
configuration that it was made with, of which it carries a hash; anything else is left alone, with
a warning. Writing waits for the disk in a thread, never in the control loop.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Protocol

import msgspec

from adaptdrive.config import Configuration
from adaptdrive.control.controller import Controller
from adaptdrive.control.load import Load
from adaptdrive.control.settings import ControllerSettings, Jacket
from adaptdrive.errors import NOT_JSON, AdaptdriveError, reason_of
from adaptdrive.files import read_regular, replace_regular
from adaptdrive.hardware.description import description_text
from adaptdrive.runtime.hub import Hub
from adaptdrive.runtime.reports import Event, LoadReport, Severity

FORMAT = 1

_EVERY_S = 60.0
"""Shortest time between two writes."""

PATIENCE_S = 5.0
"""Longest wait for the disk: one that hangs must not keep the daemon from ending."""

_REPORTS_HELD = 8
_SECTIONS = {
    *("drive", "bus", "signals", "sensor_bus", "derived"),  # what is measured, and of which drive
    *("voltage_loop", "load", "estimator"),
}
_LIMITS = {"load": {"charge"}}
"""Within them: what only ends a charge."""

_DESCRIPTIONS = ("database", "databases", "eds")
"""Keys of a bus that name a file in which scales and offsets of its signals are."""

Values = tuple[float, ...]


class EstimateSource(Protocol):
    """Source of trusted estimates: a controller."""

    @property
    def trusted(self) -> Values | None:
        """The last trusted estimates, None before there are any."""

    @property
    def resolution(self) -> float:
        """The step of the output that was found in its samples, 0 for none."""


@dataclass(frozen=True, slots=True)
class Learnt:
    """Estimates and resolution that a run hands on to the next.

    Attributes:
        values: Physical parameters in the order of `Load.names`.
        resolution: Step of the output, in its unit; 0 where none was found.
    """

    values: Values
    resolution: float = 0.0


class CheckpointError(AdaptdriveError):
    """A checkpoint cannot be used."""

    def __init__(self, path: Path, problem: str) -> None:
        self.path = path
        self.problem = problem
        super().__init__(f"{path}: {problem}")


class Checkpoint(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Contents of a checkpoint file.

    Attributes:
        key: Hash of the configuration that the estimates were made with.
        saved: When, UTC.
        estimates: Physical parameters by name.
        format: Version of this layout.
        resolution: Step of the output; left out where none was found, and by older versions.
    """

    key: str
    saved: datetime
    estimates: dict[str, float]
    format: int
    resolution: float = 0.0


class _CheckpointFormat(msgspec.Struct):
    format: int


def checkpoint_path(state: Path, drive: str) -> Path:
    """Return the path of the checkpoint of a drive."""
    return state / f"{drive}.estimates.json"


def configuration_key(configuration: Configuration) -> str:
    """Hash of everything in a configuration that gives estimates their meaning."""
    sections = configuration.model_dump(mode="json", include=_SECTIONS, exclude=_LIMITS)
    for bus in (sections["bus"], *sections["sensor_bus"]):
        bus |= {name: _contents(bus[name]) for name in _DESCRIPTIONS if name in bus}
    text = json.dumps(sections, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _contents(path: str | list[str]) -> str:
    """Return a hash of a description, which means the same in another folder; empty without one."""
    try:
        text = "".join(map(_contents, path)) if isinstance(path, list) else _text(path)
    except (OSError, ValueError):
        return ""
    return hashlib.sha256(text.encode()).hexdigest()


def _text(path: str) -> str:
    return description_text(Path(path))


def is_kept(settings: ControllerSettings) -> bool:
    """Return whether this controller's estimates are physical parameters that it can start from."""
    return settings.exact and settings.learning.method.physical


def write_checkpoint(path: Path, key: str, names: tuple[str, ...], learnt: Learnt) -> None:
    """Replace the checkpoint, so that a reader sees the old one or the new one, whole.

    Raises:
        OSError: The disk refuses.
    """
    estimates = dict(zip(names, learnt.values, strict=True))
    checkpoint = Checkpoint(key, datetime.now(UTC), estimates, FORMAT, learnt.resolution)
    replace_regular(path, msgspec.json.format(msgspec.json.encode(checkpoint), indent=2) + b"\n")


def read_checkpoint(path: Path, key: str, load: Load, jacket: Jacket, span: float) -> Learnt | None:
    """Return what an earlier run has learnt.

    Args:
        path: The file.
        key: Hash of the present configuration.
        load: What the estimates are of.
        jacket: Bounds that they must be within.
        span: Range of the set-points, in the unit of the output: a sensor's step is below it.

    Returns:
        Its trusted estimates and the resolution that it found; None where there is no file.

    Raises:
        CheckpointError: There is one that must not be used.
    """
    try:
        text = read_regular(path)
    except FileNotFoundError:
        return None
    except OSError as problem:
        raise CheckpointError(path, reason_of(problem)) from problem
    checkpoint = _decode(path, text)
    if checkpoint.key != key:
        raise CheckpointError(path, "it was made with another configuration")
    if set(checkpoint.estimates) != set(load.names):
        raise CheckpointError(path, f"it holds {', '.join(checkpoint.estimates) or 'nothing'}")
    values = tuple(checkpoint.estimates[name] for name in load.names)
    nominal = load.physical(list(load.numerator), list(load.denominator))
    for name, value, usual in zip(load.names, values, nominal, strict=True):
        if not jacket.ratio_min <= value / usual <= jacket.ratio_max:
            raise CheckpointError(path, f"{name} = {value:.4g} is out of bounds")
    if not 0.0 <= checkpoint.resolution < span:
        raise CheckpointError(path, f"resolution = {checkpoint.resolution:.4g} is out of bounds")
    return Learnt(values, checkpoint.resolution)


def _decode(path: Path, text: bytes) -> Checkpoint:
    try:
        version = msgspec.json.decode(text, type=_CheckpointFormat).format
        if version != FORMAT:
            raise CheckpointError(path, f"format {version} is not {FORMAT}, the one known here")
        return msgspec.json.decode(text, type=Checkpoint)
    except NOT_JSON as problem:
        raise CheckpointError(path, f"damaged: {problem}") from problem


def recall(
    path: Path, configuration: Configuration, settings: ControllerSettings, load: Load
) -> tuple[Learnt | None, Event | None]:
    """Return what to start from, and the event that reports it.

    Args:
        path: The checkpoint.
        configuration: Of the drive.
        settings: Of its controller.
        load: Its load.
    """
    if not is_kept(settings):
        return None, None
    try:
        key, orders = configuration_key(configuration), configuration.load
        span = orders.reference_max - orders.reference_min
        learnt = read_checkpoint(path, key, load, settings.jacket, span)
    except CheckpointError as problem:
        return None, _event(Severity.WARNING, f"checkpoint not used: {problem}")
    if learnt is None:
        return None, None
    known = ", ".join(f"{n} {v:.4g}" for n, v in zip(load.names, learnt.values, strict=True))
    confirm = settings.jacket.confirm_periods
    detail = f"start from trusted estimates: {known}; to be confirmed for {confirm} slow periods"
    return learnt, _event(Severity.INFO, detail)


def controller_from(settings: ControllerSettings, load: Load, learnt: Learnt | None) -> Controller:
    """Return a controller at rest that begins with what an earlier run has learnt.

    Args:
        settings: Of the controller.
        load: Its load.
        learnt: None for nothing.
    """
    if learnt is None:
        return Controller(settings, load)
    return Controller(settings, load, learnt.values, learnt.resolution)


def _event(severity: Severity, detail: str) -> Event:
    return Event("checkpoint", severity, detail, 0)


class Keeper:
    """Writes trusted estimates to disk: when they are accepted, at most once a minute."""

    def __init__(
        self,
        write: Callable[[Learnt], None],
        source: EstimateSource,
        hub: Hub,
        clock: Callable[[], float],
    ) -> None:
        """Join the controller to its file.

        Args:
            write: Replaces the file; may raise `OSError`.
            source: The controller.
            hub: Where slow periods are reported, and trouble.
            clock: Monotonic clock in seconds.
        """
        self._write = write
        self._source = source
        self._hub = hub
        self._clock = clock
        self._reports = hub.subscribe(LoadReport, size=_REPORTS_HELD)
        self._written: Learnt | None = None
        self._next_s = clock()
        self._failed = False
        self._writing: asyncio.Future[None] | None = None

    async def run(self) -> None:
        """Keep what is accepted until cancelled."""
        while True:
            await self._reports.take()
            if self._clock() >= self._next_s:
                await self.save()

    async def save(self) -> None:
        """Write the trusted estimates and the resolution now, if they are new."""
        values = self._source.trusted
        if values is None:
            return
        learnt = Learnt(values, self._source.resolution)
        if learnt == self._written:
            return
        self._next_s = self._clock() + _EVERY_S
        if self._writing is not None and not self._writing.done():
            return  # a disk that hangs gets one thread, not one a minute
        self._writing = asyncio.get_running_loop().run_in_executor(None, self._write, learnt)
        try:
            async with asyncio.timeout(PATIENCE_S):
                await asyncio.shield(self._writing)
        except OSError as problem:
            self._report_once(problem)
        else:
            self._written, self._failed = learnt, False

    def _report_once(self, problem: OSError) -> None:
        if not self._failed:
            why = reason_of(problem) or f"the disk takes more than {PATIENCE_S:g} s"
            detail = f"checkpoint not written: {why}"
            self._hub.publish(_event(Severity.WARNING, detail))
        self._failed = True
