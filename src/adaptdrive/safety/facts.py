"""What a port has seen of a drive: its readings, and the faults among them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import reduce
from operator import or_

from adaptdrive.safety.trips import Trip, TripKind

# One complete set of values.


@dataclass(slots=True)
class Reading:
    """One complete set of drive quantities.

    Nobody changes one. It is not frozen: making a frozen one takes 1 µs longer, in every half
    cycle.

    Attributes:
        arrival_s: Arrival of the clocking frame, monotonic clock.
        oldest_s: Arrival of the oldest frame that a value of this reading was taken from.
        counter: The drive's half-cycle counter as sent (it wraps), None for a drive without one,
            and where the newest one must not be used.
        boost_voltage_V: Boost capacitor voltage.
        line_voltage_V: Line voltage, rms.
        load_power_W: Power into the load.
        output: Regulated quantity in its own unit.
        fault: Fault word of the drive, 0 when healthy.
        bridge: Whether the drive reports its bridge on.
        other: More values of the drive, and those of separate sensors, by name. A quantity
            that the drive does not give is NaN until a sensor or `[derived]` has given it.
        slack_s: How much older than `interlocks.stale_s` the frame of `oldest_s` may be, as the
            drive sends it less often. Of several frames, `oldest_s` and `slack_s` are those of the
            one that is out of date first.
        fault_name: What the drive's description calls the fault, an empty string for nothing.
        bridge_s: Arrival of the frame with the report of the bridge, None where that is `oldest_s`.
        whole: False while the drive sends a value that must not be used, so that an older one of
            its quantity is held.
        warning: The drive's warnings by signal, bit and name, an empty string for none.
        voltage_s: Time of the boost voltage, None where that is `oldest_s`.
    """

    arrival_s: float
    oldest_s: float
    counter: int | None
    boost_voltage_V: float
    line_voltage_V: float
    load_power_W: float
    output: float
    fault: int
    bridge: bool
    other: Mapping[str, float] = field(default_factory=dict)
    slack_s: float = 0.0
    fault_name: str = ""
    bridge_s: float | None = None
    whole: bool = True
    warning: str = ""
    voltage_s: float | None = None

    @property
    def bridge_reported_s(self) -> float:
        """Arrival of the report of the bridge, monotonic clock."""
        return self.oldest_s if self.bridge_s is None else self.bridge_s


def assuming(reading: Reading, voltage_V: float) -> Reading:
    """Return the reading of a drive that does not report what it was commanded to hold.

    Args:
        reading: Its values.
        voltage_V: V_c in force, which stands for v_bst.
    """
    return replace(reading, boost_voltage_V=voltage_V)


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


def fault_trip(word: int, name: str) -> Trip:
    """Return the trip for a fault of the drive.

    Args:
        word: The drive's fault word.
        name: Its name, empty for none.
    """
    coded = f"word {word:#x}"
    text = f"drive fault: {name} ({coded})" if name else f"drive fault: {coded}"
    return Trip(TripKind.DRIVE_FAULT, text)
