"""The clock of the daemon on a machine that was suspended, and the timer of its kernel."""

from __future__ import annotations

import asyncio
import subprocess
import sys

import pytest

from adaptdrive.util.clock import TickTimer, now_s
from tests.support import suspended_machine

pytestmark = pytest.mark.usefixtures("outside")

PROGRAM = """
import asyncio, pathlib, time
from adaptdrive.util.clock import now_s
from adaptdrive.util.clock import TickTimer

def uptime_s():
    return float(pathlib.Path("/proc/uptime").read_text().split()[0])

async def main():
    before_s, present_s, after_s = uptime_s(), now_s(), uptime_s()
    print(before_s - 0.02 <= present_s <= after_s + 0.02, round(now_s() - time.monotonic()))
    expired = asyncio.Event()
    timer = TickTimer(asyncio.get_running_loop(), lambda _: expired.set())
    timer.arm(now_s() + 0.05)
    async with asyncio.timeout(60.0):
        await expired.wait()
    timer.close()

asyncio.run(main())
"""


def test_it_counts_a_suspend_and_the_timer_keeps_it() -> None:
    command = [*suspended_machine(3600), sys.executable, "-c", PROGRAM]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["True", "3600"]


async def test_a_timer_expires_once_and_never_early() -> None:
    times_s: list[float] = []
    expired = asyncio.Event()

    def expire(_: float) -> None:
        times_s.append(now_s())
        expired.set()

    timer = TickTimer(asyncio.get_running_loop(), expire)
    deadline_s = now_s() + 0.02
    timer.arm(deadline_s)
    await expired.wait()
    await asyncio.sleep(0.03)
    timer.close()
    assert len(times_s) == 1
    assert times_s[0] >= deadline_s - 1e-6
