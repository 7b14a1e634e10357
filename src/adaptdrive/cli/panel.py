"""`adaptdrive panel`: the panel's folder on the loopback interface, for a desk."""

from __future__ import annotations

import functools
import sys
import webbrowser
from http import HTTPStatus
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Annotated
from urllib.parse import quote

from cyclopts import Parameter, validators

from adaptdrive.aside import in_thread
from adaptdrive.cli.integers import Integer
from adaptdrive.errors import AdaptdriveError

FOLDER = Path(__file__).parents[1] / "panel"
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' data:; connect-src 'self' ws: wss:; worker-src blob:; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",
}


class PanelError(AdaptdriveError):
    """The panel cannot be served."""


class PanelHandler(SimpleHTTPRequestHandler):
    """Serves the files of the panel; lists no folder and writes no log."""

    def end_headers(self) -> None:
        """Add the headers that keep foreign scripts and frames away."""
        for name, value in HEADERS.items():
            self.send_header(name, value)
        super().end_headers()

    def translate_path(self, path: str) -> str:
        """Return the file of a request, that of an unknown page where its path can be none."""
        file = super().translate_path(path)
        return file if file.isprintable() else str(FOLDER / "unknown")

    def list_directory(self, path: object) -> None:  # noqa: ARG002 - the base's signature
        """Refuse to list a folder."""
        self.send_error(HTTPStatus.NOT_FOUND)

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - as above
        """Write nothing."""


class PanelServer(ThreadingHTTPServer):
    """Serves each request in a thread; a browser that goes away is no error."""

    def handle_error(self, request: object, client_address: object) -> None:
        """Print the traceback of an error, unless the connection was lost."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)  # type: ignore[arg-type]


def panel_server(port: int) -> PanelServer:
    """Return a server of the panel on the loopback interface.

    Args:
        port: TCP port, 0 for a free one.

    Raises:
        PanelError: The port is in use.
    """
    try:
        return PanelServer(
            ("127.0.0.1", port), functools.partial(PanelHandler, directory=str(FOLDER))
        )
    except OSError as problem:
        raise PanelError(f"port {port}: {problem}; choose another --port") from problem


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
    show: Annotated[bool, Parameter(name="--open")] = True,
) -> int:
    """Serve the panel on the loopback interface until Ctrl-C, and open it in a browser.

    Args:
        broker: Address of the broker's WebSocket listener, ws://… or wss://….
        port: TCP port of the page, 0 for a free one.
        show: Open the page in a browser.
    """
    with panel_server(port) as server:
        address = panel_address(server.server_port, broker)
        print(f"panel: {address}   (Ctrl-C ends)", flush=True)
        if show:  # where it is in the terminal, the call lasts until it is left
            in_thread(functools.partial(webbrowser.open, address), "browser")
        server.serve_forever()
    return 0
