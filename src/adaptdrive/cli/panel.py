"""`adaptdrive panel`: the panel's folder and reports of sessions on loopback, for a desk."""

from __future__ import annotations

import functools
import os
import sys
import threading
import webbrowser
from http import HTTPStatus
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated
from urllib.parse import parse_qs, quote, urlsplit

from cyclopts import Parameter, validators

from adaptdrive.cli.options import Integer
from adaptdrive.util.errors import AdaptdriveError
from adaptdrive.util.threads import in_thread

FOLDER = Path(__file__).parents[1] / "panel"
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' data:; connect-src 'self' ws: wss:; worker-src blob:; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",
}
_REPORT = "/report.html"
_REPORT_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'"
_ONE_REPORT = threading.Lock()
"""Reports are drawn one by one: each takes a processor for seconds."""


class PanelError(AdaptdriveError):
    """The panel cannot be served."""


class PanelHandler(SimpleHTTPRequestHandler):
    """Serves the files of the panel and reports; lists no folder and writes no log."""

    _headers_sent = HEADERS

    def do_GET(self) -> None:
        """Send a file of the panel, or the report of the last session of a drive."""
        asked = urlsplit(self.path)
        if asked.path != _REPORT:
            super().do_GET()
        elif self._is_foreign():
            self.send_error(HTTPStatus.FORBIDDEN)
        else:
            self._send_report(parse_qs(asked.query).get("drive", [""])[0])

    def _is_foreign(self) -> bool:
        """Return whether another site asks, by a link or by a name that it gave to this host."""
        host = self.headers.get("Host", "").rpartition(":")[0]
        site = self.headers.get("Sec-Fetch-Site", "none")
        return host not in ("127.0.0.1", "localhost") or site not in ("none", "same-origin")

    def _send_report(self, drive: str) -> None:
        try:
            with _ONE_REPORT:
                page = last_report(drive)
        except (AdaptdriveError, OSError) as problem:
            self.send_error(HTTPStatus.NOT_FOUND, explain=str(problem))
            return
        self._headers_sent = HEADERS | {"Content-Security-Policy": _REPORT_POLICY}
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Content-Length", str(len(page)))
        self.end_headers()
        self.wfile.write(page)

    def end_headers(self) -> None:
        """Add the headers that keep foreign scripts and frames away."""
        for name, value in self._headers_sent.items():
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
    """Return the address of the page, which links to reports where they can be drawn.

    Args:
        port: TCP port of the server.
        broker: Address of the broker's WebSocket listener.
    """
    report = "&report" if find_spec("matplotlib") else ""
    return f"http://127.0.0.1:{port}/?broker={quote(broker, safe=':/')}{report}"


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


def last_report(drive: str) -> bytes:
    """Draw the last session of a drive, the running one as far as it is; return its HTML page.

    Args:
        drive: Name of the drive.

    Raises:
        AdaptdriveError: There is none, or it cannot be read.
        OSError: As above.
    """
    from adaptdrive.analysis.figure import plot  # noqa: PLC0415 - it is large

    with TemporaryDirectory() as folder:
        _, report = plot(_last_session(drive), into=Path(folder))
        return report.read_bytes()


def _last_session(drive: str) -> Path:
    from adaptdrive.recording.session import (  # noqa: PLC0415
        NO_SESSION,
        read_info,
        session_directories,
        sessions_directory,
    )
    from adaptdrive.util.errors import RecordingError  # noqa: PLC0415 - `--help` reads no recordings

    sessions = sessions_directory(None, os.environ)
    for path in reversed(list(session_directories(sessions))):
        if read_info(path).drive == drive:
            return path
    raise RecordingError(sessions, NO_SESSION)
