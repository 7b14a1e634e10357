"""A drive that takes 60 half cycles to switch its bridge on, on CAN, Modbus and SCPI."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import pytest

from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import Disable, Enable, SetSetpoint
from adaptdrive_sim.plants.boost import Sample
from adaptdrive_sim.world import World
from tests.integration.closed_loop.test_same_on_every_bus import COURSES, configured
from tests.integration.closed_loop.wire import WAIT_s, Wire, wired
from tests.support import text_of

pytestmark = pytest.mark.usefixtures("outside")

START_TICKS = 60
BUSES = ["motor", "motor-modbus-tcp", "motor-scpi"]


def switch_on_slowly(world: World) -> None:
    """Let the bridge come on once it has been commanded on for so many half cycles in a row."""
    step, asked = world.step, [0]

    def late(current_scale_S: float, bridge: bool) -> Sample:
        asked[0] = asked[0] + 1 if bridge else 0
        return step(current_scale_S, asked[0] >= START_TICKS)

    world.step = late  # type: ignore[method-assign, assignment]


async def run_drive(wire: Wire) -> str | None:
    """Enable a drive, let it follow a set-point for 20 s; return the cause of its trip."""
    world, machine = wire.world, wire.daemon._machine
    await asyncio.sleep(WAIT_s)
    await wire.daemon.execute(Enable())
    await until(lambda: world.bridge or machine.trip is not None, 10.0)
    if machine.trip is None:
        await wire.daemon.execute(SetSetpoint(3.0))
        await asyncio.sleep(20.0)
    return text_of(machine.trip)


async def stop_before_it_is_on(wire: Wire) -> None:
    """Stop the drive while it switches on; it stays off."""
    await wire.until_running()
    await wire.daemon.execute(SetSetpoint(3.0))
    await asyncio.sleep(0.2)
    assert not wire.world.bridge
    await wire.daemon.execute(Disable())
    await until(lambda: wire.state is State.STANDBY, 1.0)
    await asyncio.sleep(2.0)
    assert wire.state is State.STANDBY
    assert not wire.world.bridge


async def until(done: Callable[[], bool], longest_s: float) -> None:
    for _ in range(round(longest_s / 0.01)):
        if done():
            return
        await asyncio.sleep(0.01)
    raise AssertionError(f"not within {longest_s:g} s")


@contextlib.asynccontextmanager
async def driven(name: str, folder: Path, start_s: float | None) -> AsyncIterator[Wire]:
    """A daemon with a time to start, and its drive that switches on slowly."""
    configuration, path = configured(name, folder)
    interlocks = configuration.interlocks.model_copy(update={"start_s": start_s})
    configuration = configuration.model_copy(update={"interlocks": interlocks})
    async with wired(configuration, COURSES["motor"].settings, path) as wire:
        switch_on_slowly(wire.world)
        yield wire


@pytest.mark.parametrize("name", BUSES)
async def test_a_drive_of_sixty_half_cycles_is_controlled_and_stopped_early_with_its_time_to_start(
    name: str, tmp_path: Path
) -> None:
    async with driven(name, tmp_path, 0.6) as wire:
        await stop_before_it_is_on(wire)
        assert await run_drive(wire) is None
        assert wire.state is State.RUNNING
        assert wire.world.true_output == pytest.approx(3.0, abs=0.05)
        await wire.daemon.execute(Disable())
        await until(lambda: wire.state is State.STANDBY, 1.0)
        assert not wire.world.bridge


@pytest.mark.parametrize(("name", "limit_ms"), [(BUSES[0], 250), (BUSES[1], 300), (BUSES[2], 300)])
async def test_a_drive_of_sixty_half_cycles_trips_without_it(
    name: str, limit_ms: int, tmp_path: Path
) -> None:
    """Thirty half cycles, or three polls of 0.1 s."""
    async with driven(name, tmp_path, None) as wire:
        trip = await run_drive(wire) or ""
        assert f"it has not come on within {limit_ms} ms" in trip
        assert not wire.world.bridge
