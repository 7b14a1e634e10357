"""Logging: one JSON object per line on stderr, for the journal. Nothing is logged per tick."""

from __future__ import annotations

import json
import logging
import os
import sys
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from typing import TextIO

import structlog

from adaptdrive.runtime.hub import Keep, Subscription
from adaptdrive.runtime.reports import Event, Report, Severity

_LEVELS = {
    Severity.INFO: logging.INFO,
    Severity.WARNING: logging.WARNING,
    Severity.ALARM: logging.ERROR,
}
# sd-daemon(3): the journal takes the priority of a line from its beginning, and takes it off.
_PRIORITIES = {"info": "<6>", "warning": "<4>", "error": "<3>"}


def set_up_logging() -> structlog.typing.FilteringBoundLogger:
    """Log as JSON to stderr, with priorities where that is the journal."""
    processors: list[structlog.typing.Processor] = [
        structlog.processors.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
        structlog.processors.JSONRenderer(ensure_ascii=False),
    ]
    if leads_to_journal(sys.stderr, os.environ):
        processors.append(_with_priority)
    structlog.configure(
        processors=processors,
        wrapper_class=structlog.make_filtering_bound_logger(logging.INFO),
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
    )
    logger: structlog.typing.FilteringBoundLogger = structlog.get_logger()
    return logger


def leads_to_journal(stream: TextIO, environment: Mapping[str, str]) -> bool:
    """Return whether what is written to a stream goes to the journal itself.

    Args:
        stream: The stream.
        environment: Process environment, with JOURNAL_STREAM where the service manager set it.
    """
    try:
        place = os.fstat(stream.fileno())
    except (OSError, ValueError):
        return False
    return environment.get("JOURNAL_STREAM") == f"{place.st_dev}:{place.st_ino}"


def loss_line(lost: int) -> str:
    """Return the line with the number of lines discarded before it, as the reader had stopped."""
    entry = {
        "lost": lost,
        "event": "log lines lost: the reader of this log had stopped reading",
        "level": "warning",
        "timestamp": datetime.now(UTC).isoformat().replace("+00:00", "Z"),
    }
    line = json.dumps(entry)
    return f"{_PRIORITIES['warning']}{line}" if leads_to_journal(sys.stderr, os.environ) else line


def _with_priority(_: object, method: str, line: object) -> str:
    return f"{_PRIORITIES.get(method, '')}{line}"


async def log_events(
    events: Subscription, logger: structlog.typing.FilteringBoundLogger, kept: Keep
) -> None:
    """Write every event to the log until cancelled, those of the last moment included.

    Args:
        events: Subscription to events.
        logger: Writes the lines.
        kept: Waits until they are recorded.
    """
    taken: Iterable[Report] = ()
    try:
        while True:
            taken = await events.take()
            await kept()
            _log(taken, logger)
            taken = ()
    finally:
        _log(taken, logger)
        _log(events.drain(), logger)


def _log(events: Iterable[Report], logger: structlog.typing.FilteringBoundLogger) -> None:
    for event in events:
        if isinstance(event, Event):
            logger.log(_LEVELS[event.severity], event.detail, kind=event.kind, tick=event.tick)
