"""Before a frame: a busy wait, which a clock of the test ends, and a rehearsal."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import replace

import pytest

from adaptdrive.runtime.tick_support import TickSupport
from tests.runtime.bench import SETTINGS, until

SPIN_S, LOOK_S = 0.01, 0.001


def nothing() -> None:
    """Look at a bus that has no frame."""


def spinning(
    look: Callable[[], None], spin_s: float, clock: Callable[[], float] = time.monotonic
) -> TickSupport:
    """A busy wait in the running loop."""
    realtime = SETTINGS.realtime.model_copy(update={"spin_us": spin_s * 1e6})
    settings = replace(SETTINGS, realtime=realtime)
    return TickSupport(settings, look, nothing, lambda _, text: pytest.fail(text), clock)


def rehearsing(
    rehearse: Callable[[], None],
    lead_s: float,
    look: Callable[[], None] = nothing,
    report_end: Callable[[str], None] = pytest.fail,
) -> TickSupport:
    """A rehearsal in the running loop."""
    realtime = SETTINGS.realtime.model_copy(update={"rehearse_us": lead_s * 1e6})
    settings = replace(SETTINGS, realtime=realtime)
    return TickSupport(settings, look, rehearse, lambda _, text: report_end(text), time.monotonic)


class Bus:
    """Each look takes a millisecond; the frame comes at the last of so many."""

    def __init__(self, looks_to_frame: int) -> None:
        self.due_s = time.monotonic() - SPIN_S  # the timer expires at once
        self.now_s = self.due_s - SPIN_S + 0.5 * LOOK_S
        self.looks = 0
        self._looks_to_frame = looks_to_frame
        self.watch = spinning(self._look, SPIN_S, lambda: self.now_s)
        self.watch.expect(self.due_s)

    def _look(self) -> None:
        self.looks += 1
        self.now_s += LOOK_S
        if self.looks == self._looks_to_frame:
            self.watch.expect(self.due_s + 3600.0)


@pytest.mark.parametrize(("looks_to_frame", "looks"), [(1, 1), (7, 7), (1000, 20)])
async def test_it_looks_until_the_frame_has_come_or_is_late(
    looks_to_frame: int, looks: int
) -> None:
    bus = Bus(looks_to_frame)
    await until(lambda: bus.looks > 0)
    await asyncio.sleep(0.01)
    bus.watch.close()
    assert bus.looks == looks


async def test_it_begins_shortly_before_the_frame_is_due() -> None:
    looks_s: list[float] = []
    spin_s = 5.0  # more than a busy machine oversleeps

    def look() -> None:
        looks_s.append(time.monotonic())
        watch.expect(due_s + 3600.0)

    watch = spinning(look, spin_s)
    due_s = time.monotonic() + spin_s + 0.05
    watch.expect(due_s)
    await until(lambda: bool(looks_s))
    watch.close()
    assert due_s - spin_s <= looks_s[0] < due_s


async def test_each_frame_is_rehearsed_once_and_before_it_is_due() -> None:
    times_s: list[float] = []
    rehearsal = rehearsing(lambda: times_s.append(time.monotonic()), lead_s=0.02)
    for number in range(3):
        due_s = time.monotonic() + 0.05
        rehearsal.expect(due_s)
        await until(lambda expected=number + 1: len(times_s) == expected)  # type: ignore[misc]
        assert times_s[-1] >= due_s - 0.02
    await asyncio.sleep(0.03)
    rehearsal.close()
    assert len(times_s) == 3


async def test_a_frame_that_is_early_puts_its_rehearsal_off() -> None:
    times_s: list[float] = []
    rehearsal = rehearsing(lambda: times_s.append(time.monotonic()), lead_s=0.001)
    rehearsal.expect(time.monotonic() + 0.02)
    rehearsal.expect(time.monotonic() + 3600.0)
    await asyncio.sleep(0.04)
    rehearsal.close()
    assert not times_s


async def test_a_rehearsal_that_fails_is_told_and_is_the_last_one() -> None:
    uncaught: list[object] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: uncaught.append(context))
    calls: list[str] = []

    def fail() -> None:
        calls.append("rehearsed")
        raise ZeroDivisionError("of a load")

    rehearsal = rehearsing(fail, 0.001, lambda: calls.append("looked"), calls.append)
    rehearsal.expect(time.monotonic())
    await until(lambda: "looked" in calls or bool(uncaught))
    rehearsal.expect(time.monotonic())
    await asyncio.sleep(0.01)
    rehearsal.close()
    assert calls == [
        "rehearsed",
        "rehearse_us has no effect any more: ZeroDivisionError('of a load')",
        "looked",
    ]
    assert not uncaught


async def test_a_look_at_the_bus_that_fails_is_no_rehearsal_that_fails() -> None:
    loop = asyncio.get_running_loop()
    uncaught: list[object] = []
    loop.set_exception_handler(lambda _, context: uncaught.append(context["exception"]))

    def fail() -> None:
        raise ZeroDivisionError

    rehearsal = rehearsing(nothing, 0.001, look=fail)
    rehearsal.expect(time.monotonic())
    await until(lambda: bool(uncaught))
    rehearsal.close()
    assert isinstance(uncaught[0], ZeroDivisionError)
