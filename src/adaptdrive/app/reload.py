"""The configuration of the next run of a daemon, and the events of its building.

The bus is closed and opened again, and everything is built anew, as at a start; the process, its
locks and its place at the service manager stay.
"""

import asyncio
import functools
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from adaptdrive.app.examine import examine_text
from adaptdrive.app.recording import descriptions, state_directory
from adaptdrive.config import Configuration
from adaptdrive.config.file import digest_of, read_text
from adaptdrive.mqtt.service import COMMAND_PATIENCE_S
from adaptdrive.recording.log_files import Recalled
from adaptdrive.runtime import reports, requests, tick_support
from adaptdrive.util import clock, files, lines
from adaptdrive.util.errors import ConfigurationError, RefusedError

# The configuration of the next run of a daemon, taken from the file between two runs.

CHANGEABLE = frozenset({"load", "estimator", "supervisor", "interlocks", "simulation"})
"""Sections that may change between two runs: the load, its control, and the limits that trip."""

ANSWER_S = COMMAND_PATIENCE_S + 0.5
"""From the acceptance to the end of the run: the reply is on its way."""

_LONGEST_LOOK_S = 5.0
_LONGEST_BETWEEN_S = 30.0
"""From the end of a run to the open bus of the next: what hangs there, the watchdog ends."""

FEED_S = 0.25
"""Between two looks whether the watchdog is to be fed."""


@dataclass(frozen=True, slots=True)
class RunInput:
    """Input of a run: its configuration.

    Attributes:
        configuration: The drive.
        text: Its configuration, as TOML.
        measured: Whether its model is that of a measurement, to start the estimates from.
        changed: Sections that a reload has changed; empty at the start of a process.
    """

    configuration: Configuration
    text: str
    measured: bool = False
    changed: tuple[str, ...] = ()


class RunCourse:
    """The runs of one process; each takes what the one before has left.

    Attributes:
        stop: Set for the end of the present run.
        path: File of the configuration.
    """

    def __init__(self, path: Path, given: RunInput) -> None:
        """Begin with the configuration of the start, and its file."""
        self.stop = asyncio.Event()
        self.path = path
        self._given = given
        self._descriptions = descriptions(given.configuration)
        self._next: RunInput | None = given
        self._ended = False
        self._fed_until_s = -math.inf

    def end(self) -> None:
        """End the present run, and the process."""
        self._ended = True
        self.stop.set()

    def next_run(self) -> RunInput | None:
        """Return what the next run is built from, None where the process ends."""
        given, self._next = self._next, None
        if given is None or (self._ended and given is not self._given):
            return None
        if not self._ended:
            self.stop.clear()
        self._given = given
        return given

    async def prepare(self, request: requests.Reload) -> Callable[[], None]:
        """Read the file for the next run, and return what ends the present one.

        Args:
            request: What was asked for.

        Raises:
            RefusedError: The file cannot be used without a restart; nothing has changed.
        """
        try:
            async with asyncio.timeout(_LONGEST_LOOK_S):
                reading = clock.in_thread(functools.partial(self._read, request), "reload")
                given = await asyncio.wrap_future(reading)
        except TimeoutError:
            raise RefusedError(f"{self.path} is not read within {_LONGEST_LOOK_S:g} s") from None
        except ConfigurationError as problem:
            flaws = "; ".join(map(str, problem.flaws))
            raise RefusedError(f"{self.path} is not valid, nothing has changed: {flaws}") from None
        return functools.partial(self._follow, given)

    def _follow(self, given: RunInput) -> None:
        self._next = given
        asyncio.get_running_loop().call_later(ANSWER_S, self._end_run)

    def _end_run(self) -> None:
        self._fed_until_s = clock.now_s() + _LONGEST_BETWEEN_S
        self.stop.set()

    def _read(self, request: requests.Reload) -> RunInput:
        text = read_text(self.path)
        measured = request.measured is not None
        if measured and request.measured != digest_of(text):
            raise RefusedError(
                f"{self.path} is not the file whose model was measured, nothing has changed"
            )
        before, after = self._given.configuration, examine_text(text, self.path)
        names = type(after).model_fields
        changed = [one for one in names if getattr(before, one) != getattr(after, one)]
        if fixed := [name for name in changed if name not in CHANGEABLE]:
            sections = ", ".join(f"[{name}]" for name in fixed)
            raise RefusedError(
                f"a change of {sections} needs a restart of the daemon; nothing is new"
            )
        if descriptions(after) != self._descriptions:
            raise RefusedError("a changed DBC or EDS file needs a restart of the daemon")
        return RunInput(after, text, measured, tuple(changed))

    async def feed_between(self, manager: tick_support.ServiceManager) -> None:
        """Feed the watchdog between two runs, in which no tick does."""
        if clock.now_s() < self._fed_until_s:
            manager.feed(clock.now_s())

    async def opened(self, opened: asyncio.Event) -> None:
        """Leave the watchdog to the ticks once the bus is open."""
        await opened.wait()
        self._fed_until_s = -math.inf


# Events of a daemon: those that its building gives, and all of them on stderr.

_LEVELS: dict[reports.Severity, lines.Level] = {
    reports.Severity.INFO: "info",
    reports.Severity.WARNING: "warning",
    reports.Severity.ALARM: "error",
}


def start_events(
    given: RunInput, known: reports.Event | None, recalled: Recalled
) -> Iterator[reports.Event]:
    """Yield the events that a run begins with.

    Args:
        given: What it is built from.
        known: What its controller starts from, None for nothing.
        recalled: What an earlier run has left.
    """
    if given.changed or given.measured:
        changed = ", ".join(f"[{name}]" for name in given.changed) or "nothing"
        detail = f"reloaded; changed: {changed}"
        yield reports.Event("configuration", reports.Severity.INFO, detail, -1)
    if known is not None:
        yield known
    directory = state_directory()
    if (flaw := files.directory_flaw(directory)) is not None:
        lost = "nothing is recorded, and replies, unsent events and estimates do not survive"
        detail = f"{directory}: {flaw}: {lost} a restart"
        yield reports.Event("state directory", reports.Severity.WARNING, detail, -1)
    for flaw in recalled.flaws:
        lost = "commands with ids used before may be carried out again, unsent events may be lost"
        detail = f"of the log of an earlier run, {flaw}: {lost}"
        yield reports.Event("recording", reports.Severity.WARNING, detail, -1)


async def write_events(events: reports.Subscription, kept: reports.Keep) -> None:
    """Write a line for each event until cancelled, those of the last moment included.

    Args:
        events: Subscription to events.
        kept: Waits until they are recorded.
    """
    taken: Iterable[reports.Event] = ()
    try:
        while True:
            taken = await events.take()
            await kept()
            _write(taken)
            taken = ()
    finally:
        _write(taken)
        _write(events.drain())


def _write(events: Iterable[reports.Event]) -> None:
    for event in events:
        lines.write_line(_LEVELS[event.severity], event.detail, kind=event.kind, tick=event.tick)
