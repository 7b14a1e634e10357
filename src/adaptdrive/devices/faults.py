"""Keeps faults and warnings from the frames that show them until a reading has carried them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce
from operator import or_


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
        self._told: dict[str, str] = {}

    @property
    def word(self) -> int:
        """All bits of faults, or the first code, 0 for none."""
        return reduce(or_, self._seen.values(), 0)

    def see(self, values: Mapping[str, float]) -> None:
        """Keep the watched words among some values, by quantity."""
        for name, known in self._words.items():
            value = values.get(name)
            if value and known.code_of:
                self._told[known.code_of] = f", {known.name(int(value))}"
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
        self._told.clear()

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
            self._words[one].name(word) + self._told.get(one, "")
            for one, word in seen.items()
            if word
        ]
        return ", ".join(named)

    @property
    def complaint(self) -> str | None:
        """Faults that no reading has carried yet, as text."""
        word = self.word
        return describe_fault(word, self.name) if word else None


def describe_fault(word: int, name: str) -> str:
    """Return a fault in words.

    Args:
        word: The drive's fault word.
        name: Its name, empty for none.
    """
    coded = f"word {word:#x}"
    return f"drive fault: {name} ({coded})" if name else f"drive fault: {coded}"
