"""A session about to be recorded, and its directory."""

from __future__ import annotations

from pathlib import Path

import pytest

from adaptdrive.recording.session import create_session
from tests.unit.recording.disk import Disk
from tests.unit.recording.material import INFO


@pytest.fixture
def sessions(tmp_path: Path) -> Path:
    return tmp_path / "sessions"


@pytest.fixture
def directory(sessions: Path) -> Path:
    return create_session(sessions, INFO, "# as configured\n")


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Disk:
    return Disk(monkeypatch)
