"""Whole demonstrations, as from a command line."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from tests.support import Spawn, sample

PATIENCE_S = 120.0
COMMAND = (sys.executable, "-m", "adaptdrive_sim", "demo")


@pytest.mark.parametrize("name", sample(["motor", "bath", "battery", "braking"], 1))
def test_a_headless_story_prints_one_line_of_json(spawn: Spawn, tmp_path: Path, name: str) -> None:
    process = spawn(*COMMAND, name, "--headless", "--duration=120", "--speed=100000")
    assert process.wait(timeout=PATIENCE_S) == 0
    (line,) = (tmp_path / "process-0.log").read_text().splitlines()
    summary = json.loads(line)
    assert (summary["demo"], summary["ok"], summary["state"]) == (name, True, "running")


def test_an_option_that_cannot_be_is_refused_in_one_line(spawn: Spawn, tmp_path: Path) -> None:
    refused = spawn(*COMMAND, "motor", "--headless", "--duration=0")
    assert refused.wait(timeout=PATIENCE_S) == 1
    (line,) = (tmp_path / "process-0.log").read_text().splitlines()
    assert "--duration 0" in line
