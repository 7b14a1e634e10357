"""A session's directory."""

from __future__ import annotations

from pathlib import Path

import pytest

from adaptdrive.recording.session import NewSession, create_session
from tests.recording.material import INFO


@pytest.fixture
def session(tmp_path: Path) -> NewSession:
    return create_session(tmp_path / "sessions", INFO, "# as configured\n")
