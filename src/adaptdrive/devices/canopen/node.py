"""A node: its status PDOs as readings, its connection, and the daemon as its NMT master.

A node is set up in state pre-operational and started then. It is lost when it is restarted, leaves
the state operational, or its heartbeat stays away; it is then set up again. So is one whose objects
another sender has written, once that is quiet. The port is notified first, and a node that may
still take commands has time for the safe one.

The values of a set were measured at the same moment; in place of one that must not be used stands
the last good one. A PDO that comes again before the others have ends the set, and one without a
SYNC since the last reading begins none: repeated PDOs make no readings of their own.
"""

import asyncio
import contextlib
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping

import can

from adaptdrive.config.bus import CanOpenBus
from adaptdrive.devices import binding, bus, port
from adaptdrive.devices.can import connection, integrity
from adaptdrive.devices.can.assembly import StatusFrame
from adaptdrive.devices.can.bus import describe_bus
from adaptdrive.devices.canopen import dictionary, profile, sdo
from adaptdrive.devices.canopen.mapping import CanOpenMapping
from adaptdrive.safety.facts import Reading
from adaptdrive.safety.monitor import Monitor
from adaptdrive.safety.timing import Timing
from adaptdrive.safety.trips import Trip, TripKind
from adaptdrive.util.errors import BusError

# The drive's status PDOs as readings: the set after one SYNC, and the newest of several sets.

_STATUSWORD = dictionary.label(profile.STATUSWORD)


class Reports:
    """Collects status PDOs, and keeps the newest reading until it is handed out.

    Attributes:
        faults: Faults that no reading has carried yet.
    """

    def __init__(
        self,
        mapping: CanOpenMapping,
        control: profile.DriveControl,
        drive: Monitor,
        counts: Counter[str],
    ) -> None:
        """Expect PDOs; none has come yet.

        Args:
            mapping: PDOs of a reading, and fault words of the drive.
            control: Follows the statusword.
            drive: Takes what the statusword says of the bridge.
            counts: Counts of the port, to which refused PDOs are added.
        """
        self._values = mapping.newest_values()
        self.faults = self._values.faults
        self._statuses = {status.codec.name: status for status in mapping.statuses}
        self._control, self._monitor, self._counts = control, drive, counts
        self._came: set[str] = set()
        self._sampled_s: float | None = None
        self._repeated = ""
        self._refused = 0
        self._newest: Reading | None = None

    @property
    def missing(self) -> list[str]:
        """Names of the PDOs that have not come since the last SYNC."""
        return [name for name in self._statuses if name not in self._came]

    def begin(self, sampled_s: float | None) -> None:
        """Begin a set: a SYNC has passed, and the drive measures now; None to end one."""
        self._came.clear()
        self._sampled_s = sampled_s

    def take(self, status: StatusFrame, data: bytes, arrival_s: float) -> bool:
        """Take one PDO.

        Args:
            status: Its codec and its sources.
            data: What it carries.
            arrival_s: Its arrival.

        Returns:
            Whether it was the last of its set.
        """
        verdict, found, _ = status.codec.decode(data)
        name = status.codec.name
        if verdict is not integrity.FrameVerdict.GOOD:
            self._counts[verdict] += 1
            self._refused += 1
            if verdict is not integrity.FrameVerdict.OUT_OF_RANGE:
                return False
        elif self._sampled_s is None:
            self._counts["counter_stuck"] += 1
        values = self._follow(status, found)
        if name in self._came:
            self.begin(None)
            self._repeated = name
        if (on := values.get(binding.BRIDGE)) is not None:
            self._note_bridge(arrival_s, on=on != 0.0)
        if self._sampled_s is None:
            return False
        self._came.add(name)
        refused = [one.quantity for one in status.sources if one.quantity not in values]
        self._values.keep(values, self._sampled_s, refused)
        if self.missing:
            return False
        self._newest = self._values.reading(arrival_s, set_s=self._sampled_s) or self._newest
        self.begin(None)
        if not self._values.refused:
            self._refused, self._repeated = 0, ""
        return True

    def hand_out(self) -> Reading | None:
        """Return the newest reading once, None where none has come since the one before."""
        reading, self._newest = self._newest, None
        if reading is not None:
            self.faults.clear(reading.fault)
        return reading

    def explain(self) -> str:
        """Return the PDO that is missing for a reading, or the value, and the likeliest cause."""
        refused, missing = ", ".join(sorted(self._values.refused)), ", ".join(self.missing)
        if refused:
            return f"no value of {refused} that may be used: {self._why}"
        return f"no complete set of PDOs: {missing} has not come since the last SYNC: {self._why}"

    @property
    def _why(self) -> str:
        """The likeliest cause, by what has come since the last complete set."""
        if self._refused:
            refused = f"{self._refused} PDOs were refused for their length or range"
            return f"{refused}: is the EDS the drive's own?"
        if self._repeated:
            twice = f"{self._repeated} came twice before the others"
            return f"{twice}: look for a gateway that repeats it, and for another node with this id"
        return "is SYNC on the bus, and the node operational?"

    def forget(self) -> None:
        """Await a report of the bridge: the node was lost, or is set up again."""
        self.begin(None)
        self._newest = None
        self._values.forget(binding.BRIDGE)

    def _note_bridge(self, came_s: float, *, on: bool) -> None:
        """Report the bridge; a PDO that comes again, or without a SYNC, may be an old one."""
        if self._sampled_s is None:
            self._monitor.hint(on=on, came_s=came_s)
        else:
            self._monitor.report(on=on, asked_s=self._sampled_s, came_s=came_s)

    def _follow(self, status: StatusFrame, found: Mapping[str, float]) -> dict[str, float]:
        """Follow statusword and faults of a PDO; return its values by quantity."""
        values = status.quantities(found)
        self.faults.see(values)
        statusword = found.get(_STATUSWORD)
        if statusword is not None:
            self._control.follow(int(statusword))
            values[binding.BRIDGE] = float(self._control.state in profile.POWERED)
        return values


# Parts that a port which drives a node, and one that only looks at it, have in common.


class NodePort(bus.CountingPort, ABC):
    """One connection to one node.

    Attributes:
        description: The bus in one phrase, such as `socketcan can0 node 5`.
        monitor: What the port has seen of the drive.
    """

    def __init__(
        self,
        config: CanOpenBus,
        mapping: CanOpenMapping,
        timing: Timing,
        clock: Callable[[], float],
    ) -> None:
        """Prepare for the node; nothing is opened yet.

        Args:
            config: `[bus]`.
            mapping: Which object is which quantity.
            timing: Times of the drive.
            clock: Monotonic clock, in seconds.
        """
        super().__init__()
        self.description = f"{describe_bus(config)} {sdo.describe_node(config)}"
        self.monitor = Monitor(timing, clock)
        self._config = config
        self._mapping = mapping
        self._clock = clock
        self._arrivals = integrity.ArrivalClock(clock)
        self._connection = connection.CanConnection[port.Listener](
            config, self, self._arrivals, self._counts
        )
        self._connection.description = self.description
        self._sdo = sdo.SdoLink(config, self._connection.put)
        self._takers: dict[int, Callable[[can.Message], None]] = {
            0x580 + config.node_id: self._sdo.take_reply
        }

    async def run(self, listener: port.Listener, opened: Callable[[], None]) -> None:
        """Open the bus, call `opened`, and serve it until cancelled; reconnect when it is lost.

        A drive that is not there yet is waited for, like one that is switched off.

        Args:
            listener: Receiver of readings and of the state of the bus.
            opened: Called once, when the bus is open.

        Raises:
            BusError: The bus cannot be opened at the first attempt.
        """
        await self._connection.run(self._takers, self._serve, listener, opened)

    def take(self, frame: can.Message) -> None:
        """Take one frame from the bus."""
        self._counts["received"] += 1
        odd = frame.is_extended_id or frame.is_error_frame or frame.is_remote_frame
        taker = None if odd else self._takers.get(frame.arbitration_id)
        if taker is None:
            self._counts["foreign"] += 1
        else:
            taker(frame)

    @abstractmethod
    async def _serve(self, announce: Callable[[], None]) -> str:
        """Use the open bus until it is lost; return the reason."""


# The daemon as NMT master of one node: bringing it up, watching it, sending SYNC.

NMT = 0x000
_START, _PRE_OPERATIONAL = 0x01, 0x80

_RETRY_S = 2.0
"""Wait before a node that did not answer, or refused, is asked again; its boot-up ends the wait."""

_STARTED_S = 1.0
"""Longest time from the start of a node to a heartbeat that confirms it."""

_LOOK_AGAIN_S = 0.002
"""Wait before a heartbeat is called lost: one that came while the loop was busy is read meanwhile,
whatever loop it is and whether it looks at timers or at sockets first."""

_TAKING_S = 0.05
"""Time that a lost node has for the safe command before it is made pre-operational, where it takes
none: several commands, and several of its cycles."""


BOOT_UP, OPERATIONAL = 0, 5
"""States of a node in its heartbeat."""


class Master:
    """Brings one node up and keeps watch over it.

    Attributes:
        ready: Whether the node is set up and operational.
        mapped: Whether it has been set up on this bus and not restarted since: its RPDOs are known.
        overwritten: Whether another sender has written an object of it since its set-up began: it
            may have changed what was set up.
        problem: Why it is not.
    """

    def __init__(
        self,
        bus: CanOpenBus,
        set_up: Callable[[], Awaitable[None]],
        send: Callable[[int, bytes], bool],
        clock: Callable[[], float],
    ) -> None:
        """Prepare for the node; nothing is sent yet.

        Args:
            bus: `[bus]`.
            set_up: Sets the node up; it is in state pre-operational then.
            send: Puts a frame on the bus.
            clock: Monotonic clock in seconds.
        """
        self._bus = bus
        self._set_up = set_up
        self._send = send
        self._clock = clock
        self._beat = asyncio.Event()
        self._beat_s = 0.0
        self._state: int | None = None
        self._booted = False
        self.ready = self.mapped = self.overwritten = False
        self.problem = Trip(TripKind.NODE_LOST, "not heard yet")

    async def run(
        self, report: Callable[[Trip | None], None], is_quiet: Callable[[], bool]
    ) -> None:
        """Bring the node up whenever it is lost, until cancelled.

        Args:
            report: Called with None when the node is ready, and with the reason whenever it is not.
            is_quiet: Returns whether other senders leave the node alone: only then is one that
                they have written to set up again.
        """
        while True:
            try:
                await self._bring_up()
            except BusError as refusal:
                self._lose(TripKind.NODE_LOST, refusal.problem)
                report(self.problem)
                await self._await(_RETRY_S, lambda: self._booted)
                continue
            self.ready = True
            report(None)
            await self._watch(is_quiet)
            report(self.problem)
            if self.mapped:
                await asyncio.sleep(_TAKING_S)

    def note_state(self, state: int) -> None:
        """Take a heartbeat or a boot-up message."""
        self._beat_s = self._clock()
        self._state = state
        if state == BOOT_UP:
            self._booted, self.mapped = True, False
        if self.ready and state != OPERATIONAL:
            if self._booted:
                self._lose(TripKind.NODE_RESTARTED, "has been restarted")
            else:
                left = f"is not operational any more (state {state})"
                self._lose(TripKind.NOT_OPERATIONAL, left)
        self._beat.set()

    def leave(self, problem: str) -> None:
        """The bus is gone, and the node with it."""
        self._lose(TripKind.NODE_LOST, problem)
        self.mapped = False

    def _lose(self, kind: TripKind, problem: str) -> None:
        self.ready, self.problem = False, Trip(kind, problem)

    async def _bring_up(self) -> None:
        """Set the node up and start it.

        Raises:
            BusError: It does not answer or refuses.
        """
        self._booted = self.overwritten = False
        self._command(_PRE_OPERATIONAL)
        await self._set_up()
        if self._booted:
            raise BusError(sdo.describe_node(self._bus), "was restarted while it was set up")
        self.mapped = True
        self._command(_START)
        await self._await(_STARTED_S + self._bus.heartbeat_s, self._has_started)
        if not self._has_started():
            raise BusError(sdo.describe_node(self._bus), "does not become operational")

    def _has_started(self) -> bool:
        return self._state == OPERATIONAL and not self._booted

    async def _watch(self, is_quiet: Callable[[], bool]) -> None:
        """Wait until the node is lost."""
        timeout_s = self._bus.heartbeat_timeout_s
        while self.ready:
            beat_s = self._beat_s
            silent_s = self._clock() - beat_s
            if self.overwritten and is_quiet():
                written = "is set up again: another sender has written its objects"
                self._lose(TripKind.OBJECTS_WRITTEN, written)
            elif silent_s <= timeout_s:
                self._beat.clear()
                await self._await(timeout_s - silent_s + 0.001, self._beat.is_set)
            else:
                await asyncio.sleep(_LOOK_AGAIN_S)
                if beat_s == self._beat_s:
                    silent = f"heartbeat lost for {1e3 * silent_s:.0f} ms"
                    self._lose(TripKind.HEARTBEAT_LOST, silent)

    async def _await(self, limit_s: float, done: Callable[[], bool]) -> None:
        """Wait for heartbeats until something is done, no longer than a limit in s."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(limit_s):
                while not done():
                    self._beat.clear()
                    await self._beat.wait()

    def _command(self, command: int) -> None:
        self._state = None
        self._send(NMT, bytes((command, self._bus.node_id)))
