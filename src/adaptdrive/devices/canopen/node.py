"""A node as it is seen: its status PDOs as readings, and a node that is only looked at.

The values of a set were measured at the same moment; in place of one that must not be used stands
the last good one. A PDO that comes again before the others have ends the set, and one without a
SYNC since the last reading begins none: repeated PDOs make no readings of their own.
"""

import asyncio
import math
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Mapping

import can

from adaptdrive.config.bus import CanOpenBus
from adaptdrive.control.signals import Command
from adaptdrive.devices import binding, bus, port
from adaptdrive.devices.can import connection, integrity
from adaptdrive.devices.can.bus import describe_bus
from adaptdrive.devices.canopen import dictionary, profile, sdo
from adaptdrive.devices.canopen.mapping import CanOpenMapping, StatusPdo
from adaptdrive.util.errors import BusError

# The drive's status PDOs as readings: the set after one SYNC, and the newest of several sets.

_STATUSWORD = dictionary.label(profile.STATUSWORD)


def newest_values(mapping: CanOpenMapping) -> port.NewestValues:
    """Return the values of a drive, none of which is known yet."""
    slacks = dict.fromkeys([binding.BRIDGE, *(one.quantity for one in mapping.sources)], 0.0)
    return port.NewestValues(slacks, binding.other_names(mapping.sources), mapping.faults)


class Reports:
    """Collects status PDOs, and keeps the newest reading until it is handed out.

    Attributes:
        faults: Faults that no reading has carried yet.
    """

    def __init__(
        self,
        mapping: CanOpenMapping,
        control: profile.DriveControl,
        counts: Counter[str],
    ) -> None:
        """Expect PDOs; none has come yet.

        Args:
            mapping: PDOs of a reading, and fault words of the drive.
            control: Follows the statusword.
            counts: Counts of the port, to which refused PDOs are added.
        """
        self._values = newest_values(mapping)
        self.faults = self._values.faults
        self._statuses = {status.codec.name: status for status in mapping.statuses}
        self._control = control
        self._counts = counts
        self._came: set[str] = set()
        self._sampled_s: float | None = None
        self._repeated = ""
        self._refused = 0
        self._newest: port.Reading | None = None

    @property
    def missing(self) -> list[str]:
        """Names of the PDOs that have not come since the last SYNC."""
        return [name for name in self._statuses if name not in self._came]

    def begin(self, sampled_s: float | None) -> None:
        """Begin a set: a SYNC has passed, and the drive measures now; None to end one."""
        self._came.clear()
        self._sampled_s = sampled_s

    def take(self, status: StatusPdo, data: bytes, arrival_s: float) -> bool:
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
        values = self._follow(status, found, arrival_s)
        if name in self._came:
            self.begin(None)
            self._repeated = name
        if self._sampled_s is None:
            return False
        self._came.add(name)
        carried = (source.quantity for source in status.sources)
        refused = [quantity for quantity in carried if quantity not in values]
        self._values.keep(values, self._sampled_s, refused)
        if self.missing:
            return False
        self._newest = self._values.reading(arrival_s, set_s=self._sampled_s) or self._newest
        self.begin(None)
        if not self._values.refused:
            self._refused, self._repeated = 0, ""
        return True

    def hand_out(self) -> port.Reading | None:
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

    def _follow(
        self, status: StatusPdo, found: Mapping[str, float], arrival_s: float
    ) -> dict[str, float]:
        """Follow statusword and faults of a PDO; return its values by quantity."""
        values = {
            one.quantity: found[one.item.label] * one.scale + one.offset
            for one in status.sources
            if one.item.label in found
        }
        self.faults.see(values)
        statusword = found.get(_STATUSWORD)
        if statusword is not None:
            self._control.follow(int(statusword), arrival_s)
            values[binding.BRIDGE] = float(self._control.state in profile.POWERED)
        return values


# A node that is only looked at, and what it has in common with one that is driven.

# Parts that a port which drives a node, and one that only looks at it, have in common.


class NodePort(bus.CountingPort, ABC):
    """One connection to one node.

    Attributes:
        description: The bus in one phrase, such as `socketcan can0 node 5`.
    """

    def __init__(
        self, config: CanOpenBus, mapping: CanOpenMapping, clock: Callable[[], float]
    ) -> None:
        """Prepare for the node; nothing is opened yet.

        Args:
            config: `[bus]`.
            mapping: Which object is which quantity.
            clock: Monotonic clock, in seconds.
        """
        super().__init__()
        self.description = f"{describe_bus(config)} {sdo.describe_node(config)}"
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


# Looking at a drive without touching it: its objects are read over SDO, nothing is written.

_PAUSE_S = 0.2
"""Pause between two readings: five lines a second are as many as can be read."""


class CanOpenWatch(NodePort):
    """Read-only port to one drive: it sends no command and leaves the node unchanged."""

    complaint = None
    """None: this port cannot energise the drive."""

    safe_s = math.inf
    """Never: nothing is commanded."""

    def send(self, command: Command) -> bool:  # noqa: ARG002 - what a port takes
        """Send nothing."""
        self._counts["send_drops"] += 1
        return False

    def explain_age(self) -> str:
        """Name nothing: nothing is driven from here."""
        return ""

    async def _serve(self, announce: Callable[[], None]) -> str:
        """Read the drive until the bus is lost; return the reason."""
        announce()
        return await self._connection.read_beside(self._look(), "look")

    async def _look(self) -> None:
        """Read all objects at intervals; report when the drive stops or resumes its replies."""
        while True:
            start_s = self._clock()
            try:
                values = await self._sdo.run(self._read)
            except BusError as problem:
                self._counts["timeouts"] += 1
                self._connection.report(up=False, detail=problem.problem)
            else:
                self._connection.report(up=True)
                self._pass_on(values, start_s)
            await asyncio.sleep(_PAUSE_S)

    def _read(self, server: sdo.Server) -> dict[str, float]:
        """Every quantity, and whether the bridge is on by the drive's state."""
        values = {
            one.quantity: server.value(one.item) * one.scale + one.offset
            for one in self._mapping.sources
        }
        return values | {
            binding.BRIDGE: float(
                profile.state_of(server.number(profile.STATUSWORD)) in profile.POWERED
            )
        }

    def _pass_on(self, values: dict[str, float], start_s: float) -> None:
        newest, listener = newest_values(self._mapping), self._connection.listener
        newest.keep(values, start_s)
        reading = newest.reading(self._clock(), set_s=start_s)
        if listener is not None and reading is not None:
            listener.on_reading(reading)
