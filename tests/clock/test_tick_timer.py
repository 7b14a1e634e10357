"""The timer of the kernel, with real time."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import AsyncIterator

import pytest

from adaptdrive.clock.tick_timer import TickTimer
from tests.runtime.bench import until


class Expiries:
    """Notes when the timer expired, and for which deadline."""

    def __init__(self) -> None:
        self.times_s: list[float] = []
        self.deadlines_s: list[float] = []

    def __call__(self, deadline_s: float) -> None:
        self.times_s.append(time.monotonic())
        self.deadlines_s.append(deadline_s)


@pytest.fixture
def expiries() -> Expiries:
    return Expiries()


@pytest.fixture
async def timer(expiries: Expiries) -> AsyncIterator[TickTimer]:
    timer = TickTimer(asyncio.get_running_loop(), expiries)
    yield timer
    timer.close()


async def test_it_expires_once_and_never_early(timer: TickTimer, expiries: Expiries) -> None:
    deadline_s = time.monotonic() + 0.02
    timer.arm(deadline_s)
    await until(lambda: bool(expiries.times_s))
    assert expiries.deadlines_s == [deadline_s]
    assert expiries.times_s[0] >= deadline_s - 1e-6
    await asyncio.sleep(0.03)
    assert len(expiries.times_s) == 1


async def test_a_deadline_in_the_past_expires_at_once(timer: TickTimer, expiries: Expiries) -> None:
    past_s = time.monotonic() - 5.0
    timer.arm(past_s)
    await until(lambda: bool(expiries.times_s))
    assert expiries.deadlines_s == [past_s]


async def test_arming_again_replaces_the_deadline(timer: TickTimer, expiries: Expiries) -> None:
    now_s = time.monotonic()
    timer.arm(now_s + 0.01)
    timer.arm(now_s + 3600.0)
    await asyncio.sleep(0.03)
    assert expiries.times_s == []
    timer.arm(now_s)
    await until(lambda: bool(expiries.times_s))
    assert expiries.deadlines_s == [now_s]


async def test_armed_anew_in_the_round_it_expired_in_it_waits_for_its_new_deadline(
    timer: TickTimer, expiries: Expiries
) -> None:
    """A late frame and the deadline of its stand-in wake the loop together, the frame first."""
    far_s = time.monotonic() + 3600.0

    def take_frame() -> None:
        frame.recv(1)
        timer.arm(far_s)

    loop = asyncio.get_running_loop()
    frame, sender = socket.socketpair()
    with frame, sender:
        loop.add_reader(frame.fileno(), take_frame)
        timer.arm(time.monotonic() + 0.01)
        sender.send(b"f")
        time.sleep(0.02)  # noqa: ASYNC251 - both are ready when the loop looks next
        await asyncio.sleep(0.05)
        loop.remove_reader(frame.fileno())
    assert expiries.times_s == []


async def test_deadlines_on_a_grid_do_not_drift(expiries: Expiries) -> None:
    """Lateness of one tick is not handed on to the next."""
    start_s, step_s, count = time.monotonic(), 0.002, 25

    def again(deadline_s: float) -> None:
        expiries(deadline_s)
        time.sleep(0.001)
        if len(expiries.times_s) < count:
            grid_timer.arm(deadline_s + step_s)

    grid_timer = TickTimer(asyncio.get_running_loop(), again)
    grid_timer.arm(start_s)
    await until(lambda: len(expiries.times_s) == count)
    grid_timer.close()
    grid = [start_s + index * step_s for index in range(count)]
    assert expiries.deadlines_s == pytest.approx(grid, abs=1e-9)


async def test_a_closed_timer_is_silent_and_can_be_closed_again(
    timer: TickTimer, expiries: Expiries
) -> None:
    timer.arm(time.monotonic() + 0.005)
    timer.close()
    timer.close()
    await asyncio.sleep(0.02)
    assert expiries.times_s == []
