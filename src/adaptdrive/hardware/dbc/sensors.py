"""Sensors on a CAN bus: messages as a DBC describes them.

Each good frame hands out its values, as old as its arrival; one that fails a check changes nothing
and is counted. Nothing is sent but requests for messages that come only when asked.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from pathlib import Path

import can

from adaptdrive.config.sensors import CanSensorSection as Config
from adaptdrive.errors import ConfigurationError
from adaptdrive.hardware.binding import sensor_entries
from adaptdrive.hardware.counting import CountingPort
from adaptdrive.hardware.dbc.database import open_catalogue
from adaptdrive.hardware.dbc.mapping import CanSource, StatusFrame, status_frame
from adaptdrive.hardware.demands import NO_DEMANDS, Demands
from adaptdrive.hardware.link.arrival import ArrivalClock
from adaptdrive.hardware.link.bus import describe_bus, requests
from adaptdrive.hardware.link.codec import frame_key
from adaptdrive.hardware.link.connection import CanConnection
from adaptdrive.hardware.link.integrity import FrameVerdict
from adaptdrive.hardware.port import SensorListener


def build_can_sensors(
    bus: Config,
    place: str,
    clock: Callable[[], float],
    source: Path | str = "configuration",
    demands: Demands = NO_DEMANDS,
) -> CanSensorPort:
    """Build the port of one sensor bus; nothing is opened yet.

    Args:
        bus: One entry of `[[sensor_bus]]`.
        place: Where it stands in the configuration.
        clock: Monotonic clock, in seconds.
        source: The configuration, for error messages.
        demands: What the signals must be able to carry.

    Raises:
        ConfigurationError: Configuration and DBC do not fit; every flaw is listed.
    """
    return CanSensorPort(bus, map_sensors(bus, place, source, demands), clock)


def map_sensors(
    bus: Config, place: str, source: Path | str, demands: Demands = NO_DEMANDS
) -> tuple[StatusFrame, ...]:
    """Find every configured signal in the DBC.

    Args:
        bus: One entry of `[[sensor_bus]]`.
        place: Where it stands in the configuration.
        source: The configuration, for error messages.
        demands: What the signals must be able to carry.

    Raises:
        ConfigurationError: Something does not fit; every flaw is listed.
    """
    catalogue = open_catalogue(bus, source, place)
    found: dict[str, list[CanSource]] = {}
    for one in catalogue.sources(sensor_entries(bus, place), demands):
        message, signal = one.item
        value = CanSource(one.quantity, signal.name, one.scale, one.offset)
        found.setdefault(message.name, []).append(value)
    catalogue.check_uses({f"{place}.signals": found})
    if catalogue.flaws:
        raise ConfigurationError(source, catalogue.flaws)
    return tuple(status_frame(catalogue, bus, *item, bus.cycle_s) for item in found.items())


class CanSensorPort(CountingPort):
    """One connection to the sensors on one CAN bus.

    Attributes:
        description: The bus in one phrase.
    """

    def __init__(
        self, config: Config, messages: tuple[StatusFrame, ...], clock: Callable[[], float]
    ) -> None:
        super().__init__()
        self.description = describe_bus(config)
        self._config = config
        self._messages = {one.codec.key: one for one in messages}
        self._clock = clock
        self._arrivals = ArrivalClock(clock)
        self._connection = CanConnection[SensorListener](config, self, self._arrivals, self._counts)
        asked = requests(config, [one.codec for one in messages])
        self._connection.asked = asked, config.cycle_s
        self._heard_s = 0.0
        self._silent = False

    async def run(self, listener: SensorListener) -> None:
        """Hear the bus until cancelled; one that is lost or not there is opened again.

        Args:
            listener: Receiver of values and of the state of the bus.
        """
        await self._connection.run(self._messages, self._serve, listener)

    def take(self, frame: can.Message) -> None:
        """Take one frame from the bus."""
        key = frame_key(frame.arbitration_id, extended=frame.is_extended_id)
        message = self._messages.get(key)
        if message is None or frame.is_error_frame or frame.is_remote_frame:
            self.take_garbage()
            return
        self._counts["received"] += 1
        decoded = message.codec.decode(bytes(frame.data))
        self._counts["counter_lost"] += decoded.lost
        if decoded.values and decoded.verdict in {FrameVerdict.GOOD, FrameVerdict.OUT_OF_RANGE}:
            self._pass_on(message, decoded.values, self._clock() - self._arrivals.waited_s(frame))
        if decoded.verdict not in {FrameVerdict.GOOD, FrameVerdict.COUNTER_LOST}:
            self._counts[decoded.verdict] += 1

    def hand_out(self) -> None:
        """Nothing waits: each good frame is passed on at once."""

    async def _serve(self, announce: Callable[[], None]) -> str:
        """Use the open bus until it is lost; return the reason."""
        announce()
        self._heard_s, self._silent = self._clock(), False
        for message in self._messages.values():
            message.codec.resume()
        return await self._connection.read_beside(self._watch_silence(), "silence")

    def _pass_on(self, message: StatusFrame, values: Mapping[str, float], arrival_s: float) -> None:
        found = {
            one.quantity: value * one.scale + one.offset
            for one in message.sources
            if (value := values.get(one.signal)) is not None
        }
        self._heard_s = self._clock()
        if self._silent:
            self._silent = False
            self._connection.report(up=True)
        if self._connection.listener is not None:
            self._connection.listener.on_values(found, arrival_s)

    async def _watch_silence(self) -> None:
        """Report when nothing good has come for as long as a value may be held."""
        limit_s = self._config.oldest_s
        while True:
            await asyncio.sleep(self._config.cycle_s)
            if not self._silent and self._clock() - self._heard_s > limit_s:
                self._silent = True
                self._connection.report(up=False, detail=f"no good frame for {limit_s:g} s")
