"""Safe commands outside of ticks, counted at a loop that only counts."""

from __future__ import annotations

from typing import cast

from adaptdrive.devices.port import LAST_STOPS
from adaptdrive.runtime.fast_loop import FastLoop
from adaptdrive.runtime.reports import StopWord
from adaptdrive.runtime.requests import Enable
from tests.unit.runtime.bench import idle_daemon
from tests.unit.runtime.test_machine import Desk


class Counting:
    """Stands for a fast loop.

    Attributes:
        sent: Safe commands.
    """

    stop_limit_s = 0.5
    stop = StopWord.AWAITED

    def __init__(self) -> None:
        self.sent = 0

    def send_safe(self) -> None:
        self.sent += 1


def test_a_flood_of_stops_leaves_out_none_of_an_energised_drive() -> None:
    desk, fast = Desk(), Counting()
    daemon = idle_daemon(desk.machine, cast(FastLoop, fast), lambda: 100.0)
    daemon.stop()
    daemon.stop()
    assert fast.sent == 1
    desk.ask(Enable())
    daemon.stop()
    assert fast.sent == 2
    assert not desk.machine.energised


async def test_a_farewell_is_said_more_than_once() -> None:
    desk, fast = Desk(), Counting()
    desk.ask(Enable())
    await idle_daemon(desk.machine, cast(FastLoop, fast), lambda: 100.0)._send_last_stops()
    assert fast.sent == LAST_STOPS > 1
    assert not desk.machine.energised
