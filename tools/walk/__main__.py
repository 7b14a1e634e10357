"""Which files does one sample pass? `python -m tools.walk [--files]`.

The daemon of the motor example runs in front of a simulated drive, in virtual time. Five walks are
traced through the running program: one tick from the frames of the drive to the command, one
ordinary slow period, one set-point from the message of the broker to the reply, and one estimate
from the decision to the table of its session, and one from a bit of the drive's fault word to the
latched trip. For each one the calls, the functions and the files of the product are counted, and
how often the walk returns to a file that it had left.

The broker of the third walk is in memory, without the client of the MQTT library. The fourth takes
the ticks of the same 0.25 s with it, and ends in the archiver, which is another process in the
field.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import json
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from adaptdrive.config.services import Mqtt
from adaptdrive.control.controller import Controller
from adaptdrive.control.signals import Mode
from adaptdrive.devices.can.connection import FrameReader
from adaptdrive.mqtt.contract import Profile
from adaptdrive.mqtt.service import MqttService, OperatorLog
from adaptdrive.recording.recorder import Recorder
from adaptdrive.recording.records import Header
from adaptdrive.runtime.requests import SetMode, SetSetpoint
from tests.integration.closed_loop.test_same_on_every_bus import COURSES, configured
from tests.integration.closed_loop.wire import Wire, wired
from tests.support import captured_lines
from tests.unit.mqtt.memory_broker import MemoryBroker
from tests.unit.mqtt.peers import listening
from tests.unit.recording import disk
from tests.unit.recording.material import INFO
from tests.virtual_time import virtual_time

SOURCE = str(Path(__file__).parents[2] / "src" / "adaptdrive") + "/"
SETTLED_S = 60.0
EPOCH_S = 1.8e9
_LATCH = "runtime/state_machine.py", "Machine.latch"


@dataclass
class Walk:
    """What one walk passed, in the order of the calls."""

    functions: list[tuple[str, str]] = field(default_factory=list)

    def note(self, frame: FrameType, event: str, _: object) -> None:
        """Take a call of a function of the product."""
        name = frame.f_code.co_filename
        if event == "call" and name.startswith(SOURCE) and not frame.f_code.co_name.startswith("<"):
            self.functions.append((name.removeprefix(SOURCE), frame.f_code.co_qualname))

    @property
    def files(self) -> list[str]:
        """The files in the order in which they are met first."""
        return list(dict.fromkeys(file for file, _ in self.functions))

    @property
    def returns(self) -> int:
        """How often a file is met again that had been left."""
        way = [file for file, _ in self.functions]
        entered = [file for before, file in zip(["", *way], way, strict=False) if file != before]
        return len(entered) - len(self.files)

    def line(self, name: str) -> str:
        """Return the row of the table."""
        counts = (len(self.functions), len(set(self.functions)), len(self.files), self.returns)
        return f"{name:18}" + "".join(f"{count:>11}" for count in counts)


@contextlib.contextmanager
def traced(walk: Walk) -> Iterator[None]:
    """Trace what runs meanwhile, but what has a walk of its own."""
    before = sys.getprofile()
    sys.setprofile(walk.note)
    try:
        yield
    finally:
        sys.setprofile(before)


@contextlib.contextmanager
def each_traced(owner: object, name: str, walks: list[Walk]) -> Iterator[None]:
    """Trace each call of a function into a walk of its own."""
    call: Callable[..., Any] = getattr(owner, name)

    def followed(*words: Any, **named: Any) -> Any:
        walks.append(Walk())
        with traced(walks[-1]):
            return call(*words, **named)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(owner, name, followed)
        yield


async def follow(folder: Path) -> dict[str, Walk]:
    """Run the daemon until its adaptive controller holds a set-point, and return its walks."""
    gc.disable()  # a collection calls the product's watch over it
    configuration, path = configured("motor", folder)
    ticks: list[Walk] = []
    periods: list[Walk] = []
    with each_traced(FrameReader, "drain", ticks), each_traced(Controller, "decide", periods):
        async with wired(configuration, COURSES["motor"].settings, path) as wire:
            await wire.until_running()
            await wire.daemon.execute(SetSetpoint(3.0))
            await wire.daemon.execute(SetMode(Mode.ADAPTIVE))
            await asyncio.sleep(SETTLED_S)
            sent = [walk for walk in ticks[-100:] if "safety/guard.py" in walk.files]
            settled = periods[-20:]
            return {
                "tick": _median(sent),
                "slow period": _median(settled),
                "set-point": _median(await _setpoints(wire)),
                "estimate to disk": await _estimate(wire, folder),
                "fault to trip": await _trip(wire, ticks),
            }


async def _setpoints(wire: Wire) -> list[Walk]:
    """Send set-points through a broker, and wait for the reply to each."""
    walks, broker = [Walk() for _ in range(20)], MemoryBroker()
    service = MqttService(Profile("motor"), Mqtt(), wire.daemon, wire.hub, OperatorLog())
    with broker.joined(), captured_lines():
        serving = asyncio.create_task(service.run())
        await asyncio.sleep(1.0)
        async with listening(broker, "adaptdrive/motor/reply") as ear:
            for number, walk in enumerate(walks):
                command = json.dumps({"id": str(number), "value": 3.0 + 0.01 * number})
                with traced(walk):
                    broker.publish("adaptdrive/motor/command/setpoint", command.encode())
                    await ear.on("adaptdrive/motor/reply")
                await asyncio.sleep(0.1)
        serving.cancel()
        await asyncio.wait([serving])
    return walks


async def _estimate(wire: Wire, folder: Path) -> Walk:
    """Record one decision, end the session, and write its tables."""
    loop, walk, archived = asyncio.get_running_loop(), Walk(), list[Walk]()
    with pytest.MonkeyPatch.context() as patch:
        disk.Disk(patch)
        disk.archive_in_process(patch)
        folders = folder / "motor.log", folder / "sessions"
        clock = lambda: (loop.time(), EPOCH_S + loop.time())  # noqa: E731
        recorder = Recorder(*folders, Header(INFO, ""), wire.hub, clock)
        recording = asyncio.create_task(recorder.run())
        await asyncio.sleep(1.0)
        report = await wire.period()
        with traced(walk):
            wire.daemon.decided(report.snapshot, report.decision)
            await recorder._gather()
        with each_traced(disk, "archive", archived):
            recording.cancel()
            await asyncio.wait([recording])
    walk.functions += archived[-1].functions
    return walk


async def _trip(wire: Wire, ticks: list[Walk]) -> Walk:
    """Let the drive report a fault; return the tick that latches the trip for it."""
    wire.drive.inject(2)
    await asyncio.sleep(1.0)
    tick = next(walk for walk in reversed(ticks) if _LATCH in walk.functions)
    return Walk(tick.functions[: tick.functions.index(_LATCH) + 1])


def _median(walks: list[Walk]) -> Walk:
    return sorted(walks, key=lambda walk: len(walk.functions))[len(walks) // 2]


def main() -> None:
    """Print the walks as a table, and their files where these are asked for."""
    with tempfile.TemporaryDirectory(prefix="walk-") as folder, virtual_time() as runner:
        walks = runner.run(follow(Path(folder)))
    heads = ("calls", "functions", "files", "returns")
    lines = [f"{'':18}" + "".join(f"{head:>11}" for head in heads)]
    lines += [walk.line(name) for name, walk in walks.items()]
    if "--files" in sys.argv:
        lines += ["\n  ".join([f"\n{name}:", *walk.files]) for name, walk in walks.items()]
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
