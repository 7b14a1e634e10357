"""The processes that one terminal owns: started on free ports, watched, and ended in order.

Each gets a separate session, so that Ctrl-C on the terminal reaches this process alone, which
then ends them one by one; and it is tied to this process, so that none outlives it however it dies.

`python -m adaptdrive.processes HOST:PORT [WEBSOCKET_HOST:PORT]` is the embedded broker. It
implements MQTT 3.1.1, keeps nothing on disk and needs no password: for desks.
"""

import asyncio
import contextlib
import logging
import os
import signal
import socket
import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from adaptdrive.util.errors import AdaptdriveError

# Free ports of the loopback interface, and what listens there.

HOST = "127.0.0.1"


class Ports:
    """Free ports of the loopback interface, held until they are given back.

    A held port is given to no other process that asks the kernel for any; who is told its number
    can listen at it.
    """

    def __init__(self) -> None:
        self._held = ExitStack()

    def take(self, usual: int = 0) -> int:
        """Return a free TCP port.

        Args:
            usual: The port to take where it is free and no other program is taking it; any when 0.
        """
        usual = usual if usual and self._reserve(usual) else 0
        probe = self._held.enter_context(socket.socket(socket.AF_INET))
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, usual))
        except OSError:
            probe.bind((HOST, 0))
        return int(probe.getsockname()[1])

    def _reserve(self, port: int) -> bool:
        """Return whether no other program holds this number, although nothing listens there yet."""
        mark = self._held.enter_context(socket.socket(socket.AF_UNIX))
        try:
            mark.bind(f"\0adaptdrive-port-{port}")
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Give all back."""
        self._held.close()


def is_listening(host: str, port: int, wait_s: float = 1.0) -> bool:
    """Return whether something takes connections at a TCP port.

    Args:
        host: Name or address.
        port: The port.
        wait_s: Longest wait.
    """
    with suppress(OSError):
        socket.create_connection((host, port), wait_s).close()
        return True
    return False


# The processes that one terminal owns: started, watched, and ended in order.

BROKER = "adaptdrive.processes"
"""Module of the embedded broker; its arguments are its listeners."""

TETHER = """
import ctypes, os, signal, sys
parent, command = int(sys.argv[1]), sys.argv[2:]
libc = ctypes.CDLL(None, use_errno=True)
if libc.prctl(1, signal.SIGTERM, 0, 0, 0) != 0:  # PR_SET_PDEATHSIG
    sys.exit(f"cannot tie {command[0]} to its parent: {os.strerror(ctypes.get_errno())}")
if os.getppid() != parent:  # it was gone before
    sys.exit(f"process {parent}, which started {command[0]}, is gone")
os.execv(command[0], command)
"""
"""Program with the arguments PARENT COMMAND ARGUMENT ...: becomes a command that the kernel ends by
SIGTERM when the parent dies, which outlasts `exec`. It needs the standard library only."""

PATIENCE_s = 20.0
"""Time for a process to end before it is killed: the daemon closes its session."""

_TAIL_LINES = 8
_LOOK_s = 0.05


class ProcessDiedError(AdaptdriveError):
    """A process ended by itself; carries the last lines of its output."""

    def __init__(self, name: str, status: int, output: Path) -> None:
        self.tail = last_lines(output)
        super().__init__(f"the {name} {_how(status)}; see {output}")


@dataclass(frozen=True, slots=True)
class Child:
    """One process of a group."""

    name: str
    process: asyncio.subprocess.Process
    output: Path

    @property
    def death(self) -> ProcessDiedError:
        """The error that describes its end."""
        return ProcessDiedError(self.name, self.process.returncode or 0, self.output)

    async def until_listening(self, port: int) -> None:
        """Wait until it takes connections at a port of the loopback interface.

        Raises:
            ProcessDiedError: It has ended before.
        """
        while self.process.returncode is None:
            try:
                _, writer = await asyncio.open_connection(HOST, port)
            except OSError:
                await asyncio.sleep(_LOOK_s)
            else:
                writer.close()
                return
        raise self.death


class ProcessGroup:
    """All processes of one terminal; `stop` ends them, the last one started first.

    Whoever starts some stops them whatever happens, so that none is left behind.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._environment = environment
        self._children: list[Child] = []

    async def start(self, name: str, module: str, arguments: Sequence[str], output: Path) -> Child:
        """Start `python -m MODULE ARGUMENTS`.

        Args:
            name: Its name in messages.
            module: Module to run.
            arguments: Its arguments.
            output: File that takes what it writes.
        """
        with output.open("ab") as file:
            process = await asyncio.create_subprocess_exec(
                *_tied(module, arguments),
                stdin=asyncio.subprocess.DEVNULL,
                stdout=file,
                stderr=file,
                env=self._environment,
                start_new_session=True,
            )
        child = Child(name, process, output)
        self._children.append(child)
        return child

    @property
    def names(self) -> list[str]:
        """The names of all, in the order of their end."""
        return [child.name for child in reversed(self._children)]

    async def run_in_front(self, module: str, arguments: Sequence[str]) -> int:
        """Run `python -m MODULE ARGUMENTS` on this terminal to its end, or until cancelled.

        Returns:
            Its exit status.
        """
        command = _tied(module, arguments)
        process = await asyncio.create_subprocess_exec(*command, env=self._environment)
        try:
            return await process.wait()
        finally:
            await _end(process)

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
        raise waits[done.pop()].death

    async def stop(self) -> None:
        """End what still runs, in the reverse order of its start."""
        while self._children:
            await _end(self._children.pop().process)


def _tied(module: str, arguments: Sequence[str]) -> list[str]:
    """Return the command that runs a module for as long as this process lives."""
    tied = [sys.executable, "-I", "-S", "-c", TETHER, str(os.getpid())]
    return [*tied, sys.executable, "-m", module, *arguments]


def last_lines(output: Path) -> list[str]:
    """The last lines of the output of a process."""
    try:
        text = output.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return []
    return text.splitlines()[-_TAIL_LINES:]


def _how(status: int) -> str:
    if status >= 0:
        return f"ended with status {status}"
    return f"was ended by {signal.Signals(-status).name}"


async def _end(process: asyncio.subprocess.Process) -> None:
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


# The embedded broker.

_ANYBODY = "amqtt.plugins.authentication.AnonymousAuthPlugin"


async def serve_broker(address: str, websocket: str | None = None) -> None:
    """Serve until SIGTERM or SIGINT.

    Args:
        address: HOST:PORT to listen at.
        websocket: HOST:PORT of the listener for web pages, None for none.
    """
    listeners = {"default": {"type": "tcp", "bind": address}}
    if websocket is not None:
        listeners["page"] = {"type": "ws", "bind": websocket}
    asked = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, asked.set)
    broker = _broker({"listeners": listeners, "plugins": {_ANYBODY: {"allow_anonymous": True}}})
    await broker.start()
    await asked.wait()
    await broker.shutdown()


def _broker(config: dict[str, Any]) -> Any:  # noqa: ANN401 - amqtt is untyped
    """Return amqtt, without the retained messages that it sends to clients which never asked.

    To every client that connects, amqtt 0.12 sends what is retained on any topic that any client
    has subscribed to.
    """
    from amqtt.broker import Broker  # noqa: PLC0415 - an extra, which the broker alone needs

    class EmbeddedBroker(Broker):  # type: ignore[misc]
        async def _publish_retained_messages_for_subscription(
            self,
            subscription: tuple[str, int],
            session: Any,  # noqa: ANN401
        ) -> None:
            subscribers = self._subscriptions.get(subscription[0], [])
            if any(one.client_id == session.client_id for one, _ in subscribers):
                await super()._publish_retained_messages_for_subscription(subscription, session)

    return EmbeddedBroker(config)


if __name__ == "__main__":
    logging.basicConfig(level=logging.WARNING)
    asyncio.run(serve_broker(*sys.argv[1:]))
