"""A drive that was commanded on, and of which nothing is heard for longer than it may stay on."""

from __future__ import annotations

from dataclasses import replace

import pytest

from adaptdrive.app.settings import fast_settings
from adaptdrive.safety.timing import Timing
from tests.unit.devices.canopen.documents import bus_of, flaws, parse
from tests.unit.runtime.bench import FAST, running_bench

HALF_CYCLE_S = 1.0 / 120.0
TIMEOUT_S = 0.1
TIMING = Timing(HALF_CYCLE_S, stale_s=0.05, command_timeout_s=TIMEOUT_S)


def test_the_time_out_from_a_command_on_is_that_of_a_heartbeat_sent_long_before() -> None:
    bus = bus_of(parse({"bus/heartbeat_timeout_s": 0.15}))
    assert bus.command_timeout_s == pytest.approx(0.12)


def test_three_heartbeats_in_a_row_may_be_lost() -> None:
    bus = bus_of(parse({"bus/heartbeat_timeout_s": None}))
    assert bus.heartbeat_timeout_s > 4.0 * bus.heartbeat_s


@pytest.mark.parametrize("line_frequency_Hz", [50, 60])
def test_a_time_out_that_ends_between_two_commands_is_refused(line_frequency_Hz: int) -> None:
    line = {"drive/line_frequency_Hz": line_frequency_Hz}
    assert "0.025" in flaws({**line, "bus/heartbeat_timeout_s": 0.0249})["bus.heartbeat_timeout_s"]
    least = parse({**line, "bus/heartbeat_timeout_s": 0.025})
    assert bus_of(least).command_timeout_s >= 1.5 * least.drive.half_cycle_s


async def test_a_daemon_that_slept_for_longer_than_the_drive_misses_its_heartbeat_waits() -> None:
    """A single command ends a quick stop, into which the drive may have gone meanwhile."""
    watched = {"bus/heartbeat_timeout_s": 0.04}
    timing = fast_settings(parse({**watched, "interlocks/stale_s": 0.1})).timing
    async with running_bench(replace(FAST, timing=timing), frames=10) as bench:
        deadline_s, known = bench.around.deadline_s, len(bench.sent)
        bench.around.now = deadline_s + 0.04
        bench.loop.on_deadline(deadline_s)
        assert bench.sent[known:] == []
        bench.frame(0.0, bridge=True)
        assert bench.sent[-1].bridge
