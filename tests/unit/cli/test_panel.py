"""`adaptdrive panel`: the page on loopback, with the headers that keep foreign scripts away."""

from __future__ import annotations

import socket
import struct
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from adaptdrive.cli.desk import FOLDER, panel_address, panel_server
from adaptdrive.util.errors import AdaptdriveError


@pytest.fixture
def sessions(tmp_path: Path) -> Path:
    """A folder with an index, a session, and files of no concern to a page."""
    session = tmp_path / "sessions" / "20261121T012209Z_motor"
    (session / "trip-1").mkdir(parents=True)
    for name in ("index.json", "secret.json"):
        (session.parent / name).write_text(name, encoding="utf-8")
    for name in ("overview.json", "ticks-0001.parquet", "trip-1/overview.json", "config.toml"):
        (session / name).write_text(name, encoding="utf-8")
    (session / ".new-1").mkdir()
    (session / ".new-1" / "overview.json").touch()
    (tmp_path / "index.json").write_text("outside", encoding="utf-8")
    return session.parent


@pytest.fixture
def port(outside: None, sessions: Path) -> Iterator[int]:
    with panel_server(0, sessions) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield server.server_port
        server.shutdown()
        thread.join()


@pytest.mark.parametrize(
    ("path", "kind"),
    [("", "text/html"), ("panel.js", "text/javascript"), ("panel.css", "text/css")],
)
def test_files_come_with_type_and_policy(port: int, path: str, kind: str) -> None:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/{path}?broker=ws://x") as answer:
        assert answer.headers.get_content_type() == kind
        policy = answer.headers["Content-Security-Policy"]
        assert answer.headers["X-Content-Type-Options"] == "nosniff"
        assert answer.read() == (FOLDER / (path or "index.html")).read_bytes()
    assert "script-src 'self';" in policy
    assert "frame-ancestors 'none'" in policy


@pytest.mark.parametrize(
    "path",
    ["vendor/", "../cli/panel.py", "%2e%2e/cli/panel.py", "none", "%00", "%ed%a0%80", "a%0ab"],
)
def test_nothing_else_is_served(port: int, path: str) -> None:
    with pytest.raises(urllib.error.HTTPError) as refusal:
        urllib.request.urlopen(f"http://127.0.0.1:{port}/{path}")
    assert refusal.value.code == 404
    refusal.value.close()


def test_a_browser_that_goes_away_leaves_no_trace(
    outside: None, sessions: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The connection is reset before the request is served, in this thread."""
    with panel_server(0, sessions) as server:
        with socket.create_connection(("127.0.0.1", server.server_port)) as browser:
            browser.sendall(b"GET / HTTP/1.1\r\n")
            browser.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        server.process_request_thread(*server.get_request())
    assert capfd.readouterr().err == ""


SESSION = "sessions/motor/20261121T012209Z_motor"


@pytest.mark.parametrize(
    "path",
    [
        "sessions/motor/index.json",
        f"{SESSION}/overview.json",
        f"{SESSION}/ticks-0001.parquet",
        f"{SESSION}/trip-1/overview.json",
    ],
)
def test_what_the_page_reads_of_sessions_is_served(port: int, path: str) -> None:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/{path}") as answer:
        assert path.endswith(answer.read().decode())


@pytest.mark.parametrize(
    "path",
    [
        *("sessions/", "sessions/motor/", "sessions/index.json", f"{SESSION}/"),
        *(f"{SESSION}/config.toml", f"{SESSION}/.new-1/overview.json"),
        *("sessions/motor/secret.json", "sessions/motor/../../index.json"),
        *("sessions/motor/%2e%2e/index.json", "sessions/motor/..%2findex.json"),
        *("sessions/motor//../../index.json", "sessions/motor/x%2f..%2f..%2findex.json"),
    ],
)
def test_nothing_else_of_sessions_is_served(port: int, path: str) -> None:
    with pytest.raises(urllib.error.HTTPError) as refusal:
        urllib.request.urlopen(f"http://127.0.0.1:{port}/{path}")
    assert refusal.value.code == 404
    refusal.value.close()


@pytest.mark.parametrize("path", ["sessions/motor/index.json", "%73essions/motor/index.json"])
@pytest.mark.parametrize("header", [("Host", "elsewhere:8088"), ("Sec-Fetch-Site", "cross-site")])
def test_another_site_reads_no_session(port: int, path: str, header: tuple[str, str]) -> None:
    """Neither by a link nor by a name of its own for this host."""
    asked = urllib.request.Request(f"http://127.0.0.1:{port}/{path}", headers=dict([header]))
    with pytest.raises(urllib.error.HTTPError) as refusal:
        urllib.request.urlopen(asked)
    assert refusal.value.code == 404
    refusal.value.close()


def test_a_port_in_use_is_named(port: int, sessions: Path) -> None:
    with pytest.raises(AdaptdriveError, match=f"port {port}"):
        panel_server(port, sessions)


def test_the_address_carries_the_broker() -> None:
    address = panel_address(8088, "ws://host:8083/mqtt?x")
    assert address == "http://127.0.0.1:8088/?broker=ws://host:8083/mqtt%3Fx"
