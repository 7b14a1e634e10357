"""`adaptdrive start` and `panel`: one drive on a desk, with all that it needs, in one terminal.

What it starts, it ends: the view is left, then panel, daemon and broker end one after another. A
process whose starter was killed is ended by the kernel's SIGTERM, at which a daemon switches its
drive off.
"""

from __future__ import annotations

import asyncio
import functools
import os
import re
import sys
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from http import HTTPStatus
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import quote

from cyclopts import Parameter, validators

from adaptdrive import processes
from adaptdrive.cli.options import Contact, Flag, Integer
from adaptdrive.config import Configuration
from adaptdrive.recording import session
from adaptdrive.tui.terminal import ended_once, print_last, refuse_dumb_terminal
from adaptdrive.util.clock import in_thread
from adaptdrive.util.errors import AdaptdriveError, ConfigurationError, first_error

# `adaptdrive start`: one drive on a desk, with all that it needs, in one terminal.

COMMISSION_KEY = "c"
_CLI = "adaptdrive.cli"
_LOOPBACK = {processes.HOST, "localhost"}
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

    path = _only_configuration() if config is None else config
    configuration = load_examined(path)
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise ConfigurationError.of("start", "terminal", "is needed; elsewhere use run")
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
    except* processes.ProcessDiedError as problems:
        tail = "\n".join(f"  {line}" for line in first_error(problems).tail)
        raise AdaptdriveError(f"{first_error(problems)}\n{tail}") from None
    except* EOFError:
        print()
    finally:
        print_last(f"ending: {', '.join(desk.names)}")
        runner.run(desk.stop())


def _only_configuration() -> Path:
    found = sorted(Path().glob("*.toml"))
    if len(found) != 1:
        names = ", ".join(map(str, found)) or "none"
        flaw = f"name a configuration; this folder has {names}"
        raise ConfigurationError.of("adaptdrive", "start", flaw)
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
        self._recorded = configuration.recording.directory
        self._processes, self._ports = processes.ProcessGroup(os.environ), processes.Ports()
        self._printed: list[str] = []

    @property
    def names(self) -> list[str]:
        """Names of the processes that run, in the order of their end."""
        return self._processes.names

    async def start(self, simulate: Path | None) -> None:
        """Start broker, daemon and panel.

        Args:
            simulate: Configuration of a simulated drive; there is a real one when None.

        Raises:
            AdaptdriveError: One of them cannot be had.
        """
        websocket = _WEBSOCKET
        if not processes.is_listening(self._broker.host, self._broker.port):
            websocket = await self._start_broker()
        if simulate is not None:
            words = ["device", str(simulate), f"--broker={self._broker.host}:{self._broker.port}"]
            output = self._output("drive")
            await self._processes.start("simulated drive", "adaptdrive_sim", words, output)
        await self._processes.start(
            "daemon", _CLI, ["run", str(self._path)], self._output("daemon")
        )
        await self._start_panel(websocket)

    async def commission(self) -> None:
        """Measure the load on this terminal."""
        words = ["commission", self._drive, "--config", str(self._path)]
        with ended_once():
            await self._processes.run_in_front(_CLI, words)

    async def show(self) -> bool:
        """Show the drive; return whether its load is to be measured."""
        from adaptdrive.tui import watch  # noqa: PLC0415 - it is large
        from adaptdrive.tui.view import KEYS, ViewExtras, faint  # noqa: PLC0415

        asked = asyncio.Event()

        def takes(key: str) -> bool:
            if key == COMMISSION_KEY:
                asked.set()
            return key == COMMISSION_KEY

        keys = (*KEYS[:-1], f"{COMMISSION_KEY} commission", KEYS[-1])
        around = ViewExtras(keys, faint(self._printed), takes=takes)
        services = [self._processes.watch(), asked.wait()]
        settings, timeout_s = self._contact.settings, self._contact.timeout
        await watch(settings, self._drive, timeout_s, around, services)
        return asked.is_set()

    async def stop(self) -> None:
        """End all processes, the last one first."""
        await self._processes.stop()
        self._ports.close()

    def _output(self, name: str) -> Path:
        from adaptdrive.app.recording import state_directory  # noqa: PLC0415 - it is large

        folder = state_directory()
        folder.mkdir(parents=True, exist_ok=True)
        return folder / f"{self._drive}.{name}.out"

    def _print(self, line: str) -> None:
        print(line, flush=True)
        self._printed.append(line)

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
        self._print(f"broker: none answered at {place}; an embedded one serves this machine only")
        listeners = [f"{processes.HOST}:{broker.port}", f"{processes.HOST}:{websocket}"]
        output = self._output("broker")
        child = await self._processes.start("broker", processes.BROKER, listeners, output)
        await child.until_listening(broker.port)
        return websocket

    async def _start_panel(self, websocket: int) -> None:
        host = self._broker.host
        if not processes.is_listening(host, websocket):
            missing = f"the broker has no WebSocket listener at {host}:{websocket}"
            self._print(f"panel: none, as {missing}")
            return
        page, address = self._ports.take(usual=_PAGE), f"ws://{host}:{websocket}/mqtt"
        sessions = session.sessions_directory(self._recorded, os.environ)
        words = ["panel", "--no-open", f"--port={page}", f"--broker={address}"]
        words.append(f"--sessions={sessions}")
        panel = await self._processes.start("panel", _CLI, words, self._output("panel"))
        await panel.until_listening(page)
        self._print(f"panel: {panel_address(page, address)}")


# `adaptdrive panel`: the panel's folder and the recorded sessions on loopback, for a desk.

FOLDER = Path(__file__).parents[1] / "panel"
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' data:; connect-src 'self' ws: wss:; worker-src blob:; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",
}
_SERVED = re.compile(
    r"/sessions/[\w-]+/((?:[^/.][^/]*/)*(?:index\.json|overview\.json|[^/.]+\.parquet))"
)
"""Path of what the page reads of sessions, below a folder of each drive."""


class PanelHandler(SimpleHTTPRequestHandler):
    """Serves the files of the panel and of sessions; lists no folder and writes no line."""

    def __init__(self, *connection: Any, sessions: Path) -> None:  # noqa: ANN401 - the base's
        self._sessions = sessions
        super().__init__(*connection, directory=str(FOLDER))

    def handle(self) -> None:
        """Answer until the connection ends; a browser that is gone is no error."""
        with suppress(ConnectionError):
            super().handle()

    def _is_foreign(self) -> bool:
        """Return whether another site asks, by a link or by a name that it gave to this host."""
        host = self.headers.get("Host", "").rpartition(":")[0]
        site = self.headers.get("Sec-Fetch-Site", "none")
        return host not in ("127.0.0.1", "localhost") or site not in ("none", "same-origin")

    def end_headers(self) -> None:
        """Add the headers that keep foreign scripts and frames away."""
        for name, value in HEADERS.items():
            self.send_header(name, value)
        super().end_headers()

    def translate_path(self, path: str) -> str:
        """Return the file of a request, that of an unknown page where its path can be none.

        What of sessions the page does not read, and any of it for another site, is unknown too.
        """
        file = super().translate_path(path)
        of_panel = f"/{Path(file).relative_to(FOLDER)}" if file.startswith(str(FOLDER)) else ""
        if (found := _SERVED.fullmatch(of_panel)) and not self._is_foreign():
            file = str(self._sessions / found[1])
        return file if file.isprintable() else str(FOLDER / "unknown")

    def list_directory(self, path: object) -> None:  # noqa: ARG002 - the base's signature
        """Refuse to list a folder."""
        self.send_error(HTTPStatus.NOT_FOUND)

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - as above
        """Write nothing."""


def panel_server(port: int, sessions: Path) -> ThreadingHTTPServer:
    """Return a server of the panel on the loopback interface.

    Args:
        port: TCP port, 0 for a free one.
        sessions: Folder of the sessions.

    Raises:
        AdaptdriveError: The port is in use.
    """
    handler = functools.partial(PanelHandler, sessions=sessions)
    try:
        return ThreadingHTTPServer(("127.0.0.1", port), handler)
    except OSError as problem:
        raise AdaptdriveError(f"port {port}: {problem}; choose another --port") from problem


def panel_address(port: int, broker: str) -> str:
    """Return the address of the page.

    Args:
        port: TCP port of the server.
        broker: Address of the broker's WebSocket listener.
    """
    return f"http://127.0.0.1:{port}/?broker={quote(broker, safe=':/')}"


def panel(
    *,
    broker: Annotated[str, Parameter(env_var="ADAPTDRIVE_WEBSOCKET")] = "ws://127.0.0.1:8083/mqtt",
    port: Annotated[Integer, Parameter(validator=validators.Number(gte=0, lte=65535))] = 8088,
    sessions: Path | None = None,
    show: Annotated[bool, Parameter(name="--open")] = True,
) -> int:
    """Serve the panel on the loopback interface until Ctrl-C, and open it in a browser.

    Args:
        broker: Address of the broker's WebSocket listener, ws://… or wss://….
        port: TCP port of the page, 0 for a free one.
        sessions: Folder of the sessions; $STATE_DIRECTORY/sessions or ./sessions when left out.
        show: Open the page in a browser.
    """
    with panel_server(port, session.sessions_directory(sessions, os.environ)) as server:
        address = panel_address(server.server_port, broker)
        print(f"panel: {address}   (Ctrl-C ends)", flush=True)
        if show:  # where it is in the terminal, the call lasts until it is left
            in_thread(functools.partial(webbrowser.open, address), "browser")
        server.serve_forever()
    return 0
