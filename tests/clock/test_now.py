"""The clock of the daemon on a machine that was suspended before it started."""

from __future__ import annotations

import subprocess
import sys

from tests.support import suspended_machine

PROGRAM = """
import asyncio, pathlib, time
from adaptdrive.clock.now import now_s
from adaptdrive.clock.tick_timer import TickTimer

async def main():
    uptime_s = float(pathlib.Path("/proc/uptime").read_text().split()[0])
    print(round(now_s() - uptime_s, 1), round(now_s() - time.monotonic()))
    expired = asyncio.Event()
    timer = TickTimer(asyncio.get_running_loop(), lambda _: expired.set())
    timer.arm(now_s() + 0.05)
    async with asyncio.timeout(20.0):
        await expired.wait()
    timer.close()

asyncio.run(main())
"""


def test_it_counts_a_suspend_and_the_timer_keeps_it() -> None:
    command = [*suspended_machine(3600), sys.executable, "-c", PROGRAM]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    behind_s, slept_s = map(float, done.stdout.split())
    assert abs(behind_s) <= 0.5
    assert slept_s == 3600
