"""The end of a demonstration in figures."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from adaptdrive.errors import RecordingError
from adaptdrive.recording.reader import read_session
from adaptdrive_sim.demo.judgement import shortcomings, tracking_error
from adaptdrive_sim.demo.record import Counts, DemoRecord
from adaptdrive_sim.demo.settings import DRIVE


class Places(msgspec.Struct, frozen=True):
    """Files and addresses of a demonstration.

    Attributes:
        bus: The bus.
        broker: The broker.
        directory: Folder with configuration, logs and sessions.
        session: The recorded session, None when there is none.
    """

    bus: str
    broker: str
    directory: Path
    session: Path | None


def summarise(record: DemoRecord, places: Places, failure: str | None) -> dict[str, Any]:
    """Everything worth knowing at the end, as one flat object for JSON.

    Args:
        record: What was heard.
        places: Where it was.
        failure: What ended the demonstration early; None when nothing did.
    """
    problems = ([failure] if failure else []) + list(shortcomings(record))
    return {
        "demo": DRIVE,
        "ok": not problems,
        "reason": "; ".join(problems),
        "bus": places.bus,
        "broker": places.broker,
        **_state(record),
        **_counts(record),
        **_times(places.session),
        "trips": record.trips,
        "tracking_error_rms": _finite(tracking_error(record), 4),
        "overshoot": _overshoot(record),
        "handover_step_V": _finite(max(record.handovers_V, default=math.nan), 3),
        "disks": record.truth.disks if record.truth else None,
        "estimates": _estimates(record),
        "truth": record.truth.parameters if record.truth else None,
        "directory": str(places.directory),
        "session": str(places.session) if places.session else None,
    }


def one_line(summary: dict[str, Any]) -> str:
    """Return a summary as one line of JSON."""
    return msgspec.json.encode(summary).decode()


def _state(record: DemoRecord) -> dict[str, Any]:
    state = record.state
    return {
        "state": state.state if state else None,
        "mode": state.mode if state else None,
        "controller": state.controller if state else None,
    }


def _counts(record: DemoRecord) -> dict[str, Any]:
    """Counters since control began."""
    counts = record.control or Counts(0.0, 0, 0, 0)
    return {
        "duration_s": round(counts.time_s, 3),
        "ticks": counts.ticks,
        "missed": counts.missed,
        "held": counts.held,
        "slow_periods": record.slow_periods,
    }


def _times(session: Path | None) -> dict[str, Any]:
    """Lateness and turnaround of every tick under control, from the recording."""
    names = ("lateness_us", "turnaround_us")
    try:
        ticks = read_session(session).ticks if session else None
    except RecordingError:
        ticks = None
    if ticks is None:
        return dict.fromkeys(names)
    running = np.asarray(ticks["stage"].to_pylist()) == "run"
    return {name: _quantiles(ticks[name].to_numpy()[running]) for name in names}


def _quantiles(times_us: Any) -> dict[str, float] | None:  # noqa: ANN401 - numpy's array
    times_us = times_us[np.isfinite(times_us)]
    if not times_us.size:
        return None
    found = np.percentile(times_us, (50.0, 99.0, 100.0)).tolist()
    return {name: round(us, 1) for name, us in zip(("p50", "p99", "max"), found, strict=True)}


def _overshoot(record: DemoRecord) -> dict[str, dict[str, float]]:
    """Overshoot as a fraction of the step, by controller and number of disks."""
    return {
        controller: {
            str(disks): round(found, 4)
            for disks in range(1, 4)
            if (found := record.halves.overshoot(controller, disks)) is not None
        }
        for controller in ("fixed", "adaptive")
    }


def _estimates(record: DemoRecord) -> dict[str, Any] | None:
    if record.load is None:
        return None
    return {name: msgspec.to_builtins(one) for name, one in record.load.estimates.items()}


def _finite(value: float, digits: int) -> float | None:
    return round(value, digits) if math.isfinite(value) else None
