"""The archiver as the control process sees it: started when it is due, heard line by line."""

from __future__ import annotations

import asyncio
import contextlib
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec

from adaptdrive.recording.journal import Place, RecordingPace
from adaptdrive.recording.records import Header
from adaptdrive.recording.session import create_session, session_of
from adaptdrive.runtime.reports import Severity
from adaptdrive.util.threads import in_thread

_RETRY_S = 60.0
"""Pause of the archiver after a failure."""


class Archiving:
    """Makes the folder of a session, and runs the archiver at the start and whenever it is due.

    Attributes:
        directory: Folder of the session, None before it is made.
    """

    def __init__(
        self,
        place: Place,
        header: Header,
        report: Callable[[Severity, str], None],
        pace: RecordingPace,
    ) -> None:
        """Start nothing yet.

        Args:
            place: Folders; without one of sessions there is nothing to do.
            header: The session that is recorded.
            report: Takes events, in the event loop.
            pace: Intervals of the recorder.
        """
        self.directory: Path | None = None
        self._sessions = place.sessions
        self._header = header
        program = [sys.executable, "-P", "-m", "adaptdrive.recording.archiver"]
        self._command = [*program, str(place.log), str(pace.trip_s)]
        self._report = report
        self._pace = pace
        self._due = asyncio.Event()

    def make_session(self) -> None:
        """Make the folder of the session where there is none, in the thread of the log.

        Raises:
            OSError: It cannot be made.
        """
        if self._sessions is not None and self.directory is None:
            info, text = self._header.info, self._header.config_text
            found = session_of(self._sessions, info)
            self.directory = found or create_session(self._sessions, info, text)

    def due(self, after_s: float = 0.0) -> None:
        """Have it run as soon as it can after a time."""
        asyncio.get_running_loop().call_later(after_s, self._due.set)

    async def run(self) -> None:
        """Run it until cancelled."""
        said = ""
        while True:
            problem = await self.once()
            if problem and problem != said:
                self._report(Severity.ALARM, f"sessions are not written: {problem}")
            said = problem
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_RETRY_S if problem else None):
                    await self._due.wait()
            self._due.clear()

    async def once(self, *words: str) -> str:
        """Run it until it ends; it continues where this is cancelled.

        Args:
            words: More words of its command line.

        Returns:
            Why it failed, empty where it did not.
        """
        loop = asyncio.get_running_loop()

        def tell(severity: Severity, detail: str) -> None:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(self._report, severity, detail)

        def run() -> str:
            self._pace.start_thread()
            return _run([*self._command, *words], tell)

        try:
            return await asyncio.wrap_future(in_thread(run, "archiver"))
        except (OSError, RuntimeError) as problem:  # no further process or thread
            return str(problem)


def _run(command: Sequence[str], tell: Callable[[Severity, str], None]) -> str:
    with subprocess.Popen(  # noqa: S603 - this program itself
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        # Ctrl-C on the terminal is for the control process
        start_new_session=True,
    ) as process:
        for line in process.stdout or ():
            with contextlib.suppress(msgspec.DecodeError):
                tell(*msgspec.json.decode(line, type=tuple[Severity, str]))
        said = b"" if process.stderr is None else process.stderr.read()
    if process.returncode == 0:
        return ""
    lines = said.decode(errors="replace").strip().splitlines()
    return lines[-1] if lines else f"the archiver ended with status {process.returncode}"
