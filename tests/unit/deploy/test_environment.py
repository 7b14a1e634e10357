"""The environment of a checkout runs the checkout's own source."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]

pytestmark = pytest.mark.usefixtures("outside")


@pytest.mark.parametrize("folder", ["src/adaptdrive", "simulators/adaptdrive_sim"])
def test_a_process_started_elsewhere_imports_the_source(folder: str, tmp_path: Path) -> None:
    package = Path(folder).name
    program = f"import {package}; print({package}.__file__)"
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert Path(done.stdout.strip()) == ROOT / folder / "__init__.py"
