"""An event loop whose time passes as fast as everything is done.

Tests outside `tests/system` run in it: their clock moves only when there is nothing left to do,
that is, no callback is ready, no byte has come, and no thread or reply is under way. Frames and
registers still go through the kernel; a wait of an hour takes no time.
"""

from __future__ import annotations

import asyncio
import contextlib
import selectors
import time
from collections.abc import Awaitable, Callable, Iterator
from typing import Any

import can
import pytest

from adaptdrive.devices.can import connection, integrity
from adaptdrive.devices.can.integrity import ArrivalClock
from adaptdrive.devices.canopen import port as canopen_port
from adaptdrive.devices.modbus.link import SerialPort
from adaptdrive.devices.polled.link import PolledLink
from adaptdrive.util import clock
from tests.unit.devices.can_memory import open_memory

PATIENCE_s = 5.0
"""Longest real wait for one byte, thread or reply; a test that needs it would hang otherwise."""


class _Selector(selectors.DefaultSelector):
    """Moves the loop's clock instead of sleeping, unless something is under way."""

    def __init__(self) -> None:
        super().__init__()
        self.now_s = time.monotonic() + 1e6  # kernel timers on this clock never expire
        self.under_way = 0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        events = super().select(0)
        if events or timeout == 0:
            return events
        if self.under_way or timeout is None:
            return super().select(PATIENCE_s)
        self.now_s += max(timeout, 0.0)
        return []


class VirtualLoop(asyncio.SelectorEventLoop):
    """An event loop in virtual time, which stands still while a thread of its pool works."""

    def __init__(self) -> None:
        self.selector = _Selector()
        super().__init__(self.selector)

    def time(self) -> float:
        return self.selector.now_s

    def run_in_executor(  # type: ignore[override]
        self, executor: Any, func: Callable[..., Any], *args: Any
    ) -> asyncio.Future[Any]:
        future = super().run_in_executor(executor, func, *args)
        self.selector.under_way += 1
        future.add_done_callback(self._arrived)
        return future

    def _arrived(self, _: object) -> None:
        self.selector.under_way -= 1


@contextlib.contextmanager
def virtual_time() -> Iterator[asyncio.Runner]:
    """Run coroutines in virtual time; what really takes time on a polled link holds it still."""
    with links_held(), asyncio.Runner(loop_factory=VirtualLoop) as runner:
        yield runner


@contextlib.contextmanager
def links_held() -> Iterator[None]:
    """Hold virtual time still while a polled link opens or waits for a reply.

    Buses of CAN in this process are in memory, and their times those of the loop.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PolledLink, "open", held(PolledLink.open))
        patch.setattr(PolledLink, "_reply", held(PolledLink._reply))
        patch.setattr(SerialPort, "open", held(SerialPort.open))
        patch.setattr(can, "Bus", open_memory)
        for module in (connection, canopen_port):
            patch.setattr(module, "pulsing", pulsing)
        patch.setattr(integrity, "ArrivalClock", arrival_clock)
        yield


@contextlib.contextmanager
def pulsing(period_s: float, *due: Callable[[], object]) -> Iterator[None]:
    """Call back on a grid, as that of the kernel's timer, in the time of the running loop."""
    loop = asyncio.get_running_loop()
    if not due or not isinstance(loop, VirtualLoop):
        with clock.pulsing(period_s, *due):
            yield
        return

    timers: list[asyncio.TimerHandle] = []

    def arm(deadline_s: float) -> None:
        timers[:] = [loop.call_at(deadline_s, expire, deadline_s)]

    def expire(deadline_s: float) -> None:
        arm(deadline_s + period_s)
        for call in due:
            call()

    arm(loop.time() + period_s)
    try:
        yield
    finally:
        timers[0].cancel()


def arrival_clock(
    clock: Callable[[], float], wall_clock: Callable[[], float] = time.time
) -> ArrivalClock:
    """Return a clock of arrivals whose stamps are those of the loop in virtual time."""
    try:
        virtual = isinstance(asyncio.get_running_loop(), VirtualLoop)
    except RuntimeError:
        virtual = False
    return ArrivalClock(clock, clock if virtual and wall_clock is time.time else wall_clock)


def held(call: Callable[..., Awaitable[Any]]) -> Callable[..., Awaitable[Any]]:
    """Return the same call, during which virtual time stands still."""

    async def call_held(*words: Any) -> Any:
        loop = asyncio.get_running_loop()
        if not isinstance(loop, VirtualLoop):
            return await call(*words)
        loop.selector.under_way += 1
        try:
            return await call(*words)
        finally:
            loop.selector.under_way -= 1

    return call_held
