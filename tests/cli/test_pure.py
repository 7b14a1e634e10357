"""The choice between compiled modules and their sources, in an interpreter of its own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

import pytest

SOURCES = Path(__file__).parents[2] / "src" / "adaptdrive"
SHOW = "from adaptdrive.pure import build_name; print(build_name())"


@pytest.fixture
def damaged(outside: None, tmp_path: Path) -> Path:
    """A copy of the package with a compiled module that no interpreter can load."""
    shutil.copytree(SOURCES, tmp_path / "adaptdrive", ignore=shutil.ignore_patterns("panel"))
    module = tmp_path / "adaptdrive" / "control" / f"controller{EXTENSION_SUFFIXES[0]}"
    module.write_bytes(b"no shared object")
    return tmp_path


def show(folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", SHOW],
        check=False,
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(folder), **environment},
    )


def test_a_compiled_module_precedes_its_source(damaged: Path) -> None:
    assert "ImportError" in show(damaged, ADAPTDRIVE_PURE="0").stderr


def test_the_environment_chooses_the_sources(damaged: Path) -> None:
    shown = show(damaged, ADAPTDRIVE_PURE="1")
    assert (shown.returncode, shown.stdout) == (0, "pure Python\n"), shown.stderr
