"""The simulated drive as a node on a CAN bus.

Each half line cycle, on an absolute grid that follows the line, it sends its status messages, the
clocking one last. It obeys command frames whose length, checksum, alive counter and ranges are
right, ignores and counts the others, and leaves what is not addressed to it alone.
"""

from __future__ import annotations

import asyncio
import collections
import functools
import time
from collections.abc import Callable

import can

from adaptdrive.config.bus import CanBus
from adaptdrive.errors import BusError
from adaptdrive.hardware.can.bus import describe_bus, open_bus
from adaptdrive.hardware.can.integrity import Verdict
from adaptdrive.hardware.can.reader import read_frames
from adaptdrive_sim.devices.drive import Drive, Frame, Report
from adaptdrive_sim.devices.frames import DriveMessages, quantities_of
from adaptdrive_sim.devices.pacing import run_half_cycles


class CanDrive:
    """One simulated drive on one bus.

    Attributes:
        counts: Frames sent, dropped, obeyed and refused, by name.
    """

    def __init__(
        self,
        drive: Drive,
        config: CanBus,
        messages: DriveMessages,
        report: Report,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.counts: collections.Counter[str] = collections.Counter()
        self._drive = drive
        self._config = config
        self._status = messages.status
        self._command = messages.command
        self._report = report
        self._clock = clock

    async def run(self, opened: Callable[[str], None]) -> None:
        """Open the bus, tell `opened` which one it is, and serve it until cancelled.

        Raises:
            BusError: The bus cannot be opened, or is lost.
        """
        bus = open_bus(self._config)
        try:
            opened(describe_bus(self._config))
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._hear(bus))
                tasks.create_task(self._live(bus))
        finally:
            bus.shutdown()

    def take(self, frame: can.Message) -> None:
        """Obey a command frame that is whole and alive."""
        codec = self._command.codec
        if (frame.arbitration_id, frame.is_extended_id) != (codec.frame_id, codec.is_extended):
            return
        decoded = codec.decode(bytes(frame.data))
        if decoded.verdict is not Verdict.GOOD:
            self._refuse(decoded.verdict.value)
            return
        self.counts["obeyed"] += 1
        value = decoded.values[self._command.value]
        bridge = bool(decoded.values[self._command.bridge])
        obey = self._drive.hold if self._drive.holds_voltage else self._drive.command
        obey(value, bridge, self._clock())

    def take_garbage(self) -> None:
        """Count what is no frame."""
        self._refuse("garbage")

    def _refuse(self, reason: str) -> None:
        """Count a refusal, and report the first of its kind: a flood must not fill the log."""
        self.counts[reason] += 1
        if self.counts[reason] == 1:
            self._report("command refused", reason=reason)

    async def _hear(self, bus: can.BusABC) -> None:
        raise BusError(describe_bus(self._config), await read_frames(bus, self))

    async def _live(self, bus: can.BusABC) -> None:
        deliver = functools.partial(self._send, bus)
        await run_half_cycles(self._drive, self._clock, deliver, self._report)

    def _send(self, bus: can.BusABC, frame: Frame) -> None:
        quantities = quantities_of(frame)
        for message in self._status:
            codec = message.codec
            data = message.encode(quantities)
            out = can.Message(
                arbitration_id=codec.frame_id, is_extended_id=codec.is_extended, data=data
            )
            try:
                bus.send(out)
            except (can.CanError, OSError):
                self.counts["dropped"] += 1
            else:
                self.counts["sent"] += 1
