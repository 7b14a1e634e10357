"""What a test of the port contract sees of a port and of the drive behind it, whatever the bus.

A rig runs in virtual time: its drive reports by itself, as one of its kind does, and its ear
answers each reading with `ear.command`. To have another bus hold the contract, derive from `Rig`
and name the class in `conftest.py`.
"""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Callable
from itertools import pairwise
from typing import Self

from adaptdrive.control.signals import Command
from adaptdrive.devices.port import Port
from adaptdrive.safety.facts import Reading
from tests.unit.devices.bench import Ear, until

CHARGE = Command(current_scale_S=0.0, boost_reference_V=250.0, bridge=False)
RUN = Command(current_scale_S=0.0, boost_reference_V=287.65, bridge=True)


class Rig(ABC):
    """A port, the ear that listens to it, and its drive.

    Attributes:
        voltage_V: Boost voltage that the drive measures.
        cycle_s: Longest time between two readings.
        watched: Whether the drive has a watchdog of its own, which `fed_s` tells of.
        starved_s: Longest silence in which a drive is left that does not obey, at least.
        outlives_loss: Whether a drive that stayed on while its bus was lost is driven on.
        keeps_newest: Whether the newest command is written again once the drive has been read.
        heard: Bridge and voltage of each command that the drive has heard, one after the other.
        fed_s: When something came that keeps the drive's watchdog from ending.
        obeys: Whether the drive follows the commands that it hears.
        bridge: Whether it reports its bridge on.
        silent: Whether it says nothing.
        spoilt: Whether it sends a voltage that must not be used.
        refuses: Whether commands are not taken.
    """

    voltage_V = 300.12
    cycle_s = 1.0 / 120.0
    watched = True
    starved_s = 0.9
    outlives_loss = True
    keeps_newest = False

    def __init__(self, port: Port, ear: Ear) -> None:
        self.port, self.ear = port, ear
        ear.port, ear.command = port, None
        self.heard: list[tuple[bool, float]] = []
        self.fed_s: list[float] = []
        self.obeys = True
        self.bridge = self.silent = self.spoilt = self.refuses = False
        self.task: asyncio.Task[None] | None = None

    @abstractmethod
    def show_fault(self) -> None:
        """Have the drive show a fault in its next report alone."""

    @abstractmethod
    async def lose(self) -> None:
        """Take the bus away; what the drive reports stays as it is."""

    @abstractmethod
    async def restore(self) -> None:
        """Bring the bus back."""

    @abstractmethod
    async def begin(self) -> None:
        """Put the drive on the bus."""

    @abstractmethod
    async def end(self) -> None:
        """Take it off the bus."""

    async def __aenter__(self) -> Self:
        await self.begin()
        self.task = asyncio.create_task(self.port.run(self.ear, lambda: None))
        await self.hears(1)
        return self

    async def __aexit__(self, *_: object) -> None:
        assert self.task is not None
        self.task.cancel()
        await asyncio.gather(self.task, return_exceptions=True)
        await self.end()

    @property
    def now_s(self) -> float:
        return asyncio.get_running_loop().time()

    @property
    def latest(self) -> Reading:
        return self.ear.readings[-1]

    def hear(self, *, bridge: bool, voltage_V: float) -> None:
        """Note a command at the drive."""
        self.heard.append((bridge, voltage_V))
        if self.obeys:
            self.bridge = bridge

    def feed(self) -> None:
        """Note something at the drive that its watchdog waits for."""
        self.fed_s.append(self.now_s)

    async def hears(self, more: int) -> None:
        """Wait for that many more readings."""
        await self.ear.hears(len(self.ear.readings) + more)

    async def passes(self, cycles: float) -> None:
        """Let the time of so many readings pass."""
        await asyncio.sleep(cycles * self.cycle_s)

    async def runs(self) -> None:
        """Bring the drive to where its bridge is on."""
        self.ear.command = CHARGE
        await self.hears(6)
        self.ear.command = RUN
        await until(lambda: self.latest.bridge)

    async def is_lost(self) -> None:
        """Take the bus away, and wait until the port has said so."""
        await self.lose()
        await until(lambda: self.ear.bus[-1:] != [] and not self.ear.bus[-1][0])

    async def is_back(self) -> None:
        """Bring the bus back, and wait until the port has said so."""
        await self.restore()
        await until(lambda: self.ear.bus[-1][0])

    async def hungry_s(self, during_s: float) -> float:
        """Longest time without food for the drive's watchdog, from now on."""
        begin_s = self.now_s
        await asyncio.sleep(during_s)
        fed_s = [begin_s, *(one for one in self.fed_s if one > begin_s), self.now_s]
        return max(later - earlier for earlier, later in pairwise(fed_s))


Build = Callable[[float], Rig]
"""Makes a rig whose drive has so long to stop, `interlocks.stop_s`, in s."""
