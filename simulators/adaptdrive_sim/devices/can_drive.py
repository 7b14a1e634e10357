"""The simulated drive as a node on a CAN bus.

Each half line cycle, on an absolute grid that follows the line, it sends its status messages, the
clocking one last. It obeys command frames whose length, checksum, alive counter and ranges are
right, ignores and counts the others, and leaves what is not addressed to it alone.
"""

from __future__ import annotations

import asyncio
import collections
import contextlib
import time
from collections.abc import Callable, Iterator

import can

from adaptdrive.config.bus import CanBus
from adaptdrive.errors import BusError
from adaptdrive.hardware.can.bus import describe_bus, open_bus
from adaptdrive.hardware.can.integrity import Verdict
from adaptdrive.hardware.can.reader import read_frames
from adaptdrive.runtime.tick_timer import TickTimer
from adaptdrive_sim.devices.drive import Drive, Frame, Report
from adaptdrive_sim.devices.frames import DriveMessages, quantities_of

STALL_s = 1.0
"""A process that slept longer than this (a suspended machine) starts a new grid."""


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
        scale_S = decoded.values[self._command.current_scale]
        bridge = bool(decoded.values[self._command.bridge])
        self._drive.command(scale_S, bridge, self._clock())

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
        """Run one half cycle after the other."""
        expired = asyncio.Event()
        deadline_s = self._clock() + self._drive.world.line.half_cycle_s
        with _timer(expired) as timer:
            while True:
                timer.arm(deadline_s)
                await expired.wait()
                expired.clear()
                deadline_s = self._catch_up(bus, deadline_s)

    def _catch_up(self, bus: can.BusABC, deadline_s: float) -> float:
        """Run every half cycle that has passed and send the last one; the next deadline."""
        frame: Frame | None = None
        now_s = self._clock()
        if now_s - deadline_s > STALL_s:
            self._report("stalled", seconds=round(now_s - deadline_s, 3))
            deadline_s = now_s
        while deadline_s <= now_s:
            frame = self._drive.tick(now_s)
            deadline_s += frame.sample.tick_period_s
        if frame is not None:
            self._send(bus, frame)
        return deadline_s

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


@contextlib.contextmanager
def _timer(expired: asyncio.Event) -> Iterator[TickTimer]:
    timer = TickTimer(asyncio.get_running_loop(), lambda _: expired.set())
    try:
        yield timer
    finally:
        timer.close()
