"""The recorder process as the control process sees it: a pipe that never blocks."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import fcntl
import sys
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Self

import msgspec

from adaptdrive.recording.batches import News

_PIPE_BYTES = 1 << 20
"""Size of the pipe, the largest that needs no privilege: what is in it outlives this process."""

_KILL_PATIENCE_S = 1.0
_LONGEST_LINE_BYTES = 1 << 16


class _Streams(asyncio.subprocess.SubprocessStreamProtocol):
    """Streams of a process, which can be ended also where asyncio gives it up."""

    def __init__(self) -> None:
        loop = asyncio.get_running_loop()
        super().__init__(_LONGEST_LINE_BYTES, loop)
        self._joined: asyncio.Future[asyncio.BaseTransport] = loop.create_future()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the process, once its pipes are joined."""
        super().connection_made(transport)
        self._joined.set_result(transport)

    async def end_process(self) -> None:
        """End a process whose end nothing waits for: asyncio has no thread for that."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_KILL_PATIENCE_S):
                transport = await self._joined
                transport.close()
                process = transport.get_extra_info("subprocess")
                while process.poll() is None:  # noqa: ASYNC110 - a process sets no event
                    await asyncio.sleep(0.01)


class WriterProcess:
    """A running recorder process."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process

    @classmethod
    async def start(
        cls, sessions: Path, module: str = "adaptdrive.recording.writer", *words: str
    ) -> Self:
        """Start the process for one session.

        Args:
            sessions: Folder of all sessions.
            module: Module that it runs.
            words: Further words of its command line.

        Raises:
            OSError: The process cannot be started.
        """
        streams = _Streams()
        try:
            transport, _ = await asyncio.get_running_loop().subprocess_exec(
                lambda: streams,
                # -P: a file of the working folder, such as queue.py, is no module of this process.
                *(sys.executable, "-P", "-m", module, str(sessions), *words),
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.PIPE,
                # Ctrl-C on the terminal is for the control process, which then ends the session.
                start_new_session=True,
            )
        except RuntimeError as problem:  # asyncio waits for a process in a thread
            await streams.end_process()
            raise OSError(errno.EAGAIN, str(problem)) from problem
        _enlarge(streams.stdin)
        return cls(asyncio.subprocess.Process(transport, streams, asyncio.get_running_loop()))

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def send(self, message: bytes) -> None:
        """Hand over a framed message at once; nothing when the process does not listen."""
        pipe = self._process.stdin
        if pipe is not None and not pipe.transport.is_closing():
            pipe.write(message)

    def hang_up(self) -> None:
        """Close the pipe, so that the process finishes."""
        if self._process.stdin is not None:
            self._process.stdin.close()

    async def news(self) -> AsyncIterator[News]:
        """Yield what the process reports, until it ends."""
        if self._process.stdout is None:
            return
        async for line in self._process.stdout:
            with contextlib.suppress(msgspec.DecodeError):
                yield msgspec.json.decode(line, type=News)

    async def ended(self) -> str | None:
        """Wait for the process to end; its last words or its status, None when all went well."""
        said = b"" if self._process.stderr is None else await self._process.stderr.read()
        status = await self._process.wait()
        if status == 0:
            return None
        lines = said.decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else f"the recorder process ended with status {status}"

    async def kill(self) -> None:
        """End the process at once, also when it is stopped; a disk that hangs may keep it."""
        if self._process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                self._process.kill()
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._process.wait(), _KILL_PATIENCE_S)


def _enlarge(pipe: asyncio.StreamWriter | None) -> None:
    if pipe is None:
        return
    descriptor = pipe.get_extra_info("pipe").fileno()
    with contextlib.suppress(OSError):  # a smaller one serves too
        fcntl.fcntl(descriptor, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
