"""Commands on recorded sessions: list, show, verify, prune; their events; the controller again."""

import math
import os
import sys
from collections.abc import Iterator
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

from cyclopts import App, Parameter

from adaptdrive.analysis import replay as replaying
from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings
from adaptdrive.cli import options
from adaptdrive.cli.explain import with_kind
from adaptdrive.cli.options import Json, Settings, print_each, print_json, refusing
from adaptdrive.config import Configuration
from adaptdrive.control.controller import Controller
from adaptdrive.recording import health as load_health
from adaptdrive.recording import log_files, overview, reader, segments
from adaptdrive.recording import session as folders
from adaptdrive.recording.records import Keep, Kind
from adaptdrive.runtime.reports import EVENT_KINDS
from adaptdrive.safety.trips import kind_of, remedy
from adaptdrive.util import files, trends
from adaptdrive.util.errors import ConfigurationError, Flaw, RecordingError, escaped, nearest

app = App(name="sessions")

_LARGEST_LIMIT = 1e12


_check_limit = refusing(
    lambda limit: 0.0 < limit <= _LARGEST_LIMIT,
    f"A limit is a number above 0 and at most {_LARGEST_LIMIT:g}.",
)


def _refuse_unknown(kinds: tuple[str, ...]) -> None:
    known = ", ".join(EVENT_KINDS)
    flaws = [
        Flaw(kind, f"no event is of this kind{nearest(kind, EVENT_KINDS)}; known: {known}")
        for kind in kinds
        if kind not in EVENT_KINDS
    ]
    if flaws:
        raise ConfigurationError("--kind", flaws)


Limit = Annotated[float | None, Parameter(validator=_check_limit)]
Folder = Annotated[Path | None, Parameter(name="--directory")]


@app.command(name="list")
def list_sessions(*, directory: Folder = None, as_json: Json = False) -> int:
    """List the sessions of this machine, the oldest first.

    Args:
        directory: Folder of the sessions; $STATE_DIRECTORY/sessions or ./sessions when left out.
        as_json: Print JSON.
    """
    every = folders.session_directories(_folder(directory), folders.PARTS)
    if not print_each(map(_listed, every), as_json) and not as_json:
        print(f"adaptdrive: {_folder(directory)}: {folders.NO_SESSION}", file=sys.stderr)
    return 0


def _listed(path: Path) -> tuple[str, dict[str, Any]]:
    """Return the line of a session in the list, and the same for programs."""
    try:
        info = folders.read_info(path)
    except RecordingError as problem:
        damaged = {"session": escaped(path.name), "damaged": str(problem)}
        return f"{path.name}  damaged: {problem}", damaged
    facts = _facts(path, info)
    trips = len(facts["trips"])
    lost = f", not recorded: {info.dropped}" if info.dropped != folders.Dropped() else ""
    tripped = f", {trips} trips" if trips else ""
    size = f"{facts['bytes'] / 1e6:9.1f} MB"
    return f"{path.name}  {info.ended:<8} {size}{tripped}{lost}", facts


@app.command
def show(session: str, /, *, directory: Folder = None, as_json: Json = False) -> int:
    """Show the contents of a session.

    Args:
        session: Folder of the session, or its name in the folder of sessions.
        directory: Folder of the sessions.
        as_json: Print JSON.
    """
    found = opened(session, directory)
    info, last, facts = found.info, found.last_tick, _facts(found.path, found.info)
    numbers = (segment.number for segment in segments.segments(found.path, info))
    unread = "damaged" if found.damage else ""
    rows = [
        ("session", str(found.path)),
        ("drive", info.drive),
        ("recorded by", f"adaptdrive {info.version}, format {info.format}"),
        ("started", info.started.isoformat()),
        ("last tick", last.isoformat() if last else "not known"),
        ("ended", info.ended.value),
        ("not recorded", str(info.dropped)),
        ("segments", str(max(numbers, default=0))),
        ("events", unread or str(len(found.events))),
        ("commands", unread or str(len(found.commands))),
        ("trips", ", ".join(facts["trips"]) or unread or "none"),
        ("size", f"{facts['bytes'] / 1e6:.1f} MB"),
    ]
    if as_json:
        print_json(facts)
    else:
        print("\n".join(f"{name:<14}{text}" for name, text in rows))
    return 0


@app.command
def verify(*sessions: str, directory: Folder = None, as_json: Json = False) -> int:
    """Read all data of sessions and check the checksum of every page.

    Args:
        sessions: Folders of sessions, or names in the folder of sessions; all of that folder
            when left out.
        directory: Folder of the sessions.
        as_json: Print JSON.

    Returns:
        0 when nothing is damaged or missing, and no session was cut that the next start closes.
    """
    status = 0
    verdicts: dict[str, object] = {}
    named = [(name, _find(name, directory)) for name in sessions]
    every = folders.session_directories(_folder(directory), folders.PARTS)
    found = named or [(path.name, path) for path in every]
    for path in () if sessions else (path for _, path in found):
        if left := _left(path):
            status |= log_files.last_of(left, Kind.END) is None
            text = f"{path.name}: data and events that the next start of the daemon writes"
            print(f"adaptdrive: {text} into it", file=sys.stderr)
    for name, path in found:
        try:
            verdict = reader.verify(reader.read_session(path))
        except RecordingError as damage:  # the others are verified all the same
            verdict = reader.Verification({}, 0, (str(damage),))
        status = status if verdict.whole else 1
        if as_json:
            verdicts[escaped(name)] = {"whole": verdict.whole, **asdict(verdict)}
            continue
        rows = ", ".join(f"{count} {table}" for table, count in verdict.rows.items()) or "nothing"
        condition = "whole" if verdict.whole else "damaged"
        if verdict.missing_ticks:
            condition = f"{verdict.missing_ticks} ticks are missing"
        print(f"{name}: {rows}; {condition}")
        for problem in verdict.problems:
            print(f"adaptdrive: {name}: {problem}", file=sys.stderr)
    if as_json:
        print_json(verdicts)
    return status


@app.command
def prune(
    *,
    keep_days: Annotated[Limit, Parameter(name="--keep-days")] = None,
    keep_MB: Annotated[Limit, Parameter(name="--keep-MB")] = None,
    directory: Folder = None,
    as_json: Json = False,
) -> int:
    """Remove old sessions, except the session that is being written.

    Args:
        keep_days: Remove what began longer ago.
        keep_MB: Remove the oldest while all take more.
        directory: Folder of the sessions.
        as_json: Print JSON: a sentence for each removal.
    """
    keep = Keep(keep_days, None if keep_MB is None else round(keep_MB * 1e6))
    removals = segments.prune(_folder(directory), keep, datetime.now(UTC))
    print_each(((sentence, sentence) for sentence in removals), as_json)
    if _folder(directory).is_dir():
        overview.update_index(_folder(directory))
    return 0


def events(
    session: str | None = None,
    /,
    *,
    kind: Annotated[tuple[str, ...], Parameter(negative=())] = (),
    directory: Folder = None,
    as_json: Json = False,
) -> int:
    """Show the events of a session, each trip with its kind and its remedy.

    Args:
        session: Folder of the session, or its name; the last one when left out.
        kind: Only events of these kinds.
        directory: Folder of the sessions.
        as_json: Print JSON.
    """
    _refuse_unknown(kind)
    noted, _ = reader.session_notes(_find(session, directory))
    found = [one for one in noted if not kind or one.kind in kind]
    if as_json:
        print_json(found)
        return 0
    counts = [] if kind else [one for one in found if one.kind == "latency"]
    for one in found:
        if one in counts[:-1]:  # there is one in each minute: the last says it all
            continue
        detail = with_kind(one.detail, one.trip_kind)
        print(f"{one.time.isoformat()}  {one.severity:<8} {one.kind:<12} {detail}")
        if steps := remedy(kind_of(one.trip_kind)):
            print(f"{'':<34}{'':<8} {'remedy':<12} {steps}")
    return 0


def _left(path: Path) -> list[log_files.LogFile]:
    """Return the files in the log with what a daemon that is gone has left of a session there."""
    try:
        info = folders.read_info(path)
        found = log_files.unarchived(path, info)
        return [] if log_files.in_progress(path, info) else found
    except RecordingError:
        return []  # it is verified all the same


def _facts(path: Path, info: folders.SessionInfo) -> dict[str, Any]:
    return {
        "session": escaped(path.name),
        "bytes": segments.size_of(path),
        "trips": sorted(one.name for one in path.glob("trip-*")),
        "info": info,
    }


def _folder(directory: Path | None) -> Path:
    """Return the folder of sessions.

    Raises:
        RecordingError: The folder that was named is none.
    """
    if directory is not None and not directory.is_dir():
        raise RecordingError(directory, "there is no such folder")
    return folders.sessions_directory(directory, os.environ)


def _find(name: str | None, directory: Path | None) -> Path:
    return reader.find_session(name, _folder(directory))


def opened(name: str | None, directory: Path | None = None) -> reader.Session:
    """Return a session; name on standard error what of its events cannot be read.

    Args:
        name: Its folder, or its name in the folder of sessions; None for the last one.
        directory: Folder of the sessions, that of this machine when None.
    """
    session = reader.read_session(_find(name, directory))
    if session.damage:
        print(f"adaptdrive: {session.damage}", file=sys.stderr)
    return session


# `adaptdrive replay`: the controller again, on recorded measurements.


def replay(session: str | None = None, /, *, settings: Settings = (), as_json: Json = False) -> int:
    """Run the controller again on the measurements of a recorded session.

    Args:
        session: Folder of the session, or its name below the sessions of this machine; the last one
            when left out.
        settings: Setting to change, KEY=VALUE, such as estimator.forgetting=0.95; may be repeated.
        as_json: Print JSON, for programs.

    Returns:
        0 when every command is bit-equal, or when settings were given, so that differences are
        the answer; else 1.

    Raises:
        AdaptdriveError: There is no such session, or a setting is not valid.
    """
    record = opened(session)
    text, source = record.config_text, record.path / folders.CONFIG_FILE
    configuration = replaying.reconfigured(text, source, settings)
    report = replaying.replay(record, controller_at_start(record.info, configuration))
    for setting in settings:
        if not replaying.acts(text, source, setting, _acting):
            print(f"adaptdrive: {setting}: {_WITHOUT_EFFECT}", file=sys.stderr)
    if as_json:
        print_json({"bit_equal": report.exact, **asdict(report)})
    else:
        print(report)
    return 0 if report.exact or settings else 1


def controller_at_start(info: folders.SessionInfo, configuration: Configuration) -> Controller:
    """Return a controller that begins with what the recorded one had learnt before.

    Args:
        info: Of the session.
        configuration: Of the controller, which may ask for another kind of load.
    """
    load, prior = build_load(configuration), info.prior
    if prior is not None and len(prior) != len(load.names):
        prior = None
    return Controller(controller_settings(configuration), load, prior, info.resolution)


_WITHOUT_EFFECT = (
    "has no effect on a replay, which takes measurements and orders (set-point, pole, mode, stage) "
    "from the record"
)


def _acting(configuration: Configuration) -> object:
    """Return what of a configuration acts on the controller that is run again."""
    return controller_settings(configuration), build_load(configuration)


_check_weeks = refusing(lambda weeks: 0.0 < weeks < math.inf, "Weeks are a number above 0.")


def health(
    drive: options.DriveName,
    /,
    *,
    weeks: Annotated[float, Parameter(validator=_check_weeks)] = 8.0,
    plot: Path | None = None,
    directory: Folder = None,
) -> int:
    """Show what the load of a drive was over the weeks: levels, trends, changes.

    Args:
        drive: Name of the drive.
        weeks: Time over which trends and changes are sought.
        plot: File for a figure, a PNG.
        directory: Folder of the sessions; $STATE_DIRECTORY/sessions or ./sessions when left out.

    Raises:
        RecordingError: It has no hour.
    """
    path = load_health.health_path(_folder(directory), drive)
    found = load_health.report(load_health.read_rows(path), weeks)
    if found is None:
        raise RecordingError(path, "it has no hour yet: one is added when its segment is closed")
    print("\n".join(_condition(drive, found)))
    if plot is not None:
        with options.needing("analysis"):
            from adaptdrive.analysis.figures import draw_health  # noqa: PLC0415 - it is large
        files.replace_result(plot, draw_health(drive, found))
        print(plot)
    return 0


def _condition(drive: str, found: trends.HealthReport) -> Iterator[str]:
    fed = f"{found.running_h:.1f} h fed, {found.starts} starts"
    yield f"{drive}: {fed}, until {found.time:%F %H:%M}Z"
    yield f"{'quantity':<20}{'level':>22}{'change':>18}{'trend a week':>18}"
    for name, one in found.quantities.items():
        change = _percent(one.change_percent, one.change_std)
        trend = _percent(one.trend_percent, one.trend_std)
        mark = "  outside its bounds" if one.outside else ""
        yield f"{name:<20}{f'{one.value:.5g} ± {one.std:.2g}':>22}{change:>18}{trend:>18}{mark}"
    yield from (one.meaning for one in found.quantities.values() if one.meaning)
    yield from (f"the bank of models decided: {one}" for one in found.changes)


def _percent(value: float | None, std: float | None) -> str:
    return "-" if value is None or std is None else f"{value:+.2f} ± {std:.2g} %"
