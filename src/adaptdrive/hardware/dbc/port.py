"""The port of a drive on a CAN bus.

Every message keeps its last good values and their arrival. When a good clocking frame arrives and
every quantity has been heard once, there is a reading, as old as its oldest value. One whose frame
was read as soon as it came is handed out at once. One whose frame has waited is held back until no
more frames wait: of readings that piled up while the process did not run, only the newest is worth
a tick. A frame that fails a check changes nothing and is counted.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import can

from adaptdrive.config.bus import CanBus, Signals
from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.hardware.dbc.mapping import OTHER, CanMapping, StatusFrame, Timing, map_drive
from adaptdrive.hardware.dbc.orders import CommandFrame
from adaptdrive.hardware.dbc.refusals import Refusals
from adaptdrive.hardware.demands import NO_DEMANDS, Demands
from adaptdrive.hardware.fault_latch import FaultLatch
from adaptdrive.hardware.link.arrival import PROMPT_S, ArrivalClock
from adaptdrive.hardware.link.bus import as_received, describe_bus, frame_key, open_bus
from adaptdrive.hardware.link.codec import MessageCodec
from adaptdrive.hardware.link.integrity import FrameVerdict
from adaptdrive.hardware.link.reader import FrameReader
from adaptdrive.hardware.link.reconnect import serve_for_ever
from adaptdrive.hardware.port import Listener, PortStatistics, Reading
from adaptdrive.hardware.rival import Rival


def build_can_port(  # noqa: PLR0913 - what the configuration says, and both clocks
    bus: CanBus,
    signals: Signals,
    timing: Timing,
    clock: Callable[[], float],
    *,
    wall_clock: Callable[[], float] = time.time,
    source: Path | str = "configuration",
    hears_all: bool = False,
    demands: Demands = NO_DEMANDS,
) -> CanPort:
    """Build the port of one drive; nothing is opened yet.

    Args:
        bus: `[bus]`.
        signals: `[signals]`.
        timing: How old a value may be.
        clock: Monotonic clock, in seconds.
        wall_clock: The clock with which the bus stamps frames, in seconds.
        source: The configuration, for error messages.
        hears_all: Whether to receive and record frames with unused ids, too.
        demands: What the limits of the configuration ask of the signals.

    Raises:
        ConfigurationError: Configuration and DBC do not fit; every flaw is listed.
    """
    mapping = map_drive(bus, signals, timing, source, demands)
    return CanPort(bus, mapping, clock, wall_clock, hears_all=hears_all)


class CanPort:
    """One connection to one drive on a CAN bus."""

    def __init__(
        self,
        config: CanBus,
        mapping: CanMapping,
        clock: Callable[[], float],
        wall_clock: Callable[[], float],
        *,
        hears_all: bool = False,
    ) -> None:
        self._config = config
        self._mapping = mapping
        self._clock = clock
        self._arrivals = ArrivalClock(clock, wall_clock)
        self._statuses = {_key(status.codec): status for status in mapping.statuses}
        self._commands = {_key(order.codec): _label(order.codec) for order in mapping.orders}
        self._rival = Rival(clock)
        self._refusals = Refusals()
        self._hears_all = hears_all
        self._sources = [source for status in mapping.statuses for source in status.sources]
        self._clocking = next(one for one in mapping.statuses if one.codec.name == mapping.clock)
        self._others = {
            source.quantity: source.quantity.removeprefix(OTHER)
            for source in self._sources
            if source.quantity.startswith(OTHER)
        }
        self._counts: Counter[str] = Counter()
        self._values: dict[str, float] = {}
        self._dues: dict[str, tuple[float, float]] = {}
        self._bridge_sent = False
        self._faults = FaultLatch(mapping.fault_names)
        self._safe_s = math.inf
        self._bus: can.BusABC | None = None
        self._reader: FrameReader | None = None
        self._newest: Reading | None = None
        self._listener: Listener | None = None
        self._made_up = list(_made_up(config, mapping))

    @property
    def description(self) -> str:
        """The bus in one phrase for people, such as `udp_multicast 239.74.163.2:43113`."""
        return describe_bus(self._config)

    @property
    def counter_modulus(self) -> int | None:
        """Modulus of the drive's half-cycle counter, None for a drive without a counter."""
        return self._mapping.counter_modulus

    @property
    def statistics(self) -> PortStatistics:
        """Counts since the port was built."""
        return PortStatistics(**self._counts)

    @property
    def complaint(self) -> str | None:
        """That another sender commands the drive, or a fault that no reading has carried yet."""
        return self._rival.complaint or self._faults.complaint

    @property
    def safe_s(self) -> float:
        """Time at which the bus took the safe command in force, infinite while none is in force."""
        return self._safe_s

    @property
    def stop_slack_s(self) -> float | None:
        """Additional time for the report of the bridge, None for a drive that never reports it."""
        words = (source.slack_s for source in self._sources if source.quantity == "bridge")
        return next(words, None)

    async def run(self, listener: Listener, opened: Callable[[], None]) -> None:
        """Open the bus, call `opened`, and serve it until cancelled; reconnect when it is lost.

        Args:
            listener: Receiver of readings and of the state of the bus.
            opened: Called once, when the bus is open.

        Raises:
            BusError: The bus cannot be opened at the first attempt.
        """
        self._listener = listener
        await serve_for_ever(
            self._open,
            self._serve,
            opened,
            lost=self._announce_loss,
            returned=self._announce_return,
            heard=lambda: self._counts["received"],
        )

    def send(self, command: Command) -> bool:
        """Send one command now.

        Args:
            command: Command to the drive; it must have passed the guard.

        Returns:
            Whether the bus took it; False is counted, and nothing is sent again.

        Raises:
            ValueError: A value is not finite, or its signal cannot hold it; nothing is sent.
        """
        frames = [self._frame(order, command) for order in self._mapping.orders]
        if command != SAFE_COMMAND:
            self._safe_s = math.inf
        taken = 0
        for frame in frames:
            taken += self._put(frame)
        if taken < len(frames):
            return False
        self._bridge_sent = command.bridge
        if command == SAFE_COMMAND and self._safe_s == math.inf:
            self._safe_s = self._clock()
        return True

    def catch_up(self) -> None:
        """Process the frames that have arrived, but were not read yet."""
        if self._reader is not None:
            self._reader.drain()

    def rehearse(self) -> None:
        """Decode synthetic frames, without a report to the listener."""
        for status in self._mapping.statuses:
            status.codec.reset()
        for received in self._made_up:
            self.take(received())

    def explain_age(self) -> str:
        """Return the oldest value, its source, and the likeliest cause of its age."""
        now_s = self._clock()
        arrivals = [
            (due_s - slack_s, status, source)
            for status in self._mapping.statuses
            for source in status.sources
            for due_s, slack_s in [self._dues.get(source.quantity, (-math.inf, 0.0))]
        ]
        # as in a reading: the value that is out of date first
        oldest_s, status, source = min(arrivals, key=lambda one: one[0] + one[2].slack_s)
        newest_s = max(arrival_s for arrival_s, _, _ in arrivals)
        value = f"{source.quantity} ({_label(status.codec)}, {source.signal.name})"
        found = "has never come" if oldest_s == -math.inf else "is the oldest value"
        others_come = newest_s > oldest_s and now_s - newest_s < 0.5 * (now_s - oldest_s)
        return f"{value} {found}: {self._explain_silence(status, others_come=others_come)}"

    def _explain_silence(self, status: StatusFrame, *, others_come: bool) -> str:
        if self._bus is None:
            return "the bus is lost"
        refused = self._refusals.explain(_label(status.codec))
        if refused is not None:
            return refused
        if others_come:
            return "other messages come: is this one switched on in the drive, with this id?"
        return "no message comes: check the drive's supply, the cable, the bit rate, the ids"

    def details(self) -> list[str]:
        """Frames that were refused, one line for each kind."""
        return list(self._refusals.lines())

    async def reset_fault(self) -> None:
        """No-op: a DBC has no fault reset; the drive clears its fault word by itself."""

    def take(self, frame: can.Message) -> None:
        """Take one frame from the bus."""
        key = frame_key(frame.arbitration_id, extended=frame.is_extended_id)
        self._counts["received"] += 1
        status = self._statuses.get(key)
        if status is None or frame.is_error_frame or frame.is_remote_frame:
            self._take_foreign(key, frame)
            return
        self._take_status(status, frame)

    def take_garbage(self) -> None:
        """Count something on the bus that is no frame."""
        self._counts["received"] += 1
        self._counts["foreign"] += 1

    def _take_foreign(self, key: int, frame: can.Message) -> None:
        """Count a frame that is no measurement; no bus returns what this port has sent."""
        self._counts["foreign"] += 1
        if self._hears_all:
            self._refusals.note_strange(f"0x{frame.arbitration_id:03X}", bytes(frame.data))
        if key in self._commands and not (frame.is_error_frame or frame.is_remote_frame):
            self._counts["foreign_commands"] += 1
            self._rival.hear(self._commands[key])

    def _take_status(self, status: StatusFrame, frame: can.Message) -> None:
        waited_s = self._arrivals.waited_s(frame)
        arrival_s = self._clock() - waited_s
        decoded = status.codec.decode(bytes(frame.data))
        if decoded.lost:
            self._counts["counter_lost"] += decoded.lost
        if decoded.verdict is not FrameVerdict.GOOD:
            # a counter that leapt is in `counter_lost` already, with the length of its leap
            if decoded.verdict is not FrameVerdict.COUNTER_LOST:
                self._counts[decoded.verdict] += 1
            self._refusals.note(_label(status.codec), decoded.verdict, bytes(frame.data))
            return
        self._keep(status, decoded.values, arrival_s)
        if status is self._clocking:
            self._compose(arrival_s)
            if frame.timestamp and waited_s < PROMPT_S:
                self._hand_out()

    def _keep(self, status: StatusFrame, found: Mapping[str, float], arrival_s: float) -> None:
        values, dues = self._values, self._dues
        if self._refusals.any:
            self._refusals.accept(_label(status.codec))
        for source in status.sources:
            value = found.get(source.signal.name)
            if value is not None:
                quantity, slack_s = source.quantity, source.slack_s
                values[quantity] = value * source.scale + source.offset
                dues[quantity] = arrival_s + slack_s, slack_s
        self._faults.see(values.get("fault"))

    def _compose(self, arrival_s: float) -> None:
        """Make a reading of the newest values, and of each fault seen since the last one."""
        due_s, slack_s = min(self._dues.values())
        if due_s == -math.inf:
            return
        values, faults = self._values, self._faults
        counter, bridge = values.get("counter"), values.get("bridge")
        self._newest = Reading(
            arrival_s=arrival_s,
            oldest_s=due_s - slack_s,
            slack_s=slack_s,
            counter=None if counter is None else int(counter),
            boost_voltage_V=values.get("boost_voltage_V", math.nan),
            line_voltage_V=values.get("line_voltage_V", math.nan),
            load_power_W=values.get("load_power_W", math.nan),
            output=values.get("output", math.nan),
            fault=faults.word,
            fault_name=faults.name if faults.word else "",
            # a drive without a bridge signal is assumed to follow the last command
            bridge=self._bridge_sent if bridge is None else bridge == self._mapping.bridge_on,
            bridge_s=self._heard_s("bridge"),
            other={name: values[key] for key, name in self._others.items()},
        )

    def _heard_s(self, quantity: str) -> float | None:
        """Arrival of a quantity's newest value, None where the drive does not give it."""
        due = self._dues.get(quantity)
        return None if due is None else due[0] - due[1]

    def _hand_out(self) -> None:
        """No more frames wait."""
        reading, self._newest = self._newest, None
        if reading is not None and self._listener is not None:
            self._faults.clear(reading.fault)
            self._listener.on_reading(reading)

    def _put(self, frame: can.Message) -> bool:
        try:
            if self._bus is None:
                raise can.CanOperationError("not connected")
            self._bus.send(frame, timeout=0.0)
        except (can.CanError, OSError, ValueError):
            self._counts["send_drops"] += 1
            return False
        self._counts["sent"] += 1
        return True

    def _frame(self, order: CommandFrame, command: Command) -> can.Message:
        codec = order.codec
        return can.Message(
            arbitration_id=codec.frame_id,
            is_extended_id=codec.is_extended,
            is_fd=codec.is_fd,
            bitrate_switch=codec.is_fd and self._config.bitrate_switch,
            data=order.encode(command),
        )

    def _open(self) -> can.BusABC:
        self._arrivals.begin_drain()
        self._arrivals.end_drain()
        listen = [] if self._hears_all else [*self._statuses, *self._commands]
        return open_bus(self._config, listen)

    async def _serve(self, bus: can.BusABC, announce: Callable[[], None]) -> str:
        """Use an open bus until it is lost, and close it; why it was lost."""
        self._bus = bus
        self._forget()
        try:
            announce()
            self._reader = FrameReader(bus, self, self._arrivals, self._hand_out)
            return await self._reader.run()
        except Exception:
            self.send(SAFE_COMMAND)  # the last frame, whatever has gone wrong
            raise
        finally:
            self._bus = self._reader = None
            bus.shutdown()

    def _announce_loss(self, problem: str) -> None:
        if self._listener is not None:
            self._listener.on_bus(up=False, detail=f"{self.description}: {problem}")

    def _announce_return(self) -> None:
        self._counts["reconnects"] += 1
        if self._listener:
            self._listener.on_bus(up=True, detail=self.description)

    def _forget(self) -> None:
        """Nothing that was heard or said before a bus was opened is used after it."""
        self._newest, self._safe_s = None, math.inf
        for status in self._mapping.statuses:
            status.codec.reset()
        for source in self._sources:
            self._dues[source.quantity] = -math.inf, 0.0


def _made_up(config: CanBus, mapping: CanMapping) -> Iterator[Callable[[], can.Message]]:
    """Frames as the drive might send them, each from a function that gives it again and again."""
    for codec in (status.codec for status in mapping.statuses):
        data = codec.example()
        if data is not None:
            yield as_received(
                config,
                can.Message(
                    arbitration_id=codec.frame_id,
                    is_extended_id=codec.is_extended,
                    is_fd=codec.is_fd,
                    data=data,
                ),
            )


def _key(codec: MessageCodec) -> int:
    return frame_key(codec.frame_id, extended=codec.is_extended)


def _label(codec: MessageCodec) -> str:
    return f"0x{codec.frame_id:03X} ({codec.name})"
