"""The recorder of a drive, as its configuration asks for."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from adaptdrive import __version__
from adaptdrive.app.learned_state import Learnt
from adaptdrive.config import Configuration
from adaptdrive.config.bus import SignalSource
from adaptdrive.config.units import si_unit
from adaptdrive.recording.journal import Place, RecordingPace
from adaptdrive.recording.journal_files import Recalled, log_folder
from adaptdrive.recording.recorder import Recorder
from adaptdrive.recording.records import Header, Keep
from adaptdrive.recording.session import SensorColumn, SessionInfo, sessions_directory
from adaptdrive.runtime.reports import Hub
from adaptdrive.util.clock import now_s
from adaptdrive.util.errors import RecordingError, escaped


def build_recorder(  # noqa: PLR0913, PLR0917 - of a drive
    configuration: Configuration,
    text: str,
    hub: Hub,
    recalled: Recalled,
    learnt: Learnt,
    start_thread: Callable[[], None],
) -> Recorder:
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
    header = Header(
        info=_info(configuration, learnt),
        config_text=text,
        segment_s=recording.segment_s,
        keep=Keep(recording.keep_days, None if size is None else round(size * 1e6)),
    )
    pace = RecordingPace(flush_s=recording.flush_s, start_thread=start_thread)
    place = place_of(configuration)
    return Recorder(place, header, hub, lambda: (now_s(), time.time()), pace, recalled)


def place_of(configuration: Configuration) -> Place:
    """Return the folders of the log and of the sessions of a drive.

    Raises:
        RecordingError: The name of the folder of sessions is not UTF-8.
    """
    recording = configuration.recording
    state = _absolute(state_directory())
    sessions = _sessions(recording.directory) if recording.enabled else None
    return Place(log_folder(state, configuration.drive.name), sessions)


def state_directory() -> Path:
    """Return the state directory of the daemon: the service manager's folder, else `./state`."""
    return Path(os.environ.get("STATE_DIRECTORY", "").partition(":")[0] or "state")


def _sessions(configured: Path | None) -> Path:
    """Return the folder of sessions, whose name is in the log as text."""
    sessions = _absolute(sessions_directory(configured, os.environ))
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


def sensor_columns(configuration: Configuration) -> tuple[SensorColumn, ...]:
    """Return a column for each value of each sensor bus, and one for its age."""
    columns = []
    for bus in configuration.sensor_bus:
        for name, quantity in bus.signals.items():
            column, source = f"{bus.name}.{name}", f"sensor bus {bus.name}"
            about = f"last value of {name}, {quantity.signal}"
            columns.append(SensorColumn(column, _unit(name, quantity), about, source))
            columns.append(SensorColumn(f"{column}.age_s", "s", f"age of {name}", source))
    return tuple(columns)


def _unit(name: str, quantity: SignalSource) -> str:
    """Return the SI unit of a value, from its conversion or from the end of its name."""
    stated, last = si_unit(quantity.unit) if quantity.unit else None, name.rpartition("_")[2]
    return stated or (last if last in UNITS else "")


UNITS = {"V", "A", "W", "K", "S", "s", "Hz", "rad", "m", "kg", "N", "Pa", "C"}
"""Units that a name may end with; values of sensors are in SI."""


def _info(configuration: Configuration, learnt: Learnt) -> SessionInfo:
    return SessionInfo(
        drive=configuration.drive.name,
        version=__version__,
        started=datetime.now(UTC),
        ticks_per_period=configuration.ticks_per_period,
        latency_ticks=configuration.load.latency_ticks,
        line_frequency_Hz=configuration.drive.line_frequency_Hz,
        prior=learnt.values,
        resolution=learnt.resolution,
        output_unit=configuration.load.output_unit,
        manipulated=configuration.drive.given,
        sensors=sensor_columns(configuration),
    )
