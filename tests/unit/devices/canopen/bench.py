"""The port of a CiA 402 drive, an ear on it, and a node of the canopen library before it."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable

from adaptdrive.app.ports import build_port
from adaptdrive.control.signals import Command
from adaptdrive.devices.canopen import port as canopen_port
from tests.unit.devices import bench as hardware
from tests.unit.devices.bench import until
from tests.unit.devices.canopen.documents import parse
from tests.unit.devices.canopen.peer import Peer

HALF_CYCLE_S = 1.0 / 120.0
CHARGE = Command(current_scale_S=0.0, boost_reference_V=250.0, bridge=False)
RUN = Command(current_scale_S=0.0, boost_reference_V=300.0, bridge=True)


class Ear(hardware.Ear):
    """Listens to a port and answers each reading.

    Attributes:
        lost: Called once, when the loop is next free after the node was lost.
    """

    def __init__(self) -> None:
        super().__init__()
        self.lost: Callable[[], object] | None = None

    def on_bus(self, up: bool, detail: str) -> None:
        super().on_bus(up, detail)
        if not up and self.lost is not None:
            asyncio.get_running_loop().call_soon(self.lost)
            self.lost = None


class Bench:
    """A port, an ear and a node."""

    def __init__(self, peer: Peer, stop_s: float = 0.5, **bus: object) -> None:
        configuration = parse({"interlocks/stop_s": stop_s})
        config = peer.config.model_copy(update=bus)
        self.peer = peer
        self.ear = Ear()
        changed = configuration.model_copy(update={"bus": config})
        port = build_port(changed, asyncio.get_running_loop().time, "bench.toml")
        assert isinstance(port, canopen_port.Port)
        self.port = port
        self.ear.port = self.port

    async def ready(self) -> None:
        """Wait until readings come."""
        count = len(self.ear.readings)
        await until(lambda: len(self.ear.readings) > count + 2)

    async def run_drive(self) -> None:
        """Bring the drive to enabled operation."""
        await self.ready()
        self.ear.command = CHARGE
        await until(lambda: self.peer.words[-1:] == [0x07])
        self.ear.command = RUN
        await until(lambda: bool(self.ear.readings) and self.ear.readings[-1].bridge)

    async def complains(self, text: str) -> str:
        """Wait for a cause to trip."""
        await until(lambda: text in str(self.port.trip_cause))
        return "" if self.port.trip_cause is None else self.port.trip_cause.text

    async def reports(self, text: str) -> None:
        """Wait for the report that the node is lost, or cannot be set up."""
        await until(lambda: any(text in detail for up, detail in self.ear.bus if not up))


@contextlib.asynccontextmanager
async def running(peer: Peer, stop_s: float = 0.5, **bus: object) -> AsyncIterator[Bench]:
    """A bench whose port runs until the block ends."""
    bench = Bench(peer, stop_s, **{"heartbeat_timeout_s": 2.0, "sdo_timeout_s": 10.0, **bus})
    async with asyncio.TaskGroup() as tasks:
        task = tasks.create_task(bench.port.run(bench.ear, lambda: None))
        yield bench
        task.cancel()


@contextlib.asynccontextmanager
async def ready(peer: Peer, stop_s: float = 0.5, **bus: object) -> AsyncIterator[Bench]:
    """A bench whose readings come."""
    async with running(peer, stop_s, **bus) as bench:
        await bench.ready()
        yield bench


@contextlib.asynccontextmanager
async def driven(peer: Peer, stop_s: float = 0.5, **bus: object) -> AsyncIterator[Bench]:
    """A bench whose drive is in enabled operation."""
    async with running(peer, stop_s, **bus) as bench:
        await bench.run_drive()
        yield bench
