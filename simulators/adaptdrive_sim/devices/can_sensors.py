"""Simulated sensors on a CAN bus: every cycle they send what they measure on the drive's plant."""

from __future__ import annotations

import asyncio
import collections
from collections.abc import Callable, Mapping

import can

from adaptdrive.config.sensors import CanSensorSection as Config
from adaptdrive.devices.can.bus import describe_bus, open_bus
from adaptdrive.devices.can.mapping import StatusFrame
from adaptdrive_sim.devices.drive import SimulatedDrive
from adaptdrive_sim.devices.sensor_values import SensorFault, values_of


class CanSensors:
    """The sensors on one bus.

    Attributes:
        counts: Frames sent and dropped, by name.
    """

    def __init__(
        self, drive: SimulatedDrive, config: Config, messages: tuple[StatusFrame, ...]
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
        if frame is None or fault == SensorFault.UNPLUGGED:
            return
        if fault != SensorFault.FROZEN:
            self._frozen = values_of(self._drive.world, frame)
        for message in self._messages:
            shown = self._shown(message, self._frozen, open_circuit=fault == SensorFault.OPEN)
            self._send(bus, message, shown)

    @staticmethod
    def _shown(
        message: StatusFrame, values: Mapping[str, float], *, open_circuit: bool
    ) -> dict[str, float | None]:
        return {
            one.signal: None if open_circuit else (values[one.quantity] - one.offset) / one.scale
            for one in message.sources
        }

    def _send(
        self, bus: can.BusABC, message: StatusFrame, shown: Mapping[str, float | None]
    ) -> None:
        try:
            bus.send(message.codec.frame(message.codec.encode(shown)))
        except (can.CanError, OSError):
            self.counts["dropped"] += 1
        else:
            self.counts["sent"] += 1
