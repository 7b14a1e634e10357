"""The port of a drive on a CAN bus.

Every message keeps its last good values and their arrival. When a good clocking frame arrives and
every quantity has come once, there is a reading, as old as its oldest value. One whose frame
was read as soon as it came is handed out at once. One whose frame has waited is held back until no
more frames wait: of readings that piled up while the process did not run, only the newest is worth
a tick. A frame that fails a check is counted and changes nothing, but for the other values of one
with a value out of range. Of one whose alive counter leapt or stands, faults and a stop are noted.
"""

import math
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Coroutine, Mapping, Sequence
from functools import partial
from typing import Any, Final

import can

from adaptdrive.config.bus import CanBus
from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.devices import bus, port
from adaptdrive.devices.can import assembly, connection, integrity
from adaptdrive.devices.can.assembly import CanMapping, CommandFrame, StatusFrame
from adaptdrive.devices.can.bus import requests
from adaptdrive.devices.can.codec import frame_key
from adaptdrive.safety.facts import Reading
from adaptdrive.safety.monitor import Doubt, Monitor, Verdict
from adaptdrive.safety.timing import OBEY_S
from adaptdrive.safety.trips import Trip, TripKind

_ASK_AGAIN_S = 1.0
"""Silence of the clock of a drive that is off after which its set-up is sent again: it may have
started anew, and forgotten the requests for its messages."""

_GOOD: Final[integrity.FrameVerdict] = integrity.FrameVerdict.GOOD  # found at once by compiled code


class Port:
    """One connection to one drive on a CAN bus.

    Attributes:
        description: The bus in one phrase, such as `udp_multicast 239.74.163.2:43113`.
        counter_modulus: As in `Port`, like all that follow.
        monitor: What the port has seen of the drive.
    """

    def __init__(
        self,
        config: CanBus,
        mapping: CanMapping,
        clock: Callable[[], float],
        wall_clock: Callable[[], float] = time.time,
        *,
        takes_all: bool = False,
    ) -> None:
        """Open nothing yet.

        Args:
            config: `[bus]`.
            mapping: Messages and properties of the drive.
            clock: Monotonic clock, in seconds.
            wall_clock: The clock with which the bus stamps frames, in seconds.
            takes_all: Whether to receive and record frames with unused ids, too.
        """
        self._config = config
        self._mapping = mapping
        self._clock = clock
        self._arrivals = integrity.ArrivalClock(clock, wall_clock)
        self._counts: Counter[str] = Counter()
        self._connection = connection.CanConnection[port.Listener](
            config, self, self._arrivals, self._counts
        )
        asked = requests(config, [one.codec for one in mapping.statuses])
        self._reading_s = mapping.timing.reading_s
        self._connection.asked = asked, self._reading_s
        self._connection.caught_up = self.hand_out
        self._assembly = assembly.StatusAssembly(mapping)
        self._statuses = {status.codec.key: status for status in mapping.statuses}
        self._commands = {order.codec.key: order.codec.label for order in mapping.orders}
        self._refusals = assembly.Refusals()
        self._takes_all = takes_all
        self._clocking = next(one for one in mapping.statuses if one.codec.name == mapping.clock)
        self._stopping = assembly.bridge_first(mapping.orders)
        self.description = self._connection.description
        self.counter_modulus = mapping.counter_modulus
        bridge = self._assembly.bridge
        self.monitor = Monitor(
            mapping.timing,
            clock,
            slack_s=None if bridge is None else bridge.slack_s,
            cycle_s=0.0 if bridge is None else bridge.cycle_s,
        )
        self._sent_s: dict[int, float] = {}
        self._asked_s = -math.inf
        self._newest: Reading | None = None

    @property
    def statistics(self) -> port.PortStatistics:
        """Counts since the port was built."""
        return port.PortStatistics(**self._counts)

    @property
    def trip_cause(self) -> Trip | None:
        """Another sender, a fault that no reading has carried yet, or commands not taken."""
        return (
            self.monitor.trip_cause
            or self._assembly.newest.faults.trip_cause
            or self._connection.trip_cause
        )

    def run(self, listener: port.Listener, opened: Callable[[], None]) -> Coroutine[Any, Any, None]:
        """Open the bus, call `opened`, and serve it until cancelled; reconnect when it is lost.

        Args:
            listener: Receiver of readings and of the state of the bus.
            opened: Called once, when the bus is open.

        Raises:
            BusError: The bus cannot be opened at the first attempt.
        """
        ids = [] if self._takes_all else [*self._statuses, *self._commands]
        return self._connection.run(ids, self._serve, listener, opened)

    def send(self, command: Command) -> bool:
        """Send one command now; one that has the bridge off begins with the frame that says so.

        Args:
            command: Command to the drive; it must have passed the guard.

        Returns:
            Whether the bus took it. False is counted, and nothing is sent again. It is withheld
            in every other second of a drive that stays energised after the safe command: silence
            lets its own time-out switch it off; and for a command that has the bridge on while the
            drive may have stopped.

        Raises:
            ValueError: A value is not finite, or its signal cannot hold it; nothing is sent.
        """
        bridge = command.bridge
        orders = self._due(self._mapping.orders if bridge else self._stopping, bridge=bridge)
        frames = [self._frame(order, command) for order in orders]
        monitor = self.monitor
        monitor.command(command)
        if self._is_withheld(bridge=bridge):
            self._counts["withheld_commands"] += 1
            return False
        if not bridge and self._clock() > self._asked_s + _ASK_AGAIN_S:
            self._set_up()
        if bridge and not monitor.given and not self._set_up():  # it may have started anew
            self._connection.note_command(taken=False)
            return False
        taken = 0
        for frame in frames:
            taken += self._connection.send(frame)
        self._connection.note_command(taken=taken == len(frames))
        if taken < len(frames):  # the frame that energises may be one of those that went out
            if bridge and taken:
                monitor.offer(command)
            return False
        monitor.take(command)
        self._sent_s |= {order.codec.key: self._clock() for order in orders if order.every_s}
        return True

    def catch_up(self) -> None:
        """Process the frames that have arrived, but were not read yet."""
        self._connection.catch_up()

    def explain_age(self) -> Trip:
        """Return the oldest value, its source, its age, and the likeliest cause of that."""
        now_s = self._clock()
        status, source, oldest_s, newest_s = self._assembly.oldest()
        value = f"{source.quantity} ({status.codec.label}, {source.field.name})"
        age_s, came = now_s - oldest_s, oldest_s > -math.inf
        # not the age of the reading, which may be that of a value that has come since
        found = f"is the oldest value, {age_s * 1e3:.0f} ms old" if came else "has never come"
        others_come = newest_s > oldest_s and now_s - newest_s < 0.5 * age_s
        kind, why = self._explain_silence(status, came=came, others_come=others_come)
        return Trip(kind, f"{value} {found}: {why}")

    def _explain_silence(
        self, status: StatusFrame, *, came: bool, others_come: bool
    ) -> tuple[TripKind, str]:
        if self._connection.bus is None:
            return TripKind.BUS_LOST, "the bus is lost"
        refused = self._refusals.explain(status.codec.label)
        if refused is not None:
            return TripKind.FRAMES_REFUSED, refused
        if status.codec.name in self._config.polled:
            hint = "check bus.polled, the id, the drive and its cable"
            return TripKind.MESSAGE_MISSING, f"no reply to its requests: {hint}"
        if others_come and came:
            others = "other messages come, and this one has come before"
            hint = "does the drive still send it, and as often as interlocks.stale_s needs?"
            return TripKind.MESSAGE_MISSING, f"{others}: {hint}"
        if others_come:
            hint = "is this one switched on in the drive, with this id?"
            return TripKind.MESSAGE_MISSING, f"other messages come: {hint}"
        hint = "check the drive's supply, the cable, the bit rate, the ids"
        return TripKind.NO_MESSAGE, f"no message comes: {hint}"

    def details(self) -> list[str]:
        """Frames that were refused, one line for each kind."""
        return list(self._refusals.lines())

    def reset_fault(self) -> Coroutine[Any, Any, None]:
        """Switch the reset of the drive's fault on and off with the next frames, if it has one."""
        sinks = (part for order in self._mapping.orders for part in order.parts.values())
        return bus.pulse_reset(sinks, self._mapping.timing.reading_s)

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
        """Count a datagram on the bus that is not a CAN frame as foreign."""
        self._counts["received"] += 1
        self._counts["foreign"] += 1

    def _take_foreign(self, key: int, frame: can.Message) -> None:
        """Count a frame that is no measurement; no bus returns what this port has sent."""
        self._counts["foreign"] += 1
        if self._takes_all:
            sender = f" from 0x{key & 0xFF:02X} of J1939" if frame.is_extended_id else ""
            self._refusals.note(f"0x{frame.arbitration_id:03X}{sender}", None, bytes(frame.data))
        if key in self._commands and not (frame.is_error_frame or frame.is_remote_frame):
            self._counts["foreign_commands"] += 1
            self.monitor.note_foreign(self._commands[key])

    def _take_status(self, status: StatusFrame, frame: can.Message) -> None:
        waited_s = self._arrivals.waited_s(frame)
        arrival_s = self._clock() - waited_s
        data = bytes(frame.data)
        verdict, values, lost = status.codec.decode(data)
        if lost:
            self._counts["counter_lost"] += lost
        if verdict is not _GOOD:
            self._refuse(status, verdict, data)
            if verdict is integrity.FrameVerdict.COUNTER_LOST:
                self.monitor.doubt(Doubt.LEAPT, arrival_s)  # the drive may be a new one
            if verdict is not integrity.FrameVerdict.OUT_OF_RANGE:
                self._take_old(status, values, arrival_s)
                return
        elif self._refusals.any:
            self._refusals.accept(status.codec.label)
        on = self._assembly.keep(status, values, arrival_s, whole=verdict is _GOOD)
        if on is not None:
            self.monitor.report(on=on, asked_s=arrival_s, came_s=arrival_s)
        if status is self._clocking and self._has_page(status, values, data):
            self._clock_reading(arrival_s)
            if frame.timestamp and waited_s < integrity.PROMPT_S:
                self.hand_out()

    def _clock_reading(self, arrival_s: float) -> None:
        """Make a reading, if every value has come; of a drive without a report it is assumed."""
        monitor, given = self.monitor, self.monitor.given
        self._asked_s = max(self._asked_s, arrival_s)
        self._newest = self._assembly.newest.reading(arrival_s, bridge=given) or self._newest
        if monitor.slack_s is None:
            monitor.report(on=given, asked_s=arrival_s, came_s=arrival_s)

    def _take_old(self, status: StatusFrame, values: Mapping[str, float], arrival_s: float) -> None:
        """Note what a message shows that may be an old one: faults, and what its bridge may do."""
        on = self._assembly.look_at(status, values)
        if on is not None:
            self.monitor.hint(on=on, came_s=arrival_s)

    def _has_page(self, status: StatusFrame, found: Mapping[str, float], data: bytes) -> bool:
        """Return whether a good frame of the clocking message has the page that clocks."""
        page = self._mapping.page
        return page is None or page in found or status.codec.carries(data, page)

    def _refuse(self, status: StatusFrame, verdict: integrity.FrameVerdict, data: bytes) -> None:
        """Count a frame that failed a check, and remember it for reports."""
        # a counter that leapt is in `counter_lost` already, with the length of its leap
        if verdict is not integrity.FrameVerdict.COUNTER_LOST:
            self._counts[verdict] += 1
        codec = status.codec
        self._refusals.note(codec.label, verdict, data, codec)

    def hand_out(self) -> None:
        """Pass the newest reading on: no more frames wait."""
        reading, self._newest = self._newest, None
        if reading is not None and (listener := self._connection.listener) is not None:
            if reading.fault or reading.warning:
                self._assembly.newest.faults.clear(reading.fault)
            self._connection.note_reading()
            listener.on_reading(reading)

    def _is_withheld(self, *, bridge: bool) -> bool:
        """Return whether a command is kept from the drive.

        One that energises waits for a report of a drive that may have stopped. A drive that does
        not obey gets none in every other second.
        """
        verdict = self.monitor.verdict
        if verdict is Verdict.DISOBEYS:
            return int(self.monitor.overdue_s / OBEY_S) % 2 == 0
        return bridge and verdict is not Verdict.OBEYS

    def _due(self, orders: Sequence[CommandFrame], *, bridge: bool) -> Sequence[CommandFrame]:
        """Return the frames that go with a command now; all of them where the bridge changes."""
        if bridge is not self.monitor.given:
            self._sent_s.clear()
        by_s, sent_s = self._clock() + 0.5 * self._reading_s, self._sent_s
        return [one for one in orders if by_s >= sent_s.get(one.codec.key, -math.inf) + one.every_s]

    def _frame(self, order: CommandFrame, command: Command) -> can.Message:
        stale_s = self._mapping.timing.stale_s
        measured = self._assembly.newest.fresh(self._clock(), stale_s) if order.copies else {}
        return order.codec.frame(order.encode(command, measured))

    def _set_up(self) -> bool:
        """Send what the drive needs before it is commanded; whether the bus took all of it."""
        self._asked_s = self._clock()
        frames = [self._frame(order, SAFE_COMMAND) for order in self._mapping.setup]
        return all(self._connection.send(frame) for frame in frames)

    def _serve(self, announce: Callable[[], None]) -> Awaitable[str]:
        """Use the open bus until it is lost; return the reason."""
        self._newest = None
        self.monitor.lose()
        self._sent_s.clear()
        self._assembly.forget()
        if not self._takes_all:
            self._set_up()
        return self._connection.read_after(announce, partial(self.send, SAFE_COMMAND))
