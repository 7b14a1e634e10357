"""A drive and sensors on CAN, as the daemon builds them.

Each good frame hands out its values, as old as its arrival; one that fails a check changes nothing
and is counted. Nothing is sent but requests for messages that come only when asked.
"""

from __future__ import annotations

import asyncio
import math
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import can
from cantools.database.can.database import Database
from cantools.database.can.message import Message
from cantools.database.can.signal import Signal

from adaptdrive.config import Configuration, section
from adaptdrive.config.bus import CanBus
from adaptdrive.config.root import CanSensorSection as Config
from adaptdrive.devices import binding, description
from adaptdrive.devices.bus import BusKind, CountingPort, Row, bus_of, timeout_cautions
from adaptdrive.devices.can import assembly, codec, connection, integrity, mapping, port
from adaptdrive.devices.can.bus import requests
from adaptdrive.devices.can.database import Located, open_catalogue
from adaptdrive.devices.port import SensorListener
from adaptdrive.safety.timing import Timing, timing_of
from adaptdrive.util.errors import ConfigurationError, Flaw

_Source = description.Source[Located]

# Signals of a DBC, as candidates for the quantities of a configuration.

_COMMANDING = re.compile(r"cmd|command|ctrl|control|set|req|host|order", re.IGNORECASE)
_ALIVE = re.compile(r"alive|rolling|heartbeat|count|cnt|seq", re.IGNORECASE)
_CHECKSUM = re.compile(r"crc|checksum|chk", re.IGNORECASE)


def candidates(database: Database) -> Iterator[description.Candidate]:
    """Yield every signal that may be a quantity."""
    for message in database.messages:
        commanded = _COMMANDING.search(message.name) is not None
        for signal in message.signals:
            if not (signal.is_multiplexer or _is_alive(signal) or _is_checksum(signal)):
                yield _candidate(message, signal, commanded=commanded)


def proofs(message: Message) -> tuple[str | None, str | None]:
    """Return the signals that look like the alive counter and the checksum of a message."""
    counter = next((s.name for s in message.signals if _is_alive(s)), None)
    checksum = next((s.name for s in message.signals if _is_checksum(s)), None)
    return counter, checksum


def _candidate(message: Message, signal: Signal, *, commanded: bool) -> description.Candidate:
    low, high = signal.minimum, signal.maximum
    limits = "" if low is None or high is None or low == high else f"{low:g}…{high:g}"
    written = "".join(one for one in signal.unit or "" if one.isprintable())
    return description.Candidate(
        reference=f"{message.name}.{signal.name}",
        words=f"{message.name}.{signal.name}",
        unit=section.known_unit(written) or written,
        range=limits,
        commanded=commanded,
        names=tuple(str(name) for name in (signal.choices or {}).values()),
        bits=signal.length,
    )


def _is_alive(signal: Signal) -> bool:
    return signal.length <= 8 and _ALIVE.search(signal.name) is not None


def _is_checksum(signal: Signal) -> bool:
    return signal.length == 8 and _CHECKSUM.search(signal.name) is not None


# Sensors on a CAN bus: messages as a DBC describes them.


def build_can_sensors(
    bus: Config,
    place: str,
    clock: Callable[[], float],
    source: Path | str = "configuration",
    demands: description.Demands = description.NO_DEMANDS,
) -> SensorPort:
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
    return SensorPort(bus, map_sensors(bus, place, source, demands), clock)


def map_sensors(
    bus: Config,
    place: str,
    source: Path | str,
    demands: description.Demands = description.NO_DEMANDS,
) -> tuple[assembly.StatusFrame, ...]:
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
    found: dict[str, list[_Source]] = {}
    for one in catalogue.sources(binding.sensor_entries(bus, place), demands):
        found.setdefault(one.item.message.name, []).append(one)
    catalogue.check_uses({f"{place}.signals": found})
    if catalogue.flaws:
        raise ConfigurationError(source, catalogue.flaws)
    return tuple(mapping.status_frame(catalogue, bus, *item, bus.cycle_s) for item in found.items())


class SensorPort(CountingPort):
    """One connection to the sensors on one CAN bus.

    Attributes:
        description: The bus in one phrase.
    """

    def __init__(
        self, config: Config, messages: tuple[assembly.StatusFrame, ...], clock: Callable[[], float]
    ) -> None:
        super().__init__()
        self._config = config
        self._messages = {one.codec.key: one for one in messages}
        self._clock = clock
        self._arrivals = integrity.ArrivalClock(clock)
        self._connection = connection.CanConnection[SensorListener](
            config, self, self._arrivals, self._counts
        )
        self.description = self._connection.description
        asked = requests(config, [one.codec for one in messages])
        self._connection.asked = asked, config.cycle_s
        self._good_s = 0.0
        self._silent = False

    async def run(self, listener: SensorListener) -> None:
        """Read the bus until cancelled; one that is lost or not there is opened again.

        Args:
            listener: Receiver of values and of the state of the bus.
        """
        await self._connection.run(self._messages, self._serve, listener)

    def take(self, frame: can.Message) -> None:
        """Take one frame from the bus."""
        key = codec.frame_key(frame.arbitration_id, extended=frame.is_extended_id)
        message = self._messages.get(key)
        if message is None or frame.is_error_frame or frame.is_remote_frame:
            self.take_garbage()
            return
        self._counts["received"] += 1
        verdict, values, lost = message.codec.decode(bytes(frame.data))
        self._counts["counter_lost"] += lost
        if values and verdict in {integrity.FrameVerdict.GOOD, integrity.FrameVerdict.OUT_OF_RANGE}:
            self._pass_on(message, values, self._clock() - self._arrivals.waited_s(frame))
        if verdict not in {integrity.FrameVerdict.GOOD, integrity.FrameVerdict.COUNTER_LOST}:
            self._counts[verdict] += 1

    async def _serve(self, announce: Callable[[], None]) -> str:
        """Use the open bus until it is lost; return the reason."""
        announce()
        self._good_s, self._silent = self._clock(), False
        for message in self._messages.values():
            message.codec.resume()
        return await self._connection.read_beside(self._watch_silence(), "silence")

    def _pass_on(
        self, message: assembly.StatusFrame, values: Mapping[str, float], arrival_s: float
    ) -> None:
        self._good_s = self._clock()
        if self._silent:
            self._silent = False
            self._connection.report(up=True)
        if self._connection.listener is not None:
            self._connection.listener.on_values(message.quantities(values), arrival_s)

    async def _watch_silence(self) -> None:
        """Report when nothing good has come for as long as a value may be held."""
        limit_s = self._config.oldest_s
        while True:
            await asyncio.sleep(self._config.cycle_s)
            if not self._silent and self._clock() - self._good_s > limit_s:
                self._silent = True
                self._connection.report(up=False, detail=f"no good frame for {limit_s:g} s")


# A drive on CAN, as the daemon builds it.


def _build(
    configuration: Configuration, clock: Callable[[], float], source: Path | str, passive: bool
) -> port.Port:
    bus, drive = bus_of(configuration, CanBus), mapped(configuration, source)
    return port.Port(bus, drive, clock, takes_all=passive)


def mapped(
    configuration: Configuration, source: Path | str = "configuration"
) -> assembly.CanMapping:
    """Return the messages of a drive, held against what its limits ask."""
    bus, demands = bus_of(configuration, CanBus), description.demands_of(configuration)
    return mapping.map_drive(bus, configuration.signals, timing_of(configuration), source, demands)


def _time_limits(configuration: Configuration, source: Path | str) -> Iterator[Row]:
    """Yield the age of each value, with the slack of a message that comes seldom."""
    stale_s = configuration.interlocks.stale_s
    statuses = mapped(configuration, source).statuses
    for one in (one for status in statuses for one in status.sources):
        keys = f"bus.stale_cycles, {one.cycle_by}" if one.slack_s else "interlocks.stale_s"
        yield f"stale {one.quantity}", stale_s + one.slack_s, keys


def _cautions(configuration: Configuration) -> Iterator[Flaw]:
    """Yield what the drive's own time-out does not fit, and what may hide the bridge."""
    timing, found = timing_of(configuration), mapped(configuration)
    sources = [(status.codec.name, one) for status in found.statuses for one in status.sources]
    slack_s = min(one.slack_s for _, one in sources)
    yield from timeout_cautions(timing, "bus.clock_ticks", slack_s)
    for message, one in sources:
        if one.quantity == "bridge":
            yield from _bridge_cautions(timing, message, one)
    yield from found.cautions


def _bridge_cautions(timing: Timing, message: str, bridge: _Source) -> Iterator[Flaw]:
    """Yield that a drive must wait, or may have to, for a report of its bridge for long."""
    timeout_s, limit_s = timing.command_timeout_s, timing.silent_s
    every_s, says = bridge.cycle_s, f"comes every {bridge.cycle_s * 1e3:.4g} ms"
    if math.isinf(every_s):  # it may come as seldom as it may be old
        if timeout_s is not None:
            return
        every_s, says = timing.stale_s + bridge.slack_s, "has no GenMsgCycleTime"
    if every_s > limit_s and (timeout_s or 0.0) <= limit_s + every_s:
        yield Flaw(
            "signals.bridge",
            f"message {message!r} {says}: after {limit_s * 1e3:.4g} ms without the daemon or the "
            "drive, or a leap of an alive counter, nothing energises before its next report, and "
            "a drive stops meanwhile whose own time-out (bus.command_timeout_s) is not longer "
            f"than {(limit_s + every_s) * 1e3:.4g} ms",
        )


CAN = BusKind(_build, _cautions, build_can_sensors, _time_limits)
