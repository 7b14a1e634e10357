"""The simulated drive as a node on a CAN bus.

At the end of each half line cycle, on an absolute grid that follows the line, it sends the status
messages that are due by their cycle times, the clocking one last; the pages of a multiplexed
message take turns. It obeys command frames whose length, checksum, alive counter, ranges and
constants are right, ignores and counts the others, and leaves what is not addressed to it alone. A
command that is spread over several frames is obeyed when the one with the bridge has come.
"""

from __future__ import annotations

import asyncio
import collections
import functools
import time
from collections.abc import Callable, Mapping

import can

from adaptdrive.config.bus import CanBus
from adaptdrive.errors import BusError
from adaptdrive.hardware.can.bus import describe_bus, open_bus
from adaptdrive.hardware.can.codec import MessageCodec
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
        self._orders = messages.orders
        self._codecs = {_key(codec): codec for codec in messages.codecs}
        self._wanted: dict[str, float] = {}
        self._numbers: dict[str, int] = {}
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
        codec = self._codecs.get((frame.arbitration_id, frame.is_extended_id))
        if codec is None:
            return
        decoded = codec.decode(bytes(frame.data))
        if decoded.verdict is not Verdict.GOOD:
            self._refuse(decoded.verdict.value)
            return
        self._take_values(codec, decoded.values)

    def _take_values(self, codec: MessageCodec, values: Mapping[str, float]) -> None:
        orders = [order for order in self._orders if order.codec is codec]
        order = next((one for one in orders if one.fixed.items() <= values.items()), None)
        if order is None:
            self._refuse("wrong_constant")
            return
        heard = {part.field: part.field_value(values[part.signal]) for part in order.parts}
        self._wanted |= heard
        if "bridge" in heard:
            self._obey()

    def _obey(self) -> None:
        self.counts["obeyed"] += 1
        wanted, now_s = self._wanted, self._clock()
        bridge = bool(wanted["bridge"])
        if self._drive.holds_voltage:
            self._drive.hold(wanted.get("boost_reference_V", 0.0), bridge, now_s)
        else:
            self._drive.command(wanted.get("current_scale_S", 0.0), bridge, now_s)

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
        quantities, tick = quantities_of(frame), frame.sample.tick
        for message in self._status:
            codec, number = message.codec, message.number(tick)
            if number == self._numbers.get(codec.name):
                continue
            self._numbers[codec.name] = number
            out = can.Message(
                arbitration_id=codec.frame_id,
                is_extended_id=codec.is_extended,
                is_fd=codec.is_fd,
                bitrate_switch=codec.is_fd and self._config.bitrate_switch,
                data=message.encode(number, quantities),
            )
            try:
                bus.send(out)
            except (can.CanError, OSError):
                self.counts["dropped"] += 1
            else:
                self.counts["sent"] += 1


def _key(codec: MessageCodec) -> tuple[int, bool]:
    return codec.frame_id, codec.is_extended
