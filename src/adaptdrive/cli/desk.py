"""`adaptdrive start`: one drive on a desk, with all that it needs, in one terminal.

What it starts, it ends: the view is left, then panel, daemon and broker end one after another. A
process whose starter was killed is ended by the kernel's SIGTERM, at which a daemon switches its
drive off.
"""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

from adaptdrive.cli.options import Contact, Flag
from adaptdrive.config import Configuration
from adaptdrive.processes.owned import (
    BROKER,
    HOST,
    Household,
    Ports,
    ProcessDiedError,
    is_listening,
)
from adaptdrive.tui.terminal import ended_once, tell_last
from adaptdrive.util.errors import AdaptdriveError, ConfigurationError, Flaw, first_error

COMMISSION_KEY = "c"
_CLI = "adaptdrive.cli"
_LOOPBACK = {HOST, "localhost"}
_PAGE, _WEBSOCKET = 8088, 8083
"""Ports of the panel and of a broker's WebSocket listener, as `adaptdrive panel` expects them."""


def start(
    config: Path | None = None,
    /,
    *,
    simulate: Path | None = None,
    commission: Flag = False,
    contact: Contact | None = None,
) -> int:
    """Run a drive on a desk: its daemon, the panel, the live view, and a broker where none answers.

    The embedded broker serves this machine only, asks for no password and keeps nothing. The key c
    of the view measures the load; q and Ctrl-C end everything, with the drive off.

    Args:
        config: Configuration file; the only one of this folder when left out.
        simulate: Play the drive, with the load that this configuration describes.
        commission: Measure the load first.
        contact: Login at the broker.
    """
    from adaptdrive.app.examine import load_examined  # noqa: PLC0415 - it is large
    from adaptdrive.tui.terminal import refuse_dumb_terminal  # noqa: PLC0415 - as above

    path = _only_configuration() if config is None else config
    configuration = load_examined(path)
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise ConfigurationError("start", [Flaw("terminal", "is needed; elsewhere use run")])
    refuse_dumb_terminal()
    desk = _Desk(path, configuration, replace(contact or Contact(), config=path))
    with asyncio.Runner() as runner, _closed(runner, desk):
        runner.run(desk.start(simulate))
        _serve(runner, desk, commission=commission)
    return 0


def _serve(runner: asyncio.Runner, desk: _Desk, *, commission: bool) -> None:
    """Show the drive, and measure its load as often as that is asked for."""
    while True:
        if commission:
            runner.run(desk.commission())
            input("\nEnter opens the view. ")
        commission = runner.run(desk.show())
        if not commission:
            return


@contextmanager
def _closed(runner: asyncio.Runner, desk: _Desk) -> Iterator[None]:
    """End all processes at the end, and show the last lines of one that has ended by itself."""
    try:
        yield
    except* ProcessDiedError as problems:
        tail = "\n".join(f"  {line}" for line in first_error(problems).tail)
        raise AdaptdriveError(f"{first_error(problems)}\n{tail}") from None
    except* EOFError:
        print()
    finally:
        tell_last(f"ending: {', '.join(desk.names)}")
        runner.run(desk.stop())


def _only_configuration() -> Path:
    found = sorted(Path().glob("*.toml"))
    if len(found) != 1:
        names = ", ".join(map(str, found)) or "none"
        flaw = Flaw("start", f"name a configuration; this folder has {names}")
        raise ConfigurationError("adaptdrive", [flaw])
    return found[0]


class _Desk:
    """The processes around one drive."""

    def __init__(self, path: Path, configuration: Configuration, contact: Contact) -> None:
        """Start nothing yet.

        Args:
            path: Configuration file of the drive.
            configuration: The same, read.
            contact: How operators reach the broker.
        """
        self._path, self._contact = path, contact
        self._broker, self._drive = configuration.mqtt, configuration.drive.name
        self._household, self._ports = Household(os.environ), Ports()
        self._said: list[str] = []

    @property
    def names(self) -> list[str]:
        """Names of the processes that run, in the order of their end."""
        return self._household.names

    async def start(self, simulate: Path | None) -> None:
        """Start broker, daemon and panel.

        Args:
            simulate: Configuration of a simulated drive; there is a real one when None.

        Raises:
            AdaptdriveError: One of them cannot be had.
        """
        websocket = _WEBSOCKET
        if not is_listening(self._broker.host, self._broker.port):
            websocket = await self._start_broker()
        if simulate is not None:
            words = ["device", str(simulate), f"--broker={self._broker.host}:{self._broker.port}"]
            log = self._log("drive")
            await self._household.start("simulated drive", "adaptdrive_sim", words, log)
        await self._household.start("daemon", _CLI, ["run", str(self._path)], self._log("daemon"))
        await self._start_panel(websocket)

    async def commission(self) -> None:
        """Measure the load on this terminal."""
        words = ["commission", self._drive, "--config", str(self._path)]
        with ended_once():
            await self._household.run_in_front(_CLI, words)

    async def show(self) -> bool:
        """Show the drive; return whether its load is to be measured."""
        from adaptdrive.tui.main import watch  # noqa: PLC0415 - it is large
        from adaptdrive.tui.view import KEYS, Surroundings, faint  # noqa: PLC0415

        asked = asyncio.Event()

        def takes(key: str) -> bool:
            if key == COMMISSION_KEY:
                asked.set()
            return key == COMMISSION_KEY

        async def until_asked() -> None:
            await asked.wait()

        keys = (*KEYS[:-1], f"{COMMISSION_KEY} commission", KEYS[-1])
        around = Surroundings(keys, faint(self._said), takes=takes)
        services = [self._household.watch(), until_asked()]
        settings, timeout_s = self._contact.settings, self._contact.timeout
        await watch(settings, self._drive, timeout_s, around, services)
        return asked.is_set()

    async def stop(self) -> None:
        """End all processes, the last one first."""
        await self._household.stop()
        self._ports.close()

    def _log(self, name: str) -> Path:
        from adaptdrive.app.recording import state_directory  # noqa: PLC0415 - it is large

        folder = state_directory()
        folder.mkdir(parents=True, exist_ok=True)
        return folder / f"{self._drive}.{name}.log"

    def _say(self, line: str) -> None:
        print(line, flush=True)
        self._said.append(line)

    async def _start_broker(self) -> int:
        """Start the embedded broker; return the port of its WebSocket listener."""
        broker = self._broker
        place = f"{broker.host}:{broker.port}"
        if broker.host not in _LOOPBACK or broker.tls or broker.username is not None:
            raise AdaptdriveError(f"no broker answers at {place}")
        if find_spec("amqtt") is None:
            remedy = "apt-get install mosquitto, or pip install 'adaptdrive[desk]' for the embedded"
            raise AdaptdriveError(f"no broker answers at {place}: {remedy}")
        websocket = self._ports.take(usual=_WEBSOCKET)
        self._say(f"broker: none answered at {place}; an embedded one serves this machine only")
        listeners = [f"{HOST}:{broker.port}", f"{HOST}:{websocket}"]
        child = await self._household.start("broker", BROKER, listeners, self._log("broker"))
        await child.until_listening(broker.port)
        return websocket

    async def _start_panel(self, websocket: int) -> None:
        from adaptdrive.cli.panel import panel_address  # noqa: PLC0415 - it has a web server

        host = self._broker.host
        if not is_listening(host, websocket):
            self._say(f"panel: none, as the broker has no WebSocket listener at {host}:{websocket}")
            return
        page, address = self._ports.take(usual=_PAGE), f"ws://{host}:{websocket}/mqtt"
        words = ["panel", "--no-open", f"--port={page}", f"--broker={address}"]
        panel = await self._household.start("panel", _CLI, words, self._log("panel"))
        await panel.until_listening(page)
        self._say(f"panel: {panel_address(page, address)}")
