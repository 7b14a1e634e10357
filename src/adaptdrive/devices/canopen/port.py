"""The port of a CiA 402 drive on CANopen, and how the daemon builds it.

A reading is what the drive's PDOs carry after one SYNC, as old as that SYNC; of readings that piled
up while the process did not run, only the newest is handed out. A command is a
controlword and the commanded values. The daemon's heartbeat goes out with commands only: a daemon
that commands no more, or whose node is lost, falls silent, and the drive makes itself safe. So does
one whose drive does not obey the safe command. A lost node gets the safe command alone.
"""

import asyncio
import functools
import math
from collections.abc import Callable, Iterator
from pathlib import Path

import can

from adaptdrive.config import Configuration
from adaptdrive.config.bus import CanOpenBus
from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.devices import binding, description
from adaptdrive.devices.bus import BusKind, Row, bus_of, stale_limits
from adaptdrive.devices.can.assembly import StatusFrame
from adaptdrive.devices.can.integrity import PROMPT_S
from adaptdrive.devices.canopen import node, profile, sdo
from adaptdrive.devices.canopen.mapping import WORD, CanOpenMapping, map_drive
from adaptdrive.safety.monitor import Verdict
from adaptdrive.safety.timing import Timing, timing_of
from adaptdrive.safety.trips import Trip, TripKind
from adaptdrive.util.clock import pulsing
from adaptdrive.util.errors import BusError, Flaw

# The port of a CiA 402 drive on CANopen.

_FAULT_RESET_S = 1.0
"""Longest wait for a drive to leave its fault."""

_SDO_WRITES = frozenset({0, 1, 6})
"""Client command specifiers of SDO frames that write: segment, initiate and block download."""

_WRITTEN = "another sender has written its objects: it is set up again when that is quiet"
_NOT_YET = "not known yet"
_UNFIT = frozenset({None, profile.DriveState.UNKNOWN, profile.DriveState.NOT_READY})

_LOOK_S = 0.005
"""Time between two looks whether the fault is gone: short compared with the longest wait."""


class Port(node.NodePort):
    """One connection to one drive on CANopen."""

    def __init__(
        self,
        config: CanOpenBus,
        mapping: CanOpenMapping,
        timing: Timing,
        clock: Callable[[], float],
    ) -> None:
        """Prepare for the drive; nothing is opened yet."""
        super().__init__(config, mapping, timing, clock)
        self.counter_modulus = mapping.counter_modulus
        self._control = profile.DriveControl()
        self._reports = node.Reports(mapping, self._control, self.monitor, self._counts)
        self._master = node.Master(config, self._set_up, self._connection.put, clock)
        self._emergency: profile.Emergency | None = None
        self._half_cycle_s = timing.half_cycle_s
        self._beat_s = -math.inf
        self._been_up = False
        self._takers |= self._make_takers()
        self._connection.caught_up = self.hand_out

    @property
    def trip_cause(self) -> Trip | None:
        """Reason not to energise the drive, None for no reason."""
        for seen in (self.monitor, self._reports.faults, self._connection):
            if seen.trip_cause is not None:
                return seen.trip_cause
        if self._connection.bus is None and self._control.fallen is None:
            return None  # without a bus there are no readings, which is a separate cause
        problem = self._problem_of_node()
        return problem and Trip(problem.kind, f"{sdo.describe_node(self._config)}: {problem}")

    def _problem_of_node(self) -> Trip | None:
        """Return the most telling thing that is wrong with the node, None when nothing is.

        `reset` does not end the emergency of a node that is not ready: the reason follows it then.
        """
        control, master = self._control, self._master
        if self._emergency is not None:
            more = "" if master.ready else f"; not ready: {master.problem}"
            return Trip(TripKind.EMERGENCY, f"{self._emergency}{more}")
        if control.fallen is not None:
            return control.fallen
        if not master.ready:
            return master.problem
        if master.overwritten:
            return Trip(TripKind.OBJECTS_WRITTEN, _WRITTEN)
        if not (control.faulty or control.state in _UNFIT):
            return None
        return Trip(TripKind.STATE_UNFIT, f"the drive's state is {control.state or _NOT_YET}")

    def send(self, command: Command) -> bool:
        """Send one command now, and the daemon's heartbeat when it is due.

        Args:
            command: Command to the drive; it must have passed the guard.

        Returns:
            Whether the bus took it; False is counted, and nothing is sent again. It is False, too,
            for a node that is lost, although the safe command is sent to it.

        Raises:
            ValueError: A value is not finite, or its object cannot hold it; nothing is sent.
        """
        word = self._control.controlword(command)
        frames = self._frames(command, word)
        self.monitor.command(command)
        if not self._master.ready:
            self._counts["send_drops"] += 1
            if command == SAFE_COMMAND:
                self._disable_lost()
            return False
        taken = [self._connection.put(*frame) for frame in frames]
        self._connection.note_command(taken=all(taken))
        if not all(taken):
            return False
        self.monitor.take(command)
        if self.monitor.verdict is not Verdict.DISOBEYS:
            self._beat()
        return True

    def _frames(self, command: Command, word: int) -> list[tuple[int, bytes]]:
        """Return the ids and the bytes of the frames of a command with a controlword."""
        orders, words = self._mapping.orders, {WORD: float(word)}
        return [(one.codec.frame_id, one.encode(command, words)) for one in orders]

    def catch_up(self) -> None:
        """Process the frames that have arrived, but were not read yet."""
        self._connection.catch_up()

    def explain_age(self) -> Trip:
        """Return the PDO that is missing for a reading, and the likeliest cause."""
        return Trip(TripKind.STALE, self._reports.explain())

    def details(self) -> list[str]:
        """Return the missing PDOs of the node."""
        return [self.explain_age().text] if self._reports.missing else []

    async def reset_fault(self) -> None:
        """Have the drive leave its fault by an edge of the reset bit; ends in a second at most.

        A drive that is in no fault any more has its emergency forgotten, too.
        """
        if not self._master.ready:
            return
        self._control.ask_reset()
        deadline_s = self._clock() + _FAULT_RESET_S
        while self._control.faulty and self._clock() < deadline_s:  # noqa: ASYNC110 - a frame
            await asyncio.sleep(_LOOK_S)
        if not self._control.faulty:
            self._emergency = None

    def _make_takers(self) -> dict[int, Callable[[can.Message], None]]:
        """Return the handler of each frame.

        No bus returns the frames that this port sends: another sender commands the drive with the
        same. Its heartbeat under the daemon's own id does, too: the drive would obey its last
        command for as long as that node lives, however long ago this daemon has died. Its SYNC
        would let control run too fast. NMT is no command: a node that it stops or restarts reports
        that itself.
        """
        its_id, own_id, taken_by = self._config.node_id, self._config.own_node_id, functools.partial
        another = taken_by(self._take_foreign_command, "SYNC of another node")
        takers: dict[int, Callable[[can.Message], None]] = {
            sdo.SYNC_COB_ID: self._take_sync if self._config.sync == "drive" else another,
            0x080 + its_id: self._take_emergency,
            0x600 + its_id: self._take_sdo_request,
            0x700 + its_id: self._take_heartbeat,
            0x700 + own_id: taken_by(
                self._take_foreign_command, "heartbeat of another node with bus.own_node_id"
            ),
        }
        for status in self._mapping.statuses:
            takers[status.codec.frame_id] = taken_by(self._take_pdo, status)
        for order in self._mapping.orders:
            takers[order.codec.frame_id] = taken_by(self._take_foreign_command, order.codec.name)
        return takers

    def _take_foreign_command(self, name: str, frame: can.Message) -> None:
        self._counts["foreign"] += 1
        self._counts["foreign_commands"] += 1
        self.monitor.note_foreign(f"0x{frame.arbitration_id:03X} ({name})")

    def _take_sdo_request(self, frame: can.Message) -> None:
        """Note that another sender writes an object; one that reads objects does no harm."""
        if frame.data and frame.data[0] >> 5 in _SDO_WRITES:
            self._take_foreign_command("SDO write", frame)
            self._master.overwritten = True
        else:
            self._counts["foreign"] += 1

    def _take_sync(self, frame: can.Message) -> None:
        self._reports.begin(self._clock() - self._arrivals.waited_s(frame))

    def _take_heartbeat(self, frame: can.Message) -> None:
        if not frame.data:
            self._counts["wrong_length"] += 1
            return
        state = frame.data[0] & 0x7F
        if state == node.BOOT_UP:
            self._emergency = None
        self._master.note_state(state)

    def _take_emergency(self, frame: can.Message) -> None:
        emergency = profile.parse_emergency(bytes(frame.data))
        if emergency is None:
            self._counts["wrong_length"] += 1
        elif emergency.over:
            self._emergency = None
        else:
            self._emergency = emergency
            self._control.fall(Trip(TripKind.EMERGENCY, str(emergency)))

    def _take_pdo(self, status: StatusFrame, frame: can.Message) -> None:
        if not self._master.ready:
            return  # whatever it carries, it is not what the drive has been set up for
        waited_s = self._arrivals.waited_s(frame)
        whole = self._reports.take(status, bytes(frame.data), self._clock() - waited_s)
        if whole and frame.timestamp and waited_s < PROMPT_S:
            self.hand_out()

    def hand_out(self) -> None:
        """Pass the newest reading on: no more frames wait."""
        listener = self._connection.listener
        if listener is not None and (reading := self._reports.hand_out()) is not None:
            self._connection.note_reading()
            listener.on_reading(reading)

    async def _set_up(self) -> None:
        half_s = self._half_cycle_s
        await self._sdo.run(lambda server: sdo.set_up(server, self._config, self._mapping, half_s))

    def _send_sync(self) -> None:
        self.catch_up()  # what waits belongs to the SYNC before
        if self._master.ready:
            self._reports.begin(self._clock())
            self._connection.put(sdo.SYNC_COB_ID, b"")

    def _disable_lost(self) -> None:
        """Send the safe command, and no heartbeat, to a lost node that may still take it."""
        if self._master.mapped:
            for frame in self._frames(SAFE_COMMAND, profile.DISABLE_VOLTAGE):
                self._connection.put(*frame)

    def _beat(self) -> None:
        """Send the daemon's heartbeat where the next command would be too late for it."""
        now_s = self._clock()
        if now_s - self._beat_s > self._config.heartbeat_s - self._half_cycle_s:
            self._beat_s = now_s
            self._connection.put(0x700 + self._config.own_node_id, bytes((node.OPERATIONAL,)))

    async def _serve(self, announce: Callable[[], None]) -> str:
        """Use the open bus until it is lost; return the reason."""
        syncs = [self._send_sync] if self._config.sync == "daemon" else []
        try:
            with pulsing(self._half_cycle_s, *syncs):
                announce()
                node = self._master.run(self._report_node, lambda: self.monitor.trip_cause is None)
                return await self._connection.read_beside(node, "node")
        except Exception:
            self.send(SAFE_COMMAND)  # the last frame, whatever has gone wrong
            raise
        finally:
            self._master.leave("bus lost")
            self._on_node(self._master.problem)

    def _report_node(self, problem: Trip | None) -> None:
        """Report that the node is ready, or why it is not."""
        if problem is None:
            self._counts["reconnects"] += self._been_up
            self._been_up = True
        else:
            self._disable_lost()
        self._on_node(problem)
        self._connection.report(up=problem is None, detail=str(problem or "operational"))

    def _on_node(self, problem: Trip | None) -> None:
        """Forget all values that were received before the node came up or was lost."""
        if problem is not None:
            self._control.fall(problem)
            self.monitor.lose()
        self._control.forget()
        self._reports.forget()


# Looking at a drive without touching it: its objects are read over SDO, nothing is written.

_PAUSE_S = 0.2
"""Pause between two readings: five lines a second are as many as can be read."""


class CanOpenWatch(node.NodePort):
    """Read-only port to one drive: it sends no command and leaves the node unchanged."""

    trip_cause = None
    """None: this port cannot energise the drive."""

    def send(self, command: Command) -> bool:  # noqa: ARG002 - what a port takes
        """Send nothing."""
        self._counts["send_drops"] += 1
        return False

    def explain_age(self) -> None:
        """Name nothing: nothing is driven from here."""

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
        state = profile.state_of(server.number(profile.STATUSWORD))
        return values | {binding.BRIDGE: float(state in profile.POWERED)}

    def _pass_on(self, values: dict[str, float], start_s: float) -> None:
        newest, listener = self._mapping.newest_values(), self._connection.listener
        newest.keep(values, start_s)
        reading = newest.reading(self._clock(), set_s=start_s)
        if listener is not None and reading is not None:
            listener.on_reading(reading)


# A CiA 402 drive on CANopen, as the daemon builds it.


def _build(
    configuration: Configuration, clock: Callable[[], float], source: Path | str, passive: bool
) -> Port | CanOpenWatch:
    bus, mapping = bus_of(configuration, CanOpenBus), mapped(configuration, source)
    if passive:
        return CanOpenWatch(bus, mapping, timing_of(configuration), clock)
    return Port(bus, mapping, timing_of(configuration), clock)


def mapped(configuration: Configuration, source: Path | str = "configuration") -> CanOpenMapping:
    """Return the objects of a drive, held against what its limits ask."""
    bus, demands = bus_of(configuration, CanOpenBus), description.demands_of(configuration)
    return map_drive(bus, configuration.signals, source, demands)


def _time_limits(configuration: Configuration, source: Path | str) -> Iterator[Row]:
    yield from stale_limits(configuration, source)
    timeout_s = bus_of(configuration, CanOpenBus).heartbeat_timeout_s
    yield "silent node", timeout_s, "bus.heartbeat_timeout_s"


def _cautions(configuration: Configuration) -> Iterator[Flaw]:
    """Yield what is doubtful in the EDS of the drive."""
    yield from mapped(configuration).cautions


CANOPEN = BusKind(_build, _cautions, time_limits=_time_limits)
