"""Keeps fault words from the frames that show them until a reading has carried them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

FAULT = "fault"
"""The quantity of `signals.fault`; those of `signals.faults` begin with it and a dot."""


@dataclass(frozen=True, slots=True)
class FaultWord:
    """One fault word of a drive.

    Attributes:
        label: Name of its signal for the trip; empty where the names alone are enough.
        mask: Bits that are faults, -1 for all.
        names: What the drive's description calls its faults, by word or bit.
        healthy: Words besides 0 that are no faults; all others then are codes.
    """

    label: str
    mask: int
    names: Mapping[int, str]
    healthy: frozenset[int] = frozenset()

    @property
    def lists_codes(self) -> bool:
        """True where a word is a code, not a set of bits."""
        return bool(self.healthy) or any(word & (word - 1) for word in self.names)

    def name(self, word: int) -> str:
        """Return the word's name, or the names of its bits; empty where there is none."""
        if self.lists_codes or (word in self.names and not self.label):
            found = [self.names.get(word, hex(word) if self.label else "")]
        else:
            found = [self._bit_name(bit) for bit in range(word.bit_length()) if word >> bit & 1]
        named = ", ".join(filter(None, found))
        return f"{self.label} {named}".strip() if named else ""

    def _bit_name(self, bit: int) -> str:
        name = self.names.get(1 << bit, "")
        return f"bit {bit} {name}".strip() if self.label else name


_PLAIN = FaultWord("", -1, {})


class FaultLatch:
    """The faults seen since the last reading: a frame that is lost must not hide them.

    Bits add up. Codes do not, as two of them would make a third: the first one is kept.
    """

    def __init__(self, words: Mapping[str, FaultWord] | None = None) -> None:
        """See nothing yet.

        Args:
            words: Fault words of the drive, by quantity; one without names where left out.
        """
        self._words = words or {FAULT: _PLAIN}
        self._codes = {name for name, word in self._words.items() if word.lists_codes}
        self._seen = dict.fromkeys(self._words, 0)

    @property
    def word(self) -> int:
        """All bits, or the first code, 0 for none."""
        found = 0
        for word in self._seen.values():
            found |= word
        return found

    def see(self, word: float | None, quantity: str = FAULT) -> None:
        """Keep a fault word, None where a frame carries none.

        Args:
            word: The word.
            quantity: Which of the drive's fault words it is.
        """
        known = self._words[quantity]
        found = int(word or 0) & known.mask
        if found not in known.healthy and not (quantity in self._codes and self._seen[quantity]):
            self._seen[quantity] |= found

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

    @property
    def name(self) -> str:
        """The names of the words that were seen; empty where there are none."""
        found = (self._words[one].name(word) for one, word in self._seen.items() if word)
        return ", ".join(filter(None, found))

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
