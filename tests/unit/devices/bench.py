"""A bench for the CAN port: a drive made of cantools and crccheck, and an ear for what comes out.

Nothing here uses the codecs of the port, so that what they agree on is agreed with a stranger.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from pathlib import Path

import can
import cantools
import pytest
from cantools.database.can.database import Database
from crccheck.crc import Crc8SaeJ1850

from adaptdrive.config import load_configuration
from adaptdrive.config.bus import CanBus, Signals
from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.devices.bus import backoff_s
from adaptdrive.devices.can import port as can_port
from adaptdrive.devices.can.mapping import map_drive
from adaptdrive.devices.port import Port
from adaptdrive.safety.facts import Reading
from adaptdrive.safety.timing import Timing

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"
MOTOR = load_configuration(EXAMPLES / "motor.toml")
assert isinstance(MOTOR.bus, CanBus)
MOTOR_BUS = MOTOR.bus
PATIENCE_S = 120.0
TIMING = Timing(
    half_cycle_s=1.0 / 120.0, stale_s=0.05, voltage_parts=frozenset({"boost_voltage_V"})
)

STATUS = {"BoostVoltage": 300.12, "LineVoltage": 120.4, "LoadPower": 431.7, "BridgeOn": 1}
LOAD = {"Tachometer": 3.123456, "LoadCurrent": 5.76}
_PROOFS = {
    "DriveStatus": ("StatusAlive", "StatusCrc"),
    "DriveLoad": ("LoadAlive", "LoadCrc"),
    "DriveCommand": ("CommandAlive", "CommandCrc"),
}


def reference_database() -> Database:
    """The reference DBC, as cantools reads it."""
    database = cantools.database.load_file(EXAMPLES / "adaptdrive.dbc")
    assert isinstance(database, Database)
    return database


def odd_database(signals: str) -> Database:
    """A DBC with one message of eight bytes, `Odd`, and these signals."""
    text = f'VERSION ""\n\nBO_ 291 Odd: 8 Vector__XXX\n{signals}\n'
    database = cantools.database.load_string(text, database_format="dbc")
    assert isinstance(database, Database)
    return database


def memory_bus(**changes: object) -> CanBus:
    """`[bus]` of the example in this process, changed."""
    return motor_bus(**{"interface": "virtual", "channel": "motor", **changes})


def motor_bus(**changes: object) -> CanBus:
    """`[bus]` of the example, changed."""
    return MOTOR_BUS.model_copy(update=changes)


def motor_signals(**changes: object) -> Signals:
    """`[signals]` of the example, changed."""
    found = {**dict(MOTOR.signals), **changes}
    return Signals.model_validate({name: one for name, one in found.items() if one is not None})


def with_crc(data: bytes) -> bytes:
    """A frame of the reference DBC with its last byte set to the right checksum."""
    return data[:-1] + bytes((Crc8SaeJ1850.calc(data[:-1]),))


def noted_delays(module: str, monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Return a list that grows by each delay before a bus of a module is opened again."""
    delays_s: list[float] = []

    def noted(received: Callable[[], int]) -> Iterator[float]:
        for delay_s in backoff_s(received):
            delays_s.append(delay_s)
            yield delay_s

    monkeypatch.setattr(f"{module}.backoff_s", noted)
    return delays_s


class Drive:
    """Sends frames of the reference DBC on any python-can bus."""

    def __init__(self, bus: can.BusABC, database: Database | None = None) -> None:
        self.bus = bus
        self.alive = dict.fromkeys(_PROOFS, 0)
        self.half_cycle = 0
        self._database = database or reference_database()

    def frame(self, name: str, **values: float) -> bytes:
        """The next frame of a message; unnamed signals are 0."""
        message = self._database.get_message_by_name(name)
        counter, checksum = _PROOFS[name]
        every = dict.fromkeys((signal.name for signal in message.signals), 0.0)
        every |= values | {counter: self.alive[name], checksum: 0}
        self.alive[name] = (self.alive[name] + 1) % 16
        return with_crc(message.encode(every))

    def put(self, name: str, data: bytes) -> None:
        """Send bytes under the id of a message."""
        frame_id = self._database.get_message_by_name(name).frame_id
        self.bus.send(can.Message(arbitration_id=frame_id, is_extended_id=False, data=data))

    def send_status(self, **changes: float) -> None:
        """Send a good DriveStatus."""
        self.put("DriveStatus", self.frame("DriveStatus", **(STATUS | changes)))

    def send_load(self, **changes: float) -> None:
        """Send a good DriveLoad, one half cycle after the last."""
        values = LOAD | {"HalfCycle": self.half_cycle} | changes
        self.half_cycle = (self.half_cycle + 1) % 65536
        self.put("DriveLoad", self.frame("DriveLoad", **values))

    def send_both(self) -> None:
        """Send what a drive sends each half cycle."""
        self.send_status()
        self.send_load()

    async def reports(self, ear: Ear, **status: float) -> None:
        """Send what a drive sends each half cycle, and wait for the reading of it."""
        known = len(ear.readings)
        self.send_status(**status)
        self.send_load()
        await ear.hears(known + 1)


class Ear:
    """Listens to a port, and answers each reading.

    Attributes:
        port: Where the answer goes, None for nowhere.
        command: The answer, None for none.
        fails: Whether it fails at the next reading.
    """

    def __init__(self) -> None:
        self.readings: list[Reading] = []
        self.bus: list[tuple[bool, str]] = []
        self.port: Port | None = None
        self.command: Command | None = SAFE_COMMAND
        self.fails = False

    def on_reading(self, reading: Reading) -> None:
        self.readings.append(reading)
        if self.fails:
            raise ZeroDivisionError
        if self.port is not None and self.command is not None:
            self.port.send(self.command)

    def on_bus(self, up: bool, detail: str) -> None:
        self.bus.append((up, detail))

    async def hears(self, count: int) -> None:
        """Wait until there have been that many readings."""
        await until(lambda: len(self.readings) >= count)


class SensorEar:
    """Listens to sensors: values, when they were taken, and when they came."""

    def __init__(self) -> None:
        self.heard: list[tuple[dict[str, float], float, float]] = []
        self.bus: list[tuple[bool, str]] = []

    def on_values(self, values: Mapping[str, float], taken_s: float) -> None:
        self.heard.append((dict(values), taken_s, asyncio.get_running_loop().time()))

    def on_bus(self, up: bool, detail: str) -> None:
        self.bus.append((up, detail))

    @property
    def latest(self) -> dict[str, float]:
        return self.heard[-1][0]

    async def hears(self, more: int) -> None:
        """Wait for that many more samples."""
        count = len(self.heard) + more
        await until(lambda: len(self.heard) >= count)


class Clock:
    """A clock that a test sets."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


def rewritten(folder: Path, *changes: tuple[str, str], bus: CanBus = MOTOR_BUS) -> CanBus:
    """A bus of the example, with a DBC in which some words are others."""
    text = (EXAMPLES / "adaptdrive.dbc").read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    database = folder / "rewritten.dbc"
    database.write_text(text, encoding="utf-8")
    return bus.model_copy(update={"database": [database]})


def build_port(
    config: CanBus,
    clock: Callable[[], float] | None = None,
    timing: Timing = TIMING,
    **signals: object,
) -> can_port.Port:
    """A port, by the clock of the loop or of the test; a frame that is read has not waited."""
    mapping = map_drive(config, motor_signals(**signals), timing)
    clock = clock or asyncio.get_running_loop().time
    return can_port.Port(config, mapping, clock, clock)


@contextlib.asynccontextmanager
async def running(port: can_port.Port, ear: Ear) -> AsyncIterator[None]:
    """Run a port until the block ends."""
    opened = asyncio.Event()
    async with asyncio.TaskGroup() as tasks:
        task = tasks.create_task(port.run(ear, opened.set))
        await until(lambda: opened.is_set() or task.done())
        yield
        task.cancel()


async def until(condition: Callable[[], bool]) -> None:
    """Wait for a condition; give up after a time that only a broken port needs."""
    async with asyncio.timeout(PATIENCE_S):
        while not condition():  # noqa: ASYNC110 - what is waited for is no event
            await asyncio.sleep(0.002)
