"""A session about to be recorded, and its directory."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
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


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 6 MB, where one may be mounted."""
    disk = tmp_path / "disk"
    disk.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=6m", "tmpfs", str(disk)]
    mounted = subprocess.run(command, capture_output=True, check=False)
    if mounted.returncode != 0:
        pytest.skip("no disk can be mounted here")
    yield disk
    subprocess.run(["umount", "--lazy", str(disk)], check=True)
