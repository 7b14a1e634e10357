"""Events of the drive in the log of its process."""

from __future__ import annotations

from collections.abc import Iterable

from adaptdrive.lines import Level, log
from adaptdrive.runtime.hub import Keep, Subscription
from adaptdrive.runtime.reports import Event, Report, Severity

_LEVELS: dict[Severity, Level] = {
    Severity.INFO: "info",
    Severity.WARNING: "warning",
    Severity.ALARM: "error",
}


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
