"""A stand-in for the control process: records ticks at 1 kHz and events until it is killed.

Run as `python control_process.py SESSIONS`; its log is on stderr.
"""

import asyncio
import sys
import time
from dataclasses import replace
from itertools import count
from pathlib import Path

from adaptdrive.app.reload import write_events
from adaptdrive.recording.recorder import Recorder
from adaptdrive.recording.records import Header, Pace
from adaptdrive.runtime.reports import Event, Hub, Severity
from tests.unit.recording.material import INFO, make_tick


def clock() -> tuple[float, float]:
    return time.monotonic(), time.time()


async def publish(hub: Hub) -> None:
    for sequence in count():
        hub.publish(replace(make_tick(sequence), time_s=time.monotonic()))
        if sequence % 20 == 0:
            hub.publish(Event("mode", Severity.INFO, f"number {sequence}", sequence))
        await asyncio.sleep(0.001)


async def main(sessions: Path) -> None:
    hub = Hub()
    pace = Pace(flush_s=0.1, keep_s=60.0)
    log = sessions.with_name("motor.log")
    recorder = Recorder(log, sessions, Header(INFO, ""), hub, clock, pace)
    hub.kept = recorder.kept
    events = hub.subscribe(Event, size=1000)
    async with asyncio.TaskGroup() as group:
        group.create_task(recorder.run())
        group.create_task(write_events(events, hub.kept))
        group.create_task(publish(hub))


asyncio.run(main(Path(sys.argv[1])))
