"""The timer of the kernel, with deadlines that are past or far: no test waits for one."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest

from adaptdrive.util.clock import TickTimer, now_s


class Timer(TickTimer):
    """Notes for which deadlines it has expired."""

    def __init__(self) -> None:
        super().__init__(asyncio.get_running_loop(), self._note)
        self.expired_s: list[float] = []
        self.follow = 0.0

    def _note(self, deadline_s: float) -> None:
        self.expired_s.append(deadline_s)
        if self.follow and len(self.expired_s) < 25:
            self.arm(deadline_s + self.follow)


@pytest.fixture
async def timer() -> AsyncIterator[Timer]:
    timer = Timer()
    yield timer
    timer.close()


async def test_a_deadline_in_the_past_expires_at_once_and_once(timer: Timer) -> None:
    past_s = now_s() - 5.0
    timer.arm(past_s)
    await asyncio.sleep(1.0)
    assert timer.expired_s == [past_s]


async def test_arming_again_replaces_the_deadline_also_in_the_round_it_expires_in(
    timer: Timer,
) -> None:
    """A late frame and the deadline of its stand-in wake the loop together, the frame first."""
    past_s = now_s() - 5.0
    asyncio.get_running_loop().call_soon(timer.arm, past_s)
    asyncio.get_running_loop().call_soon(timer._expired)
    timer.arm(past_s)
    timer.arm(past_s + 3600.0)
    timer._expired()  # woken by the deadline before
    assert timer.expired_s == []
    await asyncio.sleep(1.0)
    assert timer.expired_s == [past_s]


async def test_deadlines_on_a_grid_do_not_drift(timer: Timer) -> None:
    """Lateness of one tick is not handed on to the next."""
    start_s, timer.follow = now_s() - 5.0, 0.002
    timer.arm(start_s)
    await asyncio.sleep(1.0)
    grid = [start_s + index * 0.002 for index in range(25)]
    assert timer.expired_s == pytest.approx(grid, abs=1e-9)


async def test_a_closed_timer_is_silent_and_can_be_closed_again(timer: Timer) -> None:
    timer.arm(now_s() - 5.0)
    timer.close()
    timer.close()
    await asyncio.sleep(1.0)
    assert timer.expired_s == []
