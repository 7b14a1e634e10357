"""`adaptdrive health`: the load of a drive over the weeks."""

import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from adaptdrive.app.recording import health_settings
from adaptdrive.cli import options
from adaptdrive.recording import condition, reader, records, replay
from adaptdrive.recording import health as rows_of
from adaptdrive.recording import session as folders
from adaptdrive.runtime.health import HealthReport
from adaptdrive.util.errors import RecordingError
from adaptdrive.util.files import replace_result

_MOST_WEEKS = 104.0
_check_weeks = options.refusing(
    lambda weeks: 0.0 < weeks <= _MOST_WEEKS,
    f"Weeks are a number above 0, at most {_MOST_WEEKS:g}.",
)


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class HealthView:
    """Where the rows are, and what is made of them.

    Attributes:
        weeks: Time over which trends and changes are sought.
        plot: File for a figure, a PNG.
        rebuild: First add the rows that sessions which still exist have more.
        directory: Folder of the sessions; $STATE_DIRECTORY/sessions or ./sessions when left out.
        as_json: Print JSON, for programs.
    """

    weeks: Annotated[float, Parameter(validator=_check_weeks)] = 8.0
    plot: Path | None = None
    rebuild: options.Flag = False
    directory: Path | None = None
    as_json: options.Json = False


_EIGHT_WEEKS = HealthView()


def health(drive: options.DriveName, /, *, view: HealthView = _EIGHT_WEEKS) -> int:
    """Show what the load of a drive was over the weeks: levels, trends, changes.

    Args:
        drive: Name of the drive.
        view: Where the rows are, and what is made of them.

    Raises:
        RecordingError: There is no row.
    """
    sessions = folders.sessions_directory(view.directory, os.environ)
    path = rows_of.health_path(sessions, drive)
    own = list(_sessions_of(drive, sessions))
    for session in own if view.rebuild else ():
        rows_of.add_rows(session.path, _settings(session))
    rows = rows_of.read_rows(path)
    settings = _settings(own[-1]) if own else records.HealthSettings()
    found = condition.report(rows, settings, view.weeks)
    if found is None:
        raise RecordingError(path, "it has no hour yet: one is added when its segment is closed")
    if view.as_json:
        options.print_json(found)
    else:
        print("\n".join(_text(drive, found)))
    if view.plot is not None:
        _draw(view.plot, drive, rows, view.weeks)
    return 0


def _sessions_of(drive: str, sessions: Path) -> Iterator[reader.Session]:
    """Yield the sessions of a drive that can be read, the oldest first."""
    for path in folders.session_directories(sessions):
        try:
            session = reader.read_session(path)
        except RecordingError as problem:
            print(f"adaptdrive: {problem}", file=sys.stderr)
            continue
        if session.info.drive == drive:
            yield session


def _settings(session: reader.Session) -> records.HealthSettings:
    source = session.path / folders.CONFIG_FILE
    return health_settings(replay.reconfigured(session.config_text, source, ()))


def _text(drive: str, found: HealthReport) -> Iterator[str]:
    fed = f"{found.running_h:.1f} h fed, {found.starts} starts"
    yield f"{drive}: {fed}, until {found.time:%F %H:%M}Z"
    yield f"{'quantity':<20}{'level':>22}{'of model':>10}{'change':>16}{'trend a week':>18}"
    for name, one in found.quantities.items():
        share = f"{one.value / one.nominal:.4g}" if one.nominal else "-"
        change = _percent(one.change_percent, one.change_std)
        trend = _percent(one.trend_percent, one.trend_std)
        level = f"{one.value:.5g} ± {one.std:.2g}"
        mark = "  outside its bounds" if one.outside else ""
        yield f"{name:<20}{level:>22}{share:>10}{change:>16}{trend:>18}{mark}"
    yield from _listed("meaning", list(condition.sentences(found)))
    yield from _listed("changes by the bank of models", found.changes)


def _listed(title: str, lines: Sequence[str]) -> Iterator[str]:
    if lines:
        yield f"\n{title}:"
        yield from (f"  {line}" for line in lines)


def _percent(value: float | None, std: float | None) -> str:
    return "-" if value is None or std is None else f"{value:+.2f} ± {std:.2g} %"


def _draw(path: Path, drive: str, rows: Sequence[rows_of.Row], weeks: float) -> None:
    with options.needing("analysis"):
        from adaptdrive.analysis.health_figure import draw_health  # noqa: PLC0415 - it is large
    replace_result(path, draw_health(drive, rows, weeks))
    print(path)
