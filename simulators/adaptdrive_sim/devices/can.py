"""The simulated drive and simulated sensors as nodes on a CAN bus.

At the end of each half line cycle, on an absolute grid that follows the line, it sends the status
messages that are due by their cycle times, the clocking one last; the pages of a multiplexed
message take turns. It obeys command frames whose length, checksum, alive counter, ranges and
constants are right, ignores and counts the others, and leaves what is not addressed to it alone. A
command that is spread over several frames is obeyed when the one with the bridge has come.
"""

import asyncio
import collections
import contextlib
import time
from collections.abc import Callable, Mapping

import can

from adaptdrive.config.bus import CanBus
from adaptdrive.config.root import CanSensorSection as Config
from adaptdrive.devices.can import assembly, connection, integrity
from adaptdrive.devices.can.bus import describe_bus, open_bus
from adaptdrive.devices.can.codec import MessageCodec
from adaptdrive.util.errors import BusError
from adaptdrive_sim.devices import frames, sensor_values
from adaptdrive_sim.devices.drive import Frame, Report, SimulatedDrive, run_half_cycles

# The simulated drive as a node on a CAN bus.

_REOPEN_S = 0.1
"""Interval at which a drive that has lost its bus tries to open it."""


class CanDrive:
    """One simulated drive on one bus.

    Attributes:
        counts: Frames sent, dropped, obeyed and refused, by name.
    """

    def __init__(
        self,
        drive: SimulatedDrive,
        config: CanBus,
        messages: frames.DriveMessages,
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
        self._bus: can.BusABC | None = None

    async def run(self, opened: Callable[[str], None]) -> None:
        """Open the bus, pass its description to `opened`, and serve it until cancelled.

        The drive outlives a bus that is lost, as a real one does, and opens it again.

        Raises:
            BusError: The bus cannot be opened at the first attempt.
        """
        self._bus = open_bus(self._config)
        try:
            opened(describe_bus(self._config))
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._hear(self._bus))
                tasks.create_task(
                    run_half_cycles(self._drive, self._clock, self._send, self._report)
                )
        finally:
            self._leave_bus()

    def take(self, frame: can.Message) -> None:
        """Obey a command frame that is whole and alive."""
        codec = self._codecs.get((frame.arbitration_id, frame.is_extended_id))
        if codec is None:
            return
        verdict, values, _ = codec.decode(bytes(frame.data))
        if verdict is not integrity.FrameVerdict.GOOD:
            self._refuse(verdict.value)
            return
        self._take_values(codec, values)

    def _take_values(self, codec: MessageCodec, values: Mapping[str, float]) -> None:
        orders = [order for order in self._orders if order.codec is codec]
        order = next((one for one in orders if one.fixed.items() <= values.items()), None)
        if order is None:
            self._refuse("wrong_constant")
            return
        heard = {
            part.name: (values[signal] - part.base) / part.factor
            for signal, part in order.parts.items()
        }
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
        while True:
            self._report("bus lost", problem=await connection.FrameReader(bus, self).run())
            self._leave_bus()
            bus = self._bus = await self._reopened()
            self._report("bus back")

    async def _reopened(self) -> can.BusABC:
        while True:
            await asyncio.sleep(_REOPEN_S)
            with contextlib.suppress(BusError):
                return open_bus(self._config)

    def _leave_bus(self) -> None:
        if self._bus is not None:
            self._bus.shutdown()
            self._bus = None

    def _send(self, frame: Frame) -> None:
        quantities, tick = frames.quantities_of(frame), frame.sample.tick
        for message in self._status:
            codec, number = message.codec, message.number(tick)
            if number == self._numbers.get(codec.name):
                continue
            self._numbers[codec.name] = number
            data, fast = message.encode(number, quantities), self._config.bitrate_switch
            out = codec.frame(data, bitrate_switch=fast)
            self.counts["sent" if self._put(out) else "dropped"] += 1

    def _put(self, frame: can.Message) -> bool:
        try:
            if self._bus is not None:
                self._bus.send(frame)
        except (can.CanError, OSError):
            return False
        return self._bus is not None


def _key(codec: MessageCodec) -> tuple[int, bool]:
    return codec.frame_id, codec.is_extended


# Simulated sensors on a CAN bus: every cycle they send what they measure on the drive's plant.


class CanSensors:
    """The sensors on one bus.

    Attributes:
        counts: Frames sent and dropped, by name.
    """

    def __init__(
        self, drive: SimulatedDrive, config: Config, messages: tuple[assembly.StatusFrame, ...]
    ) -> None:
        self.counts: collections.Counter[str] = collections.Counter()
        self._drive = drive
        self._config = config
        self._messages = messages
        self._frozen: dict[str, float] = {}

    async def run(self, opened: Callable[[str], None]) -> None:
        """Open the bus, pass its description to `opened`, and send until cancelled.

        Raises:
            BusError: The bus cannot be opened.
        """
        bus = open_bus(self._config)
        try:
            opened(describe_bus(self._config))
            while True:
                await asyncio.sleep(self._config.cycle_s)
                self._send_all(bus)
        finally:
            bus.shutdown()

    def _send_all(self, bus: can.BusABC) -> None:
        frame, fault = self._drive.frame, self._drive.world.sensor_fault
        if frame is None or fault == sensor_values.SensorFault.UNPLUGGED:
            return
        if fault != sensor_values.SensorFault.FROZEN:
            self._frozen = sensor_values.values_of(self._drive.world, frame)
        for message in self._messages:
            shown = self._shown(
                message, self._frozen, open_circuit=fault == sensor_values.SensorFault.OPEN
            )
            self._send(bus, message, shown)

    @staticmethod
    def _shown(
        message: assembly.StatusFrame, values: Mapping[str, float], *, open_circuit: bool
    ) -> dict[str, float | None]:
        return {
            one.field.name: None
            if open_circuit
            else (values[one.quantity] - one.offset) / one.scale
            for one in message.sources
        }

    def _send(
        self, bus: can.BusABC, message: assembly.StatusFrame, shown: Mapping[str, float | None]
    ) -> None:
        try:
            bus.send(message.codec.frame(message.codec.encode(shown)))
        except (can.CanError, OSError):
            self.counts["dropped"] += 1
        else:
            self.counts["sent"] += 1
