"""Constants that compiled copies read from memory do what they do in the interpreter."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
from adaptdrive.control import voltage_loop
from adaptdrive_sim.compiled.translate import translate
from tests.benchmarks.dials import DIALS, install, turn

install()
copy = translate([voltage_loop.__name__])[voltage_loop.__name__]
place = next(i for i, dial in enumerate(DIALS) if dial.name == "INTEGRAL")
for factor in (1.0, 0.5, 2.0):
    turn(place, factor * DIALS[place].value)
    print(voltage_loop.initial_sum(300.0), copy.initial_sum(300.0))
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
