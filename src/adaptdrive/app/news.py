"""Events of a daemon: those that its building gives, and all of them in the log of its process."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from adaptdrive.app.recording import state_directory
from adaptdrive.app.reload import Given
from adaptdrive.recording.journal_files import Recalled
from adaptdrive.runtime.reports import Event, Keep, Report, Severity, Subscription
from adaptdrive.util.files import directory_flaw
from adaptdrive.util.lines import Level, log

_LEVELS: dict[Severity, Level] = {
    Severity.INFO: "info",
    Severity.WARNING: "warning",
    Severity.ALARM: "error",
}


def news_of(given: Given, known: Event | None, recalled: Recalled) -> Iterator[Event]:
    """Yield the events that a run begins with.

    Args:
        given: What it is built from.
        known: What its controller starts from, None for nothing.
        recalled: What an earlier run has left.
    """
    state = _state_event(state_directory())
    yield from filter(None, (_reload_event(given), known, state))
    yield from map(_flaw_event, recalled.flaws)


def _state_event(directory: Path) -> Event | None:
    """Return the event that reports an unusable state directory, None for a usable one."""
    flaw = directory_flaw(directory)
    if flaw is None:
        return None
    lost = "nothing is recorded, and replies, unsent events and estimates do not survive a restart"
    return Event("state directory", Severity.WARNING, f"{directory}: {flaw}: {lost}", -1)


def _reload_event(given: Given) -> Event | None:
    if not given.changed and not given.measured:
        return None
    changed = ", ".join(f"[{name}]" for name in given.changed) or "nothing"
    return Event("configuration", Severity.INFO, f"reloaded; changed: {changed}", -1)


def _flaw_event(flaw: str) -> Event:
    lost = "commands with ids used before may be carried out again, unsent events may be lost"
    return Event("recording", Severity.WARNING, f"of the log of an earlier run, {flaw}: {lost}", -1)


async def log_events(events: Subscription, kept: Keep) -> None:
    """Write every event to the log until cancelled, those of the last moment included.

    Args:
        events: Subscription to events.
        kept: Waits until they are recorded.
    """
    taken: Iterable[Report] = ()
    try:
        while True:
            taken = await events.take()
            await kept()
            _log(taken)
            taken = ()
    finally:
        _log(taken)
        _log(events.drain())


def _log(events: Iterable[Report]) -> None:
    for event in events:
        if isinstance(event, Event):
            log(_LEVELS[event.severity], event.detail, kind=event.kind, tick=event.tick)
