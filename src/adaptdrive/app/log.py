"""Logging: one JSON object per line on stderr, for the journal. Nothing is logged per tick."""

from __future__ import annotations

import logging
import sys

import structlog

from adaptdrive.runtime.hub import Subscription
from adaptdrive.runtime.reports import Event, Severity

_LEVELS = {
    Severity.INFO: logging.INFO,
    Severity.WARNING: logging.WARNING,
    Severity.ALARM: logging.ERROR,
}


def set_up_logging() -> structlog.typing.FilteringBoundLogger:
    """Log as JSON to stderr."""
    structlog.configure(
        processors=[
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.JSONRenderer(ensure_ascii=False),
        ],
        wrapper_class=structlog.make_filtering_bound_logger(logging.INFO),
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
    )
    logger: structlog.typing.FilteringBoundLogger = structlog.get_logger()
    return logger


async def log_events(events: Subscription, logger: structlog.typing.FilteringBoundLogger) -> None:
    """Write every event to the log until cancelled."""
    while True:
        for event in await events.take():
            if isinstance(event, Event):
                logger.log(_LEVELS[event.severity], event.detail, kind=event.kind, tick=event.tick)
