"""Faults that a drive reports, and checks that it has not stopped, obeys, and has one master.

A drive that stopped while nothing came from it is not energised afterwards. One that does not
obey the safe command must not be kept from stopping by itself, by commands or by heartbeats; how it
is kept from that is a matter of its bus. Two masters must not drive one load.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import reduce
from operator import or_

from adaptdrive.safety.interlocks import fault_trip
from adaptdrive.safety.trips import Trip, TripKind

# Keeps faults and warnings from the frames that show them until a reading has carried them.


@dataclass(frozen=True, slots=True)
class FaultWord:
    """One watched word of a drive.

    Attributes:
        label: Name of its signal for the trip.
        mask: Bits that are watched, -1 for all.
        names: What the drive's description calls its faults, by word or bit.
        healthy: Words besides 0 that are no faults; all others then are codes.
        warns: Whether they are warnings, which trip nothing.
        code_of: Quantity of the word whose faults this one has the codes of; it trips nothing.
    """

    label: str
    mask: int
    names: Mapping[int, str]
    healthy: frozenset[int] = frozenset()
    warns: bool = False
    code_of: str = ""

    @property
    def lists_codes(self) -> bool:
        """True where a word is a code, not a set of bits."""
        states = self.healthy or self.code_of
        return bool(states) or any(word & (word - 1) for word in self.names)

    @property
    def may_be_code(self) -> bool:
        """True also where nothing says that a word is a set of bits."""
        return self.lists_codes or (self.mask == -1 and not self.names)

    def name(self, word: int) -> str:
        """Return the signal, and the word's name, its number, or its bits with their names."""
        if self.lists_codes:
            return f"{self.label} {self.names.get(word, word)}"
        bits = (bit for bit in range(word.bit_length()) if word >> bit & 1)
        named = (f"bit {bit} {self.names.get(1 << bit, '')}".rstrip() for bit in bits)
        listed = ", ".join(named)
        return f"{self.label} {word} ({listed})" if self.may_be_code else f"{self.label} {listed}"


class FaultLatch:
    """The faults seen since the last reading: a frame that is lost must not hide them.

    Bits add up. What may be codes does not, as two of them would make a third: the first is kept.
    """

    def __init__(self, words: Mapping[str, FaultWord]) -> None:
        """See nothing yet.

        Args:
            words: Watched words of the drive, by quantity.
        """
        self._words = words
        self._codes = {name for name, word in words.items() if word.may_be_code}
        watched = {name: word for name, word in words.items() if not word.code_of}
        self._seen = {name: 0 for name, word in watched.items() if not word.warns}
        self._warned = {name: 0 for name, word in watched.items() if word.warns}
        self._codes_of: dict[str, str] = {}

    @property
    def word(self) -> int:
        """All bits of faults, or the first code, 0 for none."""
        return reduce(or_, self._seen.values(), 0)

    def see(self, values: Mapping[str, float]) -> None:
        """Keep the watched words among some values, by quantity."""
        for name, known in self._words.items():
            value = values.get(name)
            if value and known.code_of:
                self._codes_of[known.code_of] = f", {known.name(int(value))}"
            elif value:
                word, seen = int(value) & known.mask, self._warned if known.warns else self._seen
                if word not in known.healthy and not (name in self._codes and seen[name]):
                    seen[name] |= word

    def clear(self, carried: int) -> None:
        """Forget what a reading has carried; a fault seen after it was composed stays.

        Args:
            carried: The reading's fault word.
        """
        for quantity, word in self._seen.items():
            if quantity not in self._codes:
                self._seen[quantity] = word & ~carried
            elif carried == word or (len(self._seen) > 1 and not word & ~carried):
                self._seen[quantity] = 0
        self._warned = dict.fromkeys(self._warned, 0)
        self._codes_of.clear()

    @property
    def name(self) -> str:
        """The names of the faults that were seen, empty for none."""
        return self._named(self._seen)

    @property
    def warning(self) -> str:
        """The names of the warnings that were seen, empty for none."""
        return self._named(self._warned)

    def _named(self, seen: Mapping[str, int]) -> str:
        named = [
            self._words[one].name(word) + self._codes_of.get(one, "")
            for one, word in seen.items()
            if word
        ]
        return ", ".join(named)

    @property
    def trip_cause(self) -> Trip | None:
        """Faults that no reading has carried yet."""
        word = self.word
        return fault_trip(word, self.name) if word else None


# Whether a drive has stopped, whether it obeys, and whether others command it.

_STOPPED = "drive stopped: its bridge is off although it was commanded on"

LOST = "the bus was lost meanwhile"
LEAPT = "its alive counter leapt meanwhile: it may have started anew"
UNANSWERED = "a read had no answer meanwhile"
UNREAD = "no poll gave a reading meanwhile"

QUIET_S = 5.0
"""Time without a foreign command until the drive may be energised. A sender commands its drive
many times in it, as every drive has a time-out far shorter than this."""


class Relink:
    """A drive that was on when its bus was lost or fell silent, until the next reading.

    The drive may have stopped by its own time-out meanwhile, or have started anew. A command that
    has the bridge on waits for the reading. If that has the bridge off and the last one before the
    loss had it on, the drive is not driven on; one that was about to start may continue.
    """

    def __init__(self) -> None:
        """Begin without a connection, and without a command."""
        self._commanded = False
        self._was_on = False
        self._reported_on = False
        self._stopped = False
        self._how = LOST

    @property
    def trip_cause(self) -> Trip | None:
        """Reason not to energise the drive, None for none."""
        return Trip(TripKind.DRIVE_STOPPED, f"{_STOPPED}; {self._how}") if self._stopped else None

    def open(self, *, bridge: bool, how: str = LOST, reported_on: bool = False) -> None:
        """Begin a connection, or a silence of one.

        Args:
            bridge: Whether the last command that reached the drive had the bridge on.
            how: Why nothing comes from the drive.
            reported_on: Whether its last report, also one that no reading carries, has it on.
        """
        # the earlier cause is the more specific one
        if not (self._was_on and how in {UNREAD, LEAPT}):
            self._how = how
        self._was_on = self._commanded and (self._was_on or bridge)
        self._reported_on = self._reported_on or reported_on

    def note_reading(self, *, bridge: bool) -> None:
        """Note a reading.

        Args:
            bridge: Whether it has the bridge on.
        """
        self._stopped = self._stopped or (self._was_on and self._reported_on and not bridge)
        self._was_on, self._reported_on = False, bridge

    def note_command(self, *, bridge: bool, safe: bool) -> None:
        """Note a command, sent or not; the safe one ends what was driven.

        Args:
            bridge: Whether it has the bridge on.
            safe: Whether it is the safe command.
        """
        self._commanded = bridge
        if safe:
            self._stopped = self._was_on = False

    def admits(self, *, bridge: bool) -> bool:
        """Return whether a command may be sent.

        Args:
            bridge: Whether it has the bridge on.
        """
        return not (bridge and (self._was_on or self._stopped))


class Obedience:
    """Times the safe command in force from when the drive may first have received it.

    Attributes:
        since_s: That time by the monotonic clock, infinite while no safe command is in force.
    """

    def __init__(self, limit_s: float, clock: Callable[[], float]) -> None:
        """Note no command yet.

        Args:
            limit_s: Time that the drive has to obey, `Timing.obeyed_s`.
            clock: Monotonic clock, in s.
        """
        self._limit_s = limit_s
        self._clock = clock
        self.since_s = math.inf

    @property
    def awaited(self) -> bool:
        """True while a safe command is in force."""
        return self.since_s < math.inf

    def note_safe(self) -> None:
        """Note that the drive may receive the safe command now; the first time counts."""
        if self.since_s == math.inf:
            self.since_s = self._clock()

    def forget(self) -> None:
        """Note another command, or the loss of a bus on which nothing shows what it received."""
        self.since_s = math.inf

    def overdue_s(self, *, powered: bool) -> float:
        """Return for how long a drive has not obeyed the safe command, negative while it may yet.

        Args:
            powered: Whether its last report, also one of a link before, has it energised.
        """
        return self._clock() - self.since_s - self._limit_s if powered else -math.inf


class OtherSender:
    """Remembers the last command frame on the bus that this process has not sent."""

    def __init__(self, clock: Callable[[], float]) -> None:
        """Start without another sender.

        Args:
            clock: Monotonic clock, in seconds.
        """
        self._clock = clock
        self._frame = ""
        self._count = 0
        self._came_s = -math.inf

    def note(self, frame: str) -> None:
        """Note a foreign command frame.

        Args:
            frame: The frame's id and name, as text.
        """
        now_s = self._clock()
        self._count = 1 if now_s - self._came_s > QUIET_S else self._count + 1
        self._frame, self._came_s = frame, now_s

    @property
    def trip_cause(self) -> Trip | None:
        """Reason not to energise the drive, None without a recent foreign command."""
        age_s = self._clock() - self._came_s
        if age_s > QUIET_S:
            return None
        return Trip(
            TripKind.OTHER_SENDER,
            f"another sender commands this drive: {self._count} x frame {self._frame}, the last "
            f"{age_s:.1f} s ago; end the other daemon, PLC or tool: the bus must be free of its "
            f"commands for {QUIET_S:g} s",
        )
