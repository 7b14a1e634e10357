"""Ticks of the timer, in a process of its own: `timer_ticks.py SECONDS PRIORITY AWAKE`.

The fast loop without a drive, on the kernel's timer, set up as the daemon sets itself up; AWAKE
is 1 to keep idle CPUs from sleeping. Prints the lateness of every tick, in microseconds.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time

from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings, fast_settings, machine_limits
from adaptdrive.config.services import Realtime
from adaptdrive.control.controller import Controller
from adaptdrive.control.signals import Snapshot
from adaptdrive.runtime.fast_loop import FastLoop
from adaptdrive.runtime.realtime import real_time
from adaptdrive.runtime.state_machine import Machine
from adaptdrive.util.clock import TickTimer
from tests.loopback_port import LoopbackPort, Quiet
from tests.unit.devices.bench import MOTOR


class Kept(Quiet):
    """Surroundings of a fast loop that keep the last snapshot alone."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.snapshot: Snapshot | None = None

    def snapshot_taken(self, snapshot: Snapshot) -> bool:
        self.snapshot = snapshot
        return True


class Timed(Kept):
    """Surroundings with the real clock and the real timer."""

    def __init__(self) -> None:
        super().__init__()
        self.timer: TickTimer | None = None

    def now_s(self) -> float:
        return time.monotonic()

    def arm(self, deadline_s: float) -> None:
        if self.timer is not None:
            self.timer.arm(deadline_s)


async def main(duration_s: float, priority: int, *, awake: bool) -> list[float]:
    """Run ticks for so long."""
    around, machine = Timed(), Machine(machine_limits(MOTOR))
    controller = Controller(controller_settings(MOTOR), build_load(MOTOR))
    port = LoopbackPort(lambda _: None, counter_modulus=None)
    loop = FastLoop(port, controller, machine, fast_settings(MOTOR), around)
    times: list[float] = []

    def on_deadline(deadline_s: float) -> None:
        times.append((time.monotonic() - deadline_s) * 1e6)
        loop.on_deadline(deadline_s)

    around.timer = TickTimer(asyncio.get_running_loop(), on_deadline)
    wanted = Realtime(
        priority=priority or None,
        cpu_latency_us=0 if awake else None,
    )
    with real_time(wanted):
        loop.begin()
        await asyncio.sleep(duration_s)
        around.timer.close()
    return times[10:]


if __name__ == "__main__":
    with asyncio.Runner() as runner:
        duration_s, priority, awake = map(float, sys.argv[1:])
        found = runner.run(main(duration_s, int(priority), awake=bool(awake)))
    sys.stdout.write(json.dumps({"lateness_us": found}))
