"""The busy wait for a frame, in real time."""

from __future__ import annotations

import asyncio
import itertools
import time

from adaptdrive.runtime.frame_watch import FrameWatch
from tests.runtime.bench import until

SPIN_S = 0.01


async def test_it_looks_from_shortly_before_a_frame_is_due_until_shortly_after() -> None:
    looks_s: list[float] = []
    watch = FrameWatch(asyncio.get_running_loop(), lambda: looks_s.append(time.monotonic()), SPIN_S)
    due_s = time.monotonic() + 0.03
    watch.expect(due_s)
    await until(lambda: bool(looks_s))
    await asyncio.sleep(0.02)
    watch.close()
    assert looks_s[0] >= due_s - SPIN_S
    assert len(looks_s) > 100
    assert looks_s[-1] < due_s + SPIN_S


async def test_it_ends_with_the_frame_and_then_waits_for_the_next() -> None:
    frames_s: list[float] = []

    def look() -> None:
        if time.monotonic() >= watch_until[0]:
            frames_s.append(time.monotonic())
            watch_until[0] = frames_s[-1] + 0.03
            watch.expect(watch_until[0])

    watch = FrameWatch(asyncio.get_running_loop(), look, SPIN_S)
    watch_until = [time.monotonic() + 0.03]
    watch.expect(watch_until[0])
    await until(lambda: len(frames_s) == 3)
    watch.close()
    await asyncio.sleep(0.05)
    assert len(frames_s) == 3
    assert all(later - earlier >= 0.03 for earlier, later in itertools.pairwise(frames_s))
