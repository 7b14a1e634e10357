"""Lines on stderr: one JSON object each, for the journal of the system; none for single ticks.

structlog makes the lines, also those of libraries, which use `logging`. It is imported with the
first line: a command that writes none starts without it.
"""

import json
import logging
import os
import sys
from collections.abc import Callable, Mapping, MutableMapping
from functools import cache
from typing import TYPE_CHECKING, Any, Literal, TextIO

if TYPE_CHECKING:
    import structlog

Level = Literal["info", "warning", "error"]

# sd-daemon(3): the journal takes the priority of a line from its beginning, and takes it off.
_PRIORITIES = {"critical": "<2>", "error": "<3>", "warning": "<4>", "info": "<6>", "debug": "<7>"}

_NAME = "adaptdrive"


def write_line(level: Level, event: str, **facts: object) -> None:
    """Write one line.

    Args:
        level: How much it matters.
        event: What happened, in words.
        facts: What else is known, by name.
    """
    getattr(_logger(), level)(event, **facts)


def line(level: Level, event: str, **facts: object) -> str:
    """Return a line, with a priority where stderr is the journal; see `write_line`."""
    record = logging.makeLogRecord({"levelname": level.upper(), "msg": event, **facts})
    return configured().format(record)


def bind(**facts: object | Callable[[], object]) -> None:
    """Add facts to each further line of this task and of those that it starts.

    Args:
        facts: Values, or functions that return the present ones, by name; None is left out.
    """
    from structlog.contextvars import bind_contextvars  # noqa: PLC0415 - with the first line

    bind_contextvars(**facts)


@cache
def configured() -> logging.Formatter:
    """Send the lines of this process, and the warnings of its libraries, to stderr.

    Returns:
        What makes a line of a record of `logging`.
    """
    from structlog import configure, contextvars, processors, stdlib  # noqa: PLC0415 - see above

    made: list[structlog.typing.Processor] = [
        contextvars.merge_contextvars,
        _present,
        processors.add_log_level,
        processors.TimeStamper(fmt="iso", utc=True),
    ]
    formatter = stdlib.ProcessorFormatter(
        processors=[stdlib.ProcessorFormatter.remove_processors_meta, _rendered],
        foreign_pre_chain=[stdlib.ExtraAdder(), stdlib.add_logger_name, *made],
    )
    configure(
        processors=[*made, stdlib.ProcessorFormatter.wrap_for_formatter],
        logger_factory=stdlib.LoggerFactory(),
        wrapper_class=stdlib.BoundLogger,
    )
    handler = _Stderr()
    handler.setFormatter(formatter)
    logging.getLogger().addHandler(handler)
    logging.getLogger(_NAME).setLevel(logging.INFO)
    return formatter


@cache
def _logger() -> "structlog.stdlib.BoundLogger":
    import structlog  # noqa: PLC0415 - see above

    configured()
    logger: structlog.stdlib.BoundLogger = structlog.get_logger(_NAME)
    return logger


class _Stderr(logging.Handler):
    """Writes to what is stderr now: it is led through a queue while the daemon runs."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write the line of a record."""
        sys.stderr.write(f"{self.format(record)}\n")


def _present(_: object, __: str, entry: MutableMapping[str, Any]) -> Mapping[str, Any]:
    """Replace each function that is bound by its present value; leave it out where that is None."""
    found = {name: one() if callable(one) else one for name, one in entry.items()}
    return {name: one for name, one in found.items() if one is not None or entry[name] is None}


def _rendered(_: object, __: str, entry: Mapping[str, Any]) -> str:
    """Return an entry as JSON, with its priority where stderr is the journal."""
    text = json.dumps(entry, ensure_ascii=False, default=str)
    priority = _PRIORITIES[entry["level"]] if leads_to_journal(sys.stderr, os.environ) else ""
    return f"{priority}{text}"


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
