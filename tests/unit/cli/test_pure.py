"""The choice between compiled modules and their sources, in an interpreter of its own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
SOURCES = (ROOT / "src" / "adaptdrive", ROOT / "simulators" / "adaptdrive_sim")
MODULES = ("adaptdrive/control/controller", "adaptdrive_sim/wire")
SHOW = "from adaptdrive import build_name; import {}; print(build_name())"


@pytest.fixture
def damaged(outside: None, tmp_path: Path) -> Path:
    """A copy of the packages with compiled modules that no interpreter can load."""
    for source in SOURCES:
        copy = tmp_path / source.name
        shutil.copytree(source, copy, ignore=shutil.ignore_patterns("panel", "examples"))
    for module in MODULES:
        (tmp_path / f"{module}{EXTENSION_SUFFIXES[0]}").write_bytes(b"no shared object")
    return tmp_path


def show(folder: Path, module: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", SHOW.format(module.replace("/", "."))],
        check=False,
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(folder), **environment},
    )


@pytest.mark.parametrize("module", MODULES)
def test_a_compiled_module_precedes_its_source(damaged: Path, module: str) -> None:
    assert "ImportError" in show(damaged, module, ADAPTDRIVE_PURE="0").stderr


@pytest.mark.parametrize("module", MODULES)
def test_the_environment_chooses_the_sources(damaged: Path, module: str) -> None:
    shown = show(damaged, module, ADAPTDRIVE_PURE="1")
    assert (shown.returncode, shown.stdout) == (0, "pure Python\n"), shown.stderr
