"""The recorder of a drive, and the checkpoint of what the drive's load has taught.

It is a record of the log. It counts only for the configuration that it was made with, of which it
carries a hash; another one is not used, with a warning.
"""

import hashlib
import json
import math
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec

from adaptdrive import __version__
from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings
from adaptdrive.config import Configuration
from adaptdrive.config.bus import SignalSource
from adaptdrive.config.section import si_unit
from adaptdrive.control.estimation.direct import METHODS
from adaptdrive.control.loads.load import OFFSET, Load
from adaptdrive.control.settings import ControllerSettings, SupervisionLimits
from adaptdrive.devices.description import description_text
from adaptdrive.recording import log_files, recorder, records, session
from adaptdrive.runtime.reports import Event, Hub, LoadReport, Severity
from adaptdrive.util.clock import now_s
from adaptdrive.util.errors import NOT_JSON, RecordingError, escaped

# The checkpoint: trusted estimates, and the resolution of the sensor, that survive a restart.

_EVERY_S = 60.0
"""Shortest time between two records."""

_REPORTS_HELD = 8
_LEAST_SHARE = 1e-3
"""Least 1 - ρ: without forgetting an estimate would know all that there ever was."""

_MEASURED = ("drive", "bus", "signals", "sensor_bus", "derived", "voltage_loop")
_INPUT = {"turns_ratio", "droop_Ohm", "heater_Ohm"}
_MEANING: dict[str, Any] = {
    **dict.fromkeys(_MEASURED, True),
    "load": {"type": True, "model": _INPUT},
}
"""Keys of measurement, drive and input; `adaptdrive commission` changes none of them."""

_DESCRIPTIONS = ("database", "eds")
"""Keys of a bus that name a file in which scales and offsets of its signals are."""

_PLACES: Any = {"bus": set(_DESCRIPTIONS), "sensor_bus": {"__all__": set(_DESCRIPTIONS)}}
"""The same file means the same in another folder: its contents count."""

Values = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Learnt:
    """Estimates and resolution that a run hands on to the next.

    Attributes:
        values: Physical parameters in the order of `Load.names`; None where nothing is trusted yet.
        resolution: Step of the output, in its unit; 0 where none was found.
    """

    values: Values | None = None
    resolution: float = 0.0


class Checkpoint(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Contents of a checkpoint.

    Attributes:
        key: Hash of the configuration that the estimates were made with.
        estimates: Physical parameters by name.
        resolution: Step of the output; left out where none was found.
    """

    key: str
    estimates: dict[str, float]
    resolution: float = 0.0


def configuration_key(configuration: Configuration) -> str:
    """Hash of everything in a configuration that gives estimates their meaning."""
    sections = configuration.model_dump(mode="json", include=_MEANING, exclude=_PLACES)
    text = json.dumps([sections, descriptions(configuration)], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def descriptions(configuration: Configuration) -> list[str]:
    """Return hashes of the files that describe the signals of the buses of a configuration."""
    buses = configuration.bus, *configuration.sensor_bus
    files = [getattr(bus, name, None) for bus in buses for name in _DESCRIPTIONS]
    return [_contents(one) for one in files if one is not None]


def _contents(path: Path | Sequence[Path]) -> str:
    """Return a hash of a description, which means the same in another folder; empty without one."""
    try:
        text = description_text(path) if isinstance(path, Path) else "".join(map(_contents, path))
    except (OSError, ValueError):
        return ""
    return hashlib.sha256(text.encode()).hexdigest()


def is_kept(settings: ControllerSettings) -> bool:
    """Return whether this controller's estimates are physical parameters that it can start from."""
    return settings.exact and METHODS[settings.learning.method].physical


def checkpoint_record(key: str, names: tuple[str, ...], learnt: Learnt) -> bytes:
    """Return a checkpoint as it is in the log.

    Args:
        key: Hash of the configuration.
        names: Names of the parameters.
        learnt: What was learnt.
    """
    estimates = dict(zip(names, learnt.values or (), strict=True))
    return msgspec.json.encode(Checkpoint(key, estimates, learnt.resolution))


def recall(
    record: bytes,
    configuration: Configuration,
    settings: ControllerSettings,
    load: Load,
    *,
    measured: bool = False,
) -> tuple[Learnt, Event | None]:
    """Return what to start from, and the event that reports it.

    Args:
        record: The checkpoint, as it is in the log; empty for none.
        configuration: Of the drive.
        settings: Of its controller.
        load: Its load.
        measured: Whether the nominal model of the load was measured: then of what an earlier run
            has learnt only the resolution stays.
    """
    if not is_kept(settings):
        return Learnt(), None
    learnt, event = Learnt(), None
    if record:
        learnt, event = _recalled(record, configuration, settings.supervision, load)
    if measured:
        learnt = Learnt(_nominal(load), learnt.resolution)
        event = _start(load, learnt, "the measured model")
    return learnt, event


def _recalled(
    record: bytes, configuration: Configuration, supervision: SupervisionLimits, load: Load
) -> tuple[Learnt, Event]:
    try:
        checkpoint = msgspec.json.decode(record, type=Checkpoint)
    except NOT_JSON as problem:
        flaw = f"damaged: {problem}"
    else:
        flaw = _flaw(checkpoint, configuration, supervision, load)
    if flaw:
        return Learnt(), _event(Severity.WARNING, f"checkpoint not used: {flaw}")
    values = tuple(checkpoint.estimates[name] for name in load.names)
    learnt = Learnt(values, checkpoint.resolution)
    return learnt, _start(load, learnt, "trusted estimates")


def _flaw(
    checkpoint: Checkpoint, configuration: Configuration, supervision: SupervisionLimits, load: Load
) -> str:
    """Return why a checkpoint must not be used, empty for a sound one."""
    if checkpoint.key != configuration_key(configuration):
        return "it was made with another configuration"
    if set(checkpoint.estimates) != set(load.names):
        return f"it holds {', '.join(checkpoint.estimates) or 'nothing'}"
    for name, usual in zip(load.names, _nominal(load), strict=True):
        value = checkpoint.estimates[name]
        if not supervision.ratio_min <= value / usual <= supervision.ratio_max:
            return f"{name} = {value:.4g} is out of bounds"
    orders = configuration.load
    if not 0.0 <= checkpoint.resolution < orders.reference_max - orders.reference_min:
        return f"resolution = {checkpoint.resolution:.4g} is out of bounds"
    return ""


def _nominal(load: Load) -> Values:
    return tuple(load.physical(list(load.numerator), list(load.denominator)))


def _start(load: Load, learnt: Learnt, source: str) -> Event:
    known = ", ".join(f"{n} {v:.4g}" for n, v in zip(load.names, learnt.values or (), strict=True))
    detail = f"start from {source}, whose gains act at once: {known}"
    return _event(Severity.INFO, detail)


def _event(severity: Severity, detail: str) -> Event:
    return Event("checkpoint", severity, detail, 0)


async def keep_learnt(
    note: Callable[[Learnt], None],
    learnt: Callable[[], Learnt],
    hub: Hub,
    clock: Callable[[], float],
) -> None:
    """Have the log keep trusted estimates until cancelled: at most once a minute, and at the end.

    Args:
        note: Hands a checkpoint over to the log, at once.
        learnt: Returns what the controller has learnt.
        hub: Where slow periods are reported.
        clock: Monotonic clock in seconds.
    """
    reports, noted, next_s = hub.subscribe(LoadReport, size=_REPORTS_HELD), Learnt(), clock()
    try:
        while True:
            await reports.take()
            present = learnt()
            if clock() >= next_s and _is_new(present, noted):
                note(present)
                noted, next_s = present, clock() + _EVERY_S
    finally:
        present = learnt()
        if _is_new(present, noted):
            note(present)


def _is_new(learnt: Learnt, noted: Learnt) -> bool:
    return learnt.values is not None and learnt != noted


# The recorder of a drive, as its configuration asks for.


def build_recorder(  # noqa: PLR0913, PLR0917 - of a drive
    configuration: Configuration,
    text: str,
    hub: Hub,
    recalled: log_files.Recalled,
    learnt: Learnt,
    start_thread: Callable[[], None],
) -> recorder.Recorder:
    """Build the recorder; nothing touches the disk before it runs.

    Args:
        configuration: The drive.
        text: Its configuration, as TOML.
        hub: Where reports come from.
        recalled: What an earlier run has left in the log.
        learnt: What its controller starts from, of an earlier run.
        start_thread: What a thread does first.

    Raises:
        RecordingError: The name of a folder is not UTF-8.
    """
    recording = configuration.recording
    size = recording.keep_MB
    header = records.Header(
        info=_info(configuration, learnt),
        config_text=text,
        segment_s=recording.segment_s,
        keep=records.Keep(recording.keep_days, None if size is None else round(size * 1e6)),
        health=health_settings(configuration),
    )
    pace = records.Pace(start_thread=start_thread)
    clock = lambda: (now_s(), time.time())  # noqa: E731
    return recorder.Recorder(*place_of(configuration), header, hub, clock, pace, recalled)


def health_settings(configuration: Configuration) -> records.HealthSettings:
    """Return what gives the estimates of a drive their meaning for the health of its load."""
    settings, load = controller_settings(configuration), build_load(configuration)
    if not is_kept(settings):
        return records.HealthSettings()
    share = max(1.0 - settings.learning.forgetting, _LEAST_SHARE)
    return records.HealthSettings(
        products=load.products,
        loss=load.loss,
        share=share,
        least_excitation=settings.learning.gate * share,
        bounds={
            name: (
                -math.inf if one.min is None else one.min,
                math.inf if one.max is None else one.max,
            )
            for name, one in configuration.health.bounds.items()
        },
    )


def health_names(configuration: Configuration) -> tuple[str, ...]:
    """Return the quantities of the load that health knows, none without physical parameters."""
    settings, load = controller_settings(configuration), build_load(configuration)
    if not is_kept(settings):
        return ()
    offset = (OFFSET, load.loss) if settings.learning.bias else ()
    return (*load.names, *load.products, *offset)


def place_of(configuration: Configuration) -> tuple[Path, Path | None]:
    """Return the folders of the log and of the sessions of a drive, None where none is recorded.

    Raises:
        RecordingError: The name of the folder of sessions is not UTF-8.
    """
    recording = configuration.recording
    state = _absolute(state_directory())
    sessions = _sessions(recording.directory) if recording.enabled else None
    return state / f"{configuration.drive.name}.log", sessions


def state_directory() -> Path:
    """Return the state directory of the daemon: the service manager's folder, else `./state`."""
    return Path(os.environ.get("STATE_DIRECTORY", "").partition(":")[0] or "state")


def _sessions(configured: Path | None) -> Path:
    """Return the folder of sessions, whose name is in the log as text."""
    sessions = _absolute(session.sessions_directory(configured, os.environ))
    try:
        str(sessions).encode()
    except UnicodeEncodeError as problem:
        raise RecordingError(
            escaped(str(sessions)),
            "the name of the folder of sessions is not UTF-8; recording.directory may name another",
        ) from problem
    return sessions


def _absolute(path: Path) -> Path:
    """Return a path from the root, or as it is where the present folder has been deleted."""
    try:
        return path.absolute()
    except FileNotFoundError:
        return path


def sensor_columns(configuration: Configuration) -> tuple[session.SensorColumn, ...]:
    """Return a column for each value of each sensor bus, and one for its age."""
    columns = []
    for bus in configuration.sensor_bus:
        for name, quantity in bus.signals.items():
            column, source = f"{bus.name}.{name}", f"sensor bus {bus.name}"
            about = f"last value of {name}, {quantity.signal}"
            columns.append(session.SensorColumn(column, _unit(name, quantity), about, source))
            columns.append(session.SensorColumn(f"{column}.age_s", "s", f"age of {name}", source))
    return tuple(columns)


def _unit(name: str, quantity: SignalSource) -> str:
    """Return the SI unit of a value, from its conversion or from the end of its name."""
    stated, last = si_unit(quantity.unit) if quantity.unit else None, name.rpartition("_")[2]
    return stated or (last if last in UNITS else "")


UNITS = {"V", "A", "W", "K", "S", "s", "Hz", "rad", "m", "kg", "N", "Pa", "C"}
"""Units that a name may end with; values of sensors are in SI."""


def _info(configuration: Configuration, learnt: Learnt) -> session.SessionInfo:
    return session.SessionInfo(
        drive=configuration.drive.name,
        version=__version__,
        started=datetime.now(UTC),
        ticks_per_period=configuration.ticks_per_period,
        latency_ticks=configuration.load.latency_ticks,
        line_frequency_Hz=configuration.drive.line_frequency_Hz,
        prior=learnt.values,
        resolution=learnt.resolution,
        output_unit=configuration.load.output_unit,
        display=configuration.load.display if configuration.load.output_display else None,
        manipulated=configuration.drive.given,
        sensors=sensor_columns(configuration),
    )
