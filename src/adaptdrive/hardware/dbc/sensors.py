"""Sensors on a CAN bus: messages that come by themselves, as a DBC describes them.

Each good frame hands out its values, as old as its arrival; one that fails a check changes nothing
and is counted. Nothing is ever sent.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import can

from adaptdrive.config.sensors import CanSensorSection as Config
from adaptdrive.errors import BusError, ConfigurationError
from adaptdrive.hardware.binding import Source, sensor_entries
from adaptdrive.hardware.counting import BusBackoff, SensingPort
from adaptdrive.hardware.dbc.database import Located, SignalCatalogue, describe
from adaptdrive.hardware.demands import NO_DEMANDS, Demands
from adaptdrive.hardware.link.arrival import ArrivalClock
from adaptdrive.hardware.link.bus import channel_flaws, describe_bus, open_bus
from adaptdrive.hardware.link.codec import MessageCodec, frame_key
from adaptdrive.hardware.link.integrity import FrameVerdict
from adaptdrive.hardware.link.reader import FrameReader
from adaptdrive.hardware.port import SensorListener


@dataclass(frozen=True, slots=True)
class SensorMessage:
    """A message, and what is taken from it."""

    codec: MessageCodec
    sources: tuple[Source[Located], ...]


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
) -> tuple[SensorMessage, ...]:
    """Find every configured signal in the DBC.

    Args:
        bus: One entry of `[[sensor_bus]]`.
        place: Where it stands in the configuration.
        source: The configuration, for error messages.
        demands: What the signals must be able to carry.

    Raises:
        ConfigurationError: Something does not fit; every flaw is listed.
    """
    catalogue = SignalCatalogue(describe(bus, source, place), fd=bus.fd)
    catalogue.flaws.extend(channel_flaws(bus, place))
    found: dict[str, list[Source[Located]]] = {}
    for one in catalogue.sources(sensor_entries(bus, place), demands):
        found.setdefault(one.item.message.name, []).append(one)
    for name, integrity in bus.integrity.items():
        catalogue.check_integrity(name, integrity, place)
    catalogue.check_ids(found, (), f"{place}.signals")
    if catalogue.flaws:
        raise ConfigurationError(source, catalogue.flaws)
    messages = []
    for name, sources in found.items():
        signals = dict.fromkeys(one.item.signal.name for one in sources)
        codec = MessageCodec(
            catalogue.known(name),
            bus.integrity.get(name),
            wanted=signals,
            measured=signals,
            cycle_s=bus.cycle_s,
        )
        messages.append(SensorMessage(codec, tuple(sources)))
    return tuple(messages)


class CanSensorPort(SensingPort):
    """One connection to the sensors on one CAN bus."""

    def __init__(
        self, config: Config, messages: tuple[SensorMessage, ...], clock: Callable[[], float]
    ) -> None:
        super().__init__(describe_bus(config))
        self._config = config
        self._messages = {one.codec.key: one for one in messages}
        self._clock = clock
        self._arrivals = ArrivalClock(clock)
        self._listener: SensorListener | None = None
        self._heard_s = 0.0

    async def run(self, listener: SensorListener) -> None:
        """Hear the bus until cancelled; one that is lost or not there is opened again.

        Args:
            listener: Receiver of values and of the state of the bus.
        """
        self._listener = listener
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._watch_silence(listener), name="silence")
            backoff = BusBackoff(lambda: self._counts["received"] - self._counts["foreign"])
            while True:
                self._report(listener, up=False, problem=await self._try())
                await asyncio.sleep(backoff.next_s())

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
        if decoded.verdict is FrameVerdict.GOOD:
            self._hand_out(message, decoded.values, self._clock() - self._arrivals.waited_s(frame))
        elif decoded.verdict is not FrameVerdict.COUNTER_LOST:
            self._counts[decoded.verdict] += 1

    async def _try(self) -> str:
        """Open the bus and read it until it is lost; return the reason."""
        self._arrivals.begin_drain()
        self._arrivals.end_drain()
        try:
            bus = open_bus(self._config, self._messages)
        except BusError as problem:
            return problem.problem
        self._count_reopened()
        for message in self._messages.values():
            message.codec.resume()
        try:
            return await FrameReader(bus, self, self._arrivals).run()
        finally:
            bus.shutdown()

    def _hand_out(
        self, message: SensorMessage, values: Mapping[str, float], arrival_s: float
    ) -> None:
        found = {
            one.quantity: value * one.scale + one.offset
            for one in message.sources
            if (value := values.get(one.item.signal.name)) is not None
        }
        self._heard_s = self._clock()
        if self._listener is not None:
            self._report(self._listener, up=True)
            self._listener.on_values(found, arrival_s)

    async def _watch_silence(self, listener: SensorListener) -> None:
        """Report when nothing good has come for as long as a value may be held."""
        limit_s = self._config.oldest_s
        self._heard_s = self._clock()
        while True:
            await asyncio.sleep(self._config.cycle_s)
            if self._clock() - self._heard_s > limit_s:
                self._report(listener, up=False, problem=f"no good frame for {limit_s:g} s")
