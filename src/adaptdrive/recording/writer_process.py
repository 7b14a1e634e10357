"""The recorder process as the control process sees it: a pipe that never blocks."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path
from typing import Self

from adaptdrive.recording.batches import Batch, Header, framed


class WriterProcess:
    """A running recorder process."""

    def __init__(self, process: asyncio.subprocess.Process, backlog_bytes: int) -> None:
        self._process = process
        self._backlog_bytes = backlog_bytes

    @classmethod
    async def start(cls, directory: Path, backlog_bytes: int) -> Self:
        """Start the process for one session.

        Args:
            directory: The session's directory.
            backlog_bytes: Bytes that may wait for the process before batches are refused.

        Raises:
            OSError: The process cannot be started.
        """
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "adaptdrive.recording.writer",
            str(directory),
            stdin=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            # Ctrl-C on the terminal is for the control process, which then says goodbye.
            start_new_session=True,
        )
        return cls(process, backlog_bytes)

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def listens(self) -> bool:
        """False once the process has closed its end of the pipe."""
        pipe = self._process.stdin
        return pipe is not None and not pipe.transport.is_closing()

    def send(self, message: Header | Batch, *, urgent: bool = False) -> bool:
        """Hand over a message at once; False when the process is too far behind to take it.

        Args:
            message: What to hand over.
            urgent: Add it to the backlog however long that is.
        """
        pipe = self._process.stdin
        if pipe is None:
            return False
        if not urgent and pipe.transport.get_write_buffer_size() >= self._backlog_bytes:
            return False
        pipe.write(framed(message))
        return True

    async def ended(self) -> str:
        """Wait for the process to end; what it said, or its exit status."""
        said = b"" if self._process.stderr is None else await self._process.stderr.read()
        status = await self._process.wait()
        lines = said.decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else f"the recorder process ended with status {status}"

    async def close(self, timeout_s: float) -> str | None:
        """Close the pipe and let the process finish.

        Args:
            timeout_s: Longest wait; a process that takes longer is killed, which costs the
                session at most what was still in the pipe.

        Returns:
            What went wrong, None when nothing did.
        """
        if self._process.stdin is not None:
            self._process.stdin.close()
        try:
            async with asyncio.timeout(timeout_s):
                said = await self.ended()
        except TimeoutError:
            self._process.kill()
            await self._process.wait()
            return f"the recorder process did not finish within {timeout_s} s and was killed"
        return None if self._process.returncode == 0 else said
