"""The daemon and the simulated hardware on real buses, in a time that waits for nobody.

Both ends run in one event loop whose clock moves only when there is nothing left to do: no callback
is ready, no byte has come, no reply is under way. Frames and registers go through the kernel as
ever; what an hour brings takes a minute. What does not show is how long a wire takes.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Coroutine
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from adaptdrive.app.loads import build_load
from adaptdrive.app.ports import build_whole_port, sensor_reports
from adaptdrive.app.settings import controller_settings, fast_settings, machine_limits
from adaptdrive.config import Configuration
from adaptdrive.control.controller import Controller
from adaptdrive.devices.can.bus import open_bus
from adaptdrive.runtime.daemon import Daemon
from adaptdrive.runtime.reports import Hub, LoadReport, Report, State, Subscription
from adaptdrive.runtime.requests import Enable
from adaptdrive.runtime.tick_support import ServiceManager
from adaptdrive_sim.device import KINDS, DeviceSettings, build_drive, build_sensors
from adaptdrive_sim.devices.can import CanDrive
from adaptdrive_sim.devices.drive import SimulatedDrive
from adaptdrive_sim.devices.modbus import ModbusDrive, serving
from adaptdrive_sim.devices.scpi import ScpiDrive
from adaptdrive_sim.world import World

WAIT_s = 2.0
LOOK_s = 0.5


async def _live(drive: SimulatedDrive, deliver: Any) -> None:
    """Half cycle after half cycle."""
    loop = asyncio.get_running_loop()
    deadline_s = loop.time()
    while True:
        deadline_s += drive.world.line.half_cycle_s
        await asyncio.sleep(deadline_s - loop.time())
        deliver(drive.tick(loop.time()))


class Reports:
    """The load reports of a daemon, one by one."""

    def __init__(self, subscription: Subscription) -> None:
        self._subscription = subscription
        self._waiting: list[Report] = []

    async def take_one(self) -> LoadReport:
        """The next one."""
        if not self._waiting:
            self._waiting += await self._subscription.take()
        report = self._waiting.pop(0)
        assert isinstance(report, LoadReport)
        return report


@dataclass
class Wire:
    """A daemon, and the drive at the other end of the wire."""

    daemon: Daemon
    world: World
    reports: Reports
    hub: Hub
    drive: SimulatedDrive

    @property
    def state(self) -> State:
        return self.daemon._machine.state

    async def until_running(self) -> None:
        """Enable the drive as soon as it may be."""
        await asyncio.sleep(WAIT_s)
        await self.daemon.execute(Enable())
        while self.state is not State.RUNNING:
            await asyncio.sleep(0.1)
            assert self.state is not State.TRIPPED, self.daemon._machine.trip

    async def period(self) -> LoadReport:
        """The next slow period."""
        report = None
        while report is None:
            assert self.state is State.RUNNING, self.daemon._machine.trip
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(LOOK_s):
                    report = await self.reports.take_one()
        return report


@contextlib.asynccontextmanager
async def wired(
    configuration: Configuration,
    settings: DeviceSettings,
    path: Path,
    described: Configuration | None = None,
) -> AsyncIterator[Wire]:
    """Run a plant and the daemon on the buses that a configuration names.

    Args:
        configuration: That of the daemon.
        settings: Those of the plant.
        path: The file, beside which relative paths are.
        described: The drive's own description, where it is another.
    """
    clock = asyncio.get_running_loop().time
    hub, stop = Hub(), asyncio.Event()
    reports = hub.subscribe(LoadReport, size=1000)
    drive = build_drive(configuration, settings, lambda *_, **__: None)
    port = build_whole_port(configuration, clock, path)
    _forget_real_time(port)
    daemon = Daemon(
        port=port,
        controller=Controller(controller_settings(configuration), build_load(configuration)),
        configuration=configuration,
        machine=machine_limits(configuration),
        fast=fast_settings(configuration),
        clock=clock,
        hub=hub,
        manager=ServiceManager({}),
        sensors=sensor_reports(port, clock),
    )
    async with contextlib.AsyncExitStack() as stack:
        hardware = [await _begin(stack, described or configuration, drive, path, clock)]
        tasks = await stack.enter_async_context(asyncio.TaskGroup())
        sensors = build_sensors(configuration, drive, path)
        hardware += [modules.run(lambda _: None) for modules in sensors]
        ends = [tasks.create_task(one) for one in hardware]
        await asyncio.sleep(0.1)
        running = tasks.create_task(daemon.run(stop))
        yield Wire(daemon, drive.world, Reports(reports), hub, drive)
        stop.set()
        await running
        for end in ends:
            end.cancel()


def _forget_real_time(port: Any) -> None:
    """How long a frame has really waited for the process says nothing in virtual time."""
    ends = [port, getattr(port, "_drive", None), *(bus.port for bus in getattr(port, "_buses", ()))]
    for end in ends:
        if hasattr(end, "_arrivals"):
            end._arrivals._wall_clock = end._arrivals._clock


async def _begin(
    stack: contextlib.AsyncExitStack,
    configuration: Configuration,
    drive: SimulatedDrive,
    path: Path,
    clock: Any,
) -> Coroutine[Any, Any, None]:
    """Put the drive on its bus; what keeps it alive."""
    node = KINDS[configuration.bus.type][0](drive, configuration, path)
    node._clock = clock
    if isinstance(node, ModbusDrive):
        await stack.enter_async_context(serving(node._config, {node._config.device_id: node}))
        return _live(drive, node.show)
    if isinstance(node, ScpiDrive):
        await stack.enter_async_context(node.serving())
        return _live(drive, node.show)
    assert isinstance(node, CanDrive)
    node._bus = bus = open_bus(node._config)
    stack.callback(node._leave_bus)

    async def both() -> None:
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(node._receive(bus))
            tasks.create_task(_live(drive, node._send))

    return both()
