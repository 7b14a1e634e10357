"""A failure in a virtual machine that other processes kept from running is not judged."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.scenes.vm import guest_tests
from tools.vm import processors
from tools.vm.machine import Outcome

_BUSY = "import os, time\nos.sched_setaffinity(0, {%d})\nwhile time.process_time() < 1: pass"


def test_a_process_that_shares_its_processor_gets_less_than_the_least_share() -> None:
    processor = min(os.sched_getaffinity(0))
    command = [sys.executable, "-c", _BUSY % processor]
    with subprocess.Popen(command) as one, subprocess.Popen(command) as other:
        share = processors.wait(one, 120.0)
        other.wait()
    assert 0.0 < share < processors.LEAST_SHARE


@pytest.mark.parametrize(
    ("share", "verdict"), [(0.5, pytest.skip.Exception), (0.7, pytest.fail.Exception)]
)
def test_a_failure_counts_when_the_machine_had_its_processors(
    share: float, verdict: type[BaseException], tmp_path: Path, subtests: pytest.Subtests
) -> None:
    outcome = Outcome(None, "", "kernel panic", share)
    with pytest.raises(verdict, match="kernel panic"):
        guest_tests.show(tmp_path, outcome, subtests)
