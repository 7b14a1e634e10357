"""Constants that compiled copies read from memory do what they do in the interpreter."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
from adaptdrive.control import evidence, integrated
from adaptdrive_sim.compiled.translate import translate
from tools.benchmarks.dials import DIALS, install, turn

install()
copy = translate([integrated.__name__])[integrated.__name__]
place = next(i for i, dial in enumerate(DIALS) if dial.name == "THRESHOLD")
for factor in (1.0, 0.5, 2.0):
    turn(place, factor * DIALS[place].value)
    print(integrated._loss(1e3, 0.1, 1.0, 0.0), copy._loss(1e3, 0.1, 1.0, 0.0))

place = next(i for i, dial in enumerate(DIALS) if dial.name == "FEWEST")
turn(place, 3)
assert evidence.EARLIEST == 6
"""


@pytest.mark.slow
def test_a_turned_constant_has_its_new_value_in_both(tmp_path: Path) -> None:
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    command = [sys.executable, "-c", SCRIPT]
    told = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    pairs = [line.split() for line in told.stdout.splitlines()]
    assert len({interpreted for interpreted, _ in pairs}) == 3
    for interpreted, compiled in pairs:
        assert compiled == interpreted
