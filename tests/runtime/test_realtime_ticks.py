"""Ticks that are missed, a timer that spins, and memory that stays flat."""

from __future__ import annotations

import asyncio
import json
import math
import re
import shutil
import subprocess
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from adaptdrive.app.ports import build_port
from adaptdrive.app.realtime import Rehearsal
from adaptdrive.clock.tick_timer import TickTimer
from adaptdrive.config import load_configuration
from adaptdrive.hardware.port import Reading
from adaptdrive.runtime.reports import State
from tests.loopback_port import LoopbackPort
from tests.runtime.bench import (
    CALM,
    FAST,
    MOTOR,
    TICK_S,
    FastBench,
    fast_bench,
    running_bench,
    until,
)

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "deploy" / "examples" / "motor.toml"


async def test_missed_half_cycles_are_counted_and_not_made_up() -> None:
    """A loop that slept for three half cycles runs one tick, on the grid, and no burst."""
    async with running_bench() as bench:
        ticks, sent = bench.loop.counts.ticks, len(bench.sent)
        bench.around.now += 3.0 * TICK_S
        bench.loop.on_deadline(bench.around.deadline_s - 3.0 * TICK_S)
        assert bench.loop.counts.ticks == ticks + 1
        assert len(bench.sent) == sent + 1
        assert bench.around.deadline_s > bench.around.now


async def test_a_drive_that_skips_half_cycles_costs_one_tick_each_time() -> None:
    async with running_bench() as bench:
        ticks, missed = bench.loop.counts.ticks, bench.loop.counts.missed
        bench.around.deadline_s = float("inf")
        bench.frame(after_s=3.0 * TICK_S, steps=3)
        assert bench.loop.counts.missed >= missed
        assert bench.loop.counts.ticks > ticks
        assert bench.state() is State.RUNNING


class LateReader(LoopbackPort):
    """A port whose frames nobody looks at until it is asked to catch up."""

    waiting: Reading | None = None

    def catch_up(self) -> None:
        if self.waiting is not None:
            reading, self.waiting = self.waiting, None
            self.deliver(reading)


async def overslept(bench: FastBench, half_cycles: int) -> None:
    """The timer wakes the loop after so many half cycles, whose frames all wait to be read."""
    around, port = bench.around, LateReader(bench.sent.append)
    bench.loop._port = port
    serving = asyncio.create_task(port.run(bench, lambda: None))
    await asyncio.sleep(0)
    around.now += half_cycles * TICK_S + 0.3 * TICK_S
    newest_s = around.now - 0.3 * TICK_S
    port.waiting = replace(
        CALM,
        arrival_s=newest_s,
        oldest_s=newest_s,
        counter=bench.counter + half_cycles,
        bridge=True,
    )
    bench.loop.on_deadline(around.deadline_s)
    serving.cancel()
    await asyncio.wait([serving])


async def test_a_loop_that_overslept_ticks_once_on_the_newest_frame_and_does_not_trip() -> None:
    async with running_bench() as bench:
        ticks, tick, sent = bench.loop.counts.ticks, bench.loop.tick, len(bench.sent)
        half_cycles = int(FAST.timing.stale_s / TICK_S) - 1
        await overslept(bench, half_cycles)
        assert bench.state() is State.RUNNING
        assert (bench.loop.counts.ticks, len(bench.sent)) == (ticks + 1, sent + 1)
        assert (bench.loop.tick, bench.loop.counts.missed) == (tick + half_cycles, half_cycles - 1)
        assert bench.loop.counts.held == 0
        assert bench.reports[-1].measurement.fresh
        assert bench.around.deadline_s > bench.around.now


async def test_what_was_overslept_reaches_the_filters_as_a_drive_that_skipped_it() -> None:
    """The same half cycles lost on the bus instead: controller and filters end up the same."""
    async with fast_bench() as bench, fast_bench() as other:
        bench.start()
        other.start()
        await overslept(bench, 5)
        other.around.deadline_s = math.inf
        other.measured = CALM
        other.frame(after_s=5 * TICK_S, steps=5, bridge=True)
        mine, others = bench.controller.inner, other.controller.inner
        assert bench.loop.tick == other.loop.tick
        assert mine._bank == others._bank
        assert repr(mine._fast) == repr(others._fast)  # a NaN equals none


async def test_each_tick_tells_how_long_it_took() -> None:
    async with running_bench() as bench:
        assert all(report.tick_us >= 0.0 for report in bench.reports)
        assert bench.loop.tick_time.take().max >= 0.0


async def test_a_spinning_timer_is_never_early_and_still_expires_once() -> None:
    times_s: list[float] = []
    loop = asyncio.get_running_loop()
    timer = TickTimer(loop, lambda _: times_s.append(time.monotonic()), spin_s=0.001)
    deadline_s = time.monotonic() + 0.02
    timer.arm(deadline_s)
    await until(lambda: bool(times_s))
    await asyncio.sleep(0.01)
    timer.close()
    assert len(times_s) == 1
    assert times_s[0] >= deadline_s


def test_the_rehearsal_leaves_the_bus_alone() -> None:
    port = build_port(MOTOR, time.monotonic, EXAMPLE)
    ticks = Rehearsal(MOTOR, port).run()
    assert ticks > 3 * MOTOR.ticks_per_period
    assert port.statistics.sent == 0
    assert port.statistics.send_drops >= ticks


@pytest.mark.parametrize("warm_up", [True, False])
@pytest.mark.parametrize("name", ["motor", "bath", "battery", "motor-inverter"])
def test_a_tick_is_rehearsed_from_frames_to_a_command_of_a_drive_that_runs(
    name: str, *, warm_up: bool
) -> None:
    path = EXAMPLE.with_name(f"{name}.toml")
    configuration = load_configuration(path)
    port = build_port(configuration, time.monotonic, path)
    rehearsal = Rehearsal(configuration, port)
    if warm_up:
        rehearsal.run()
    rehearsal.tick()
    before, ticks = port.statistics, rehearsal._loop.counts.ticks
    for _ in range(100):
        rehearsal.tick()
    after, loop = port.statistics, rehearsal._loop
    assert loop.counts.ticks == ticks + 100
    assert loop.command.bridge
    assert rehearsal._machine.trip is None
    assert after.sent == 0
    assert after.send_drops > before.send_drops
    assert after.received >= before.received + 100
    refused = {name: count for name, count in asdict(after).items() if count and count > 0}
    assert refused.keys() == {"received", "send_drops"}


def test_a_fault_that_is_the_drives_initial_value_ends_no_rehearsal(tmp_path: Path) -> None:
    shutil.copy(EXAMPLE, tmp_path)
    text = EXAMPLE.with_name("adaptdrive.dbc").read_text("utf-8")
    message = re.search(r"BO_ (\d+) DriveStatus", text)
    assert message is not None
    attribute = '"GenSigStartValue"'
    initial = f"BA_DEF_ SG_ {attribute} INT 0 255;\nBA_DEF_DEF_ {attribute} 0;\n"
    initial += f"BA_ {attribute} SG_ {message[1]} Fault 1;\n"
    (tmp_path / "adaptdrive.dbc").write_text(f"{text}\n{initial}", "utf-8")
    path = tmp_path / EXAMPLE.name
    configuration = load_configuration(path)
    rehearsal = Rehearsal(configuration, build_port(configuration, time.monotonic, path))
    for _ in range(100):
        rehearsal.tick()
    assert rehearsal._machine.trip is None
    assert rehearsal._loop.command.bridge


@pytest.mark.slow
def test_memory_is_flat_over_twenty_minutes_of_ticks() -> None:
    """What grows with each tick would show, in a process that does nothing else."""
    command = [sys.executable, "-m", "tests.runtime.many_ticks"]
    run = subprocess.run(command, check=False, capture_output=True, text=True, cwd=ROOT)
    assert run.returncode == 0, run.stderr
    found = json.loads(run.stdout)
    assert found["state"] == State.RUNNING
    assert found["missed"] == 0
    assert found["grown_objects"] < 40
    assert found["grown_KiB"] < 512
