"""The whole daemon but its broker, in the test's own process, on whatever bus a test gives it.

What an operator would see is kept: every event and every state, with the time at which it came.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from adaptdrive.app.loads import build_load
from adaptdrive.app.ports import build_port
from adaptdrive.app.settings import controller_settings, fast_settings, machine_limits
from adaptdrive.config import Configuration
from adaptdrive.control.controller import Controller
from adaptdrive.devices.port import Port
from adaptdrive.runtime.daemon import Daemon
from adaptdrive.runtime.reports import (
    DriveReport,
    Event,
    Hub,
    State,
    StateReport,
    Subscription,
    TickReport,
)
from adaptdrive.runtime.requests import Enable, Request, Reset, SetSetpoint
from adaptdrive.runtime.tick_support import ServiceManager
from adaptdrive.util.errors import RefusedError
from tests.unit.runtime.bench import LoopTimer
from tests.virtual_time import VirtualLoop

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"
PATIENCE_s = 60.0
_TOLD_s = 0.02
"""Time that a new state takes to be told."""

_ON_THE_WAY = {State.STANDBY, State.STARTING}


@dataclass
class Rig:
    """A running daemon, and what has been heard of it.

    Attributes:
        events: Events, and when each came.
        setpoint: One that V_c can hold.
        used: Every pair of boost voltage and output that a tick was computed from.
        state: The last state.
        drive: The last report on the drive.
    """

    daemon: Daemon
    port: Port
    reports: Subscription
    setpoint: float
    events: list[tuple[float, Event]] = field(default_factory=list)
    used: set[tuple[float, float]] = field(default_factory=set)
    state: StateReport | None = None
    drive: DriveReport | None = None

    async def listen(self) -> None:
        """Keep what is reported."""
        while True:
            for report in await self.reports.take():
                match report:
                    case Event():
                        self.events.append((asyncio.get_running_loop().time(), report))
                    case StateReport():
                        self.state = report
                    case DriveReport():
                        self.drive = report
                    case TickReport(measurement=used):
                        self.used.add((used.boost_voltage_V, used.output))

    async def ask(self, request: Request) -> None:
        """Have a request carried out, as soon as it is not refused."""
        await until(lambda: self._accepts(request))

    async def _accepts(self, request: Request) -> bool:
        try:
            await self.daemon.execute(request)
        except RefusedError:
            return False
        return True

    async def recovers(self) -> None:
        """Wait until nothing keeps the drive from being run."""
        await self.ask(Reset())

    async def run(self) -> None:
        """Enable the drive, from a trip too, and wait until it runs and does not coast."""
        while self.state is None or self.state.state is not State.RUNNING or self.state.coasting:
            await self.recovers()
            await self.ask(Enable())
            await self._accepts(SetSetpoint(self.setpoint))
            await asyncio.sleep(_TOLD_s)
            await until(lambda: self.state is not None and self.state.state not in _ON_THE_WAY)

    async def reaches(self, state: State) -> None:
        """Wait for a state."""
        await until(lambda: self.state is not None and self.state.state is state)

    def heard(self, kind: str, since_s: float = 0.0) -> list[str]:
        """What has been told of one kind since a time."""
        return [
            event.detail for when, event in self.events if event.kind == kind and when >= since_s
        ]


def reachable(configuration: Configuration) -> float:
    """A set-point that V_c can hold by the nominal model."""
    load, reach = configuration.load, machine_limits(configuration).reach
    return 0.5 * (max(load.reference_min, reach.low) + min(load.reference_max, reach.high))


@contextlib.asynccontextmanager
async def rigged(configuration: Configuration) -> AsyncIterator[Rig]:
    """Run a daemon until the block ends."""
    hub = Hub()
    reports = hub.subscribe(Event, StateReport, DriveReport, TickReport, size=100_000)
    clock = asyncio.get_running_loop().time
    port = build_port(configuration, clock, "rig.toml")
    daemon = Daemon(
        port=port,
        controller=Controller(controller_settings(configuration), build_load(configuration)),
        configuration=configuration,
        machine=machine_limits(configuration),
        fast=fast_settings(configuration),
        clock=clock,
        hub=hub,
        manager=ServiceManager({}),
    )
    rig, stop = Rig(daemon, port, reports, reachable(configuration)), asyncio.Event()
    async with contextlib.AsyncExitStack() as stack:
        patch = stack.enter_context(pytest.MonkeyPatch.context())
        if isinstance(asyncio.get_running_loop(), VirtualLoop):
            patch.setattr("adaptdrive.runtime.daemon.TickTimer", LoopTimer)
        tasks = await stack.enter_async_context(asyncio.TaskGroup())
        listening = tasks.create_task(rig.listen())
        serving = tasks.create_task(daemon.run(stop))
        try:
            yield rig
        finally:
            stop.set()
            await asyncio.wait([serving])
            listening.cancel()


async def until(
    condition: Callable[[], object], patience_s: float = PATIENCE_s, poll_s: float = 0.001
) -> float:
    """Wait for a condition, which may be awaited; the time at which it held."""
    async with asyncio.timeout(patience_s):
        while True:
            found = condition()
            if asyncio.iscoroutine(found):
                found = await found
            if found:
                return asyncio.get_running_loop().time()
            await asyncio.sleep(poll_s)
