"""A session about to be recorded, and its directory."""

from __future__ import annotations

from pathlib import Path

import pytest

from adaptdrive.recording.session import NewSession, create_session
from tests.recording.material import INFO


@pytest.fixture
def new_session(tmp_path: Path) -> NewSession:
    return NewSession(tmp_path / "sessions", INFO, "# as configured\n")


@pytest.fixture
def directory(new_session: NewSession) -> Path:
    return create_session(new_session)
