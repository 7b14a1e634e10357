"""The report of the last session that `adaptdrive panel` sends to its page, and to no other."""

from __future__ import annotations

import shutil
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from adaptdrive.cli.desk import panel_server
from tests.unit.recording.material import INFO


@pytest.fixture
def report(outside: None, session_path: Path, tmp_path: Path) -> Iterator[str]:
    """Address of the report of the drive that has a session."""
    shutil.copytree(session_path, tmp_path / "sessions" / session_path.name)
    with panel_server(0, tmp_path / "sessions") as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/report.html?drive={INFO.drive}"
        server.shutdown()
        thread.join()


def test_the_last_session_of_a_drive_is_drawn(report: str, session_path: Path) -> None:
    with urllib.request.urlopen(report) as answer:
        text = answer.read().decode()
        policy = answer.headers.get_all("Content-Security-Policy")
    assert [one.startswith("default-src 'none'") for one in policy] == [True]
    assert "script-src" not in policy[0]
    assert session_path.name in text
    assert "data:image/png;base64," in text


@pytest.mark.parametrize(
    ("rest", "header", "status"),
    [
        ("x", ("Sec-Fetch-Site", "same-origin"), 404),
        ("", ("Sec-Fetch-Site", "cross-site"), 403),
        ("", ("Host", "elsewhere.example:8088"), 403),
    ],
)
def test_no_other_drive_and_no_other_site_has_it(
    report: str, rest: str, header: tuple[str, str], status: int
) -> None:
    asked = urllib.request.Request(report + rest)
    asked.add_header(*header)
    with pytest.raises(urllib.error.HTTPError) as refusal:
        urllib.request.urlopen(asked)
    assert refusal.value.code == status
    refusal.value.close()
