"""The processes that one terminal owns: started, watched, and ended in order.

Each gets a session of its own, so that Ctrl-C on the terminal reaches this process alone, which
then ends them one by one; and a leash, so that none outlives it however it dies.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import NoReturn, Self

from adaptdrive.errors import AdaptdriveError
from adaptdrive.household import leash

PATIENCE_s = 20.0
"""Time for a process to end before it is killed: the daemon closes its session."""

_TAIL_LINES = 8


class ProcessDiedError(AdaptdriveError):
    """A process ended by itself; carries the last lines of its log."""

    def __init__(self, name: str, status: int, log: Path) -> None:
        self.name = name
        self.status = status
        self.log = log
        self.tail = last_lines(log)
        super().__init__(f"the {name} {_how(status)}; see {log}")


@dataclass(frozen=True, slots=True)
class Child:
    """One process of a household."""

    name: str
    process: asyncio.subprocess.Process
    log: Path


class Household:
    """All processes of one terminal; the last one started is the first to end.

    Use it as an async context manager: whatever happens, none is left behind.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._environment = environment
        self._children: list[Child] = []

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        problem: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self.stop()

    async def start(self, name: str, module: str, arguments: Sequence[str], log: Path) -> Child:
        """Start `python -m MODULE ARGUMENTS`.

        Args:
            name: Its name in messages.
            module: Module to run.
            arguments: Its arguments.
            log: Takes its output.
        """
        leashed = [sys.executable, "-I", "-S", leash.__file__, str(os.getpid())]
        with log.open("ab") as output:
            process = await asyncio.create_subprocess_exec(
                *leashed,
                *(sys.executable, "-m", module, *arguments),
                stdin=asyncio.subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                env=self._environment,
                start_new_session=True,
            )
        child = Child(name, process, log)
        self._children.append(child)
        return child

    def has(self, name: str) -> bool:
        """Return whether a process of that name was started."""
        return any(child.name == name for child in self._children)

    async def watch(self) -> NoReturn:
        """Wait until a process ends by itself.

        Raises:
            ProcessDiedError: Which one, and how.
        """
        waits = {asyncio.ensure_future(c.process.wait()): c for c in self._children}
        try:
            done, _ = await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for wait in waits:
                wait.cancel()
            await asyncio.gather(*waits, return_exceptions=True)
        child = waits[done.pop()]
        raise ProcessDiedError(child.name, child.process.returncode or 0, child.log)

    async def stop(self) -> None:
        """End what still runs, in the reverse order of its start."""
        while self._children:
            await _end(self._children.pop())


def last_lines(log: Path) -> list[str]:
    """The last lines of a log."""
    try:
        text = log.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return []
    return text.splitlines()[-_TAIL_LINES:]


def _how(status: int) -> str:
    if status >= 0:
        return f"ended with status {status}"
    return f"was ended by {signal.Signals(-status).name}"


async def _end(child: Child) -> None:
    process = child.process
    if process.returncode is not None:
        return
    with contextlib.suppress(ProcessLookupError):
        process.terminate()
    try:
        async with asyncio.timeout(PATIENCE_s):
            await process.wait()
    except TimeoutError:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.wait()
