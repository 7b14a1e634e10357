"""The daemon as NMT master of one node: bringing it up, watching its state and its emergencies.

A node is set up in state pre-operational and started then. It is lost when it is restarted, leaves
the state operational, or its heartbeat stays away; it is then set up again. So is one whose objects
another sender has written, once that is quiet. The port is notified first, and a node that may
still take commands has time for the safe one.

Emergency (EMCY) frames in words: classes of CiA 301 by the library, single codes of CiA 402.
"""

import asyncio
import contextlib
from collections.abc import Awaitable, Callable

from canopen.emcy import EmcyError

from adaptdrive.config.bus import CanOpenBus
from adaptdrive.devices.canopen.profile import DriveControl, DriveState
from adaptdrive.devices.canopen.sdo import describe_node
from adaptdrive.util.errors import BusError

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
        self.problem = "not heard yet"

    async def run(
        self, report: Callable[[str | None], None], others_quiet: Callable[[], bool]
    ) -> None:
        """Bring the node up whenever it is lost, until cancelled.

        Args:
            report: Called with None when the node is ready, and with the reason whenever it is not.
            others_quiet: Returns whether other senders leave the node alone: only then is one that
                they have written to set up again.
        """
        while True:
            try:
                await self._bring_up()
            except BusError as refusal:
                self._lose(refusal.problem)
                report(self.problem)
                await self._await(_RETRY_S, lambda: self._booted)
                continue
            self.ready = True
            report(None)
            await self._watch(others_quiet)
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
            left = f"is not operational any more (state {state})"
            self._lose("has been restarted" if self._booted else left)
        self._beat.set()

    def leave(self, problem: str) -> None:
        """The bus is gone, and the node with it."""
        self._lose(problem)
        self.mapped = False

    def _lose(self, problem: str) -> None:
        self.ready, self.problem = False, problem

    async def _bring_up(self) -> None:
        """Set the node up and start it.

        Raises:
            BusError: It does not answer or refuses.
        """
        self._booted = self.overwritten = False
        self._command(_PRE_OPERATIONAL)
        await self._set_up()
        if self._booted:
            raise BusError(describe_node(self._bus), "was restarted while it was set up")
        self.mapped = True
        self._command(_START)
        await self._await(_STARTED_S + self._bus.heartbeat_s, self._has_started)
        if not self._has_started():
            raise BusError(describe_node(self._bus), "does not become operational")

    def _has_started(self) -> bool:
        return self._state == OPERATIONAL and not self._booted

    async def _watch(self, others_quiet: Callable[[], bool]) -> None:
        """Wait until the node is lost."""
        timeout_s = self._bus.heartbeat_timeout_s
        while self.ready:
            beat_s = self._beat_s
            silent_s = self._clock() - beat_s
            if self.overwritten and others_quiet():
                self._lose("is set up again: another sender has written its objects")
            elif silent_s <= timeout_s:
                self._beat.clear()
                await self._await(timeout_s - silent_s + 0.001, self._beat.is_set)
            else:
                await asyncio.sleep(_LOOK_AGAIN_S)
                if beat_s == self._beat_s:
                    self._lose(f"heartbeat lost for {1e3 * silent_s:.0f} ms")

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


# Conditions that prevent a node from being energised: its emergencies and its state.

_CODE_BYTES = 2
"""Least bytes of an emergency: some drives send the code alone, without register and detail."""

_SINGLE = {
    0x2310: "continuous over-current at the output",
    0x2320: "short circuit at the output",
    0x3110: "mains over-voltage",
    0x3120: "mains under-voltage",
    0x3130: "mains phase failure",
    0x3210: "DC link over-voltage",
    0x3220: "DC link under-voltage",
    0x4210: "excess temperature of the device",
    0x4310: "excess temperature of the drive",
    0x8130: "heartbeat of the daemon lost",
    0x8140: "recovered from bus off",
}

_UNFIT = frozenset({None, DriveState.UNKNOWN, DriveState.NOT_READY})


class Emergency(EmcyError):  # noqa: N818 - never raised
    """One emergency: the library's `code`, `register` 0x1001 and `data`, which the maker adds."""

    @property
    def over(self) -> bool:
        """True if the frame reports the end of all errors."""
        return self.code >> 8 == 0

    def __str__(self) -> str:
        words = _SINGLE.get(self.code) or self.get_desc().lower() or "unknown"
        more = "" if self.register < 0 else f" (error register 0x{self.register:02X})"
        return f"emergency 0x{self.code:04X}, {words}{more}"


def parse_emergency(data: bytes) -> Emergency | None:
    """Read an emergency frame.

    Args:
        data: Its bytes.

    Returns:
        The emergency, whose register is -1 where the frame ends before it; None for a frame
        without a whole code.
    """
    if len(data) < _CODE_BYTES:
        return None
    code, register = int.from_bytes(data[:_CODE_BYTES], "little"), (*data[2:3], -1)[0]
    return Emergency(code, register, data[3:], 0.0)


def problem_of(emergency: Emergency | None, control: DriveControl, master: Master) -> str | None:
    """Return the most telling thing that is wrong with a node, None when nothing is.

    `reset` does not end the emergency of a node that is not ready: the reason follows it then.
    """
    if emergency is not None:
        more = "" if master.ready else f"; not ready: {master.problem}"
        return f"{emergency}{more}"
    if control.fallen is not None:
        return control.fallen
    if not master.ready:
        return master.problem
    if master.overwritten:
        return "another sender has written its objects: it is set up again when that is quiet"
    if control.faulty or control.state in _UNFIT:
        return f"the drive's state is {control.state or 'not known yet'}"
    return None
