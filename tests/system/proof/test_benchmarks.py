"""The parts of `make bench` can be measured: their shortest form runs here."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tools.benchmarks.__main__ import PARTS
from tools.builds.run import ROOT

pytestmark = [pytest.mark.slow, pytest.mark.proof]

ABSENT = ("is missing", "no compiled wheel", "No such file or directory: 'cyclictest'")
"""What a machine without a program of Debian, or without a C compiler, cannot measure."""

LONG = {"day", "builds", "equality"}
"""Parts that take minutes in their shortest form, too."""


@pytest.mark.parametrize("part", [part for part in PARTS if part not in LONG])
def test_each_part_is_measured(part: str, tmp_path: Path) -> None:
    output = tmp_path / "bench.json"
    command = [sys.executable, "-m", "tools.benchmarks", "--shortest", "--only", part]
    done = subprocess.run(
        [*command, "--output", output],
        check=False,
        capture_output=True,
        text=True,
        cwd=ROOT,
        timeout=800,
    )
    if any(one in done.stderr for one in ABSENT):
        pytest.skip(done.stderr.strip().splitlines()[-1])
    assert done.returncode == 0, done.stderr
    assert json.loads(output.read_text(encoding="utf-8"))["rows"]
