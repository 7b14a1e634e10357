"""The panel's scripts, as the compiler of TypeScript reads their comments."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

HERE = Path(__file__).parent

pytestmark = pytest.mark.usefixtures("outside")


def test_the_scripts_keep_their_types() -> None:
    compiler = shutil.which("tsc")
    if compiler is None:
        pytest.skip("tsc is not installed (npm install --global typescript)")
    command = [compiler, "--project", str(HERE / "tsconfig.json")]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout
