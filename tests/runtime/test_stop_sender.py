"""The end of a daemon whose drive does not confirm its stop."""

from __future__ import annotations

import asyncio

import pytest

from adaptdrive.runtime.requests import Disable
from adaptdrive.runtime.stop_sender import StopSender
from tests.runtime.bench import running_bench


@pytest.mark.parametrize("overslept_s", [0.0, 0.02, 0.5])
async def test_a_stop_that_is_not_confirmed_is_an_alarm_however_long_the_last_sleep_is(
    overslept_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with running_bench() as bench:
        around = bench.around
        sender = StopSender(bench.machine, bench.loop, around.now_s)
        bench.ask(Disable())
        limit_s = around.now + bench.loop.stop_limit_s

        async def sleep(seconds: float) -> None:
            late = around.now + 2.0 * seconds > limit_s
            around.now += seconds + (overslept_s if late else 0.0)

        monkeypatch.setattr(asyncio, "sleep", sleep)
        await sender.await_stop()
        monkeypatch.undo()
        assert bench.trip.startswith("the drive does not stop")
