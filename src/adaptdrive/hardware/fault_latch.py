"""Keeps a fault word from the frame that shows it until a reading has carried it."""

from __future__ import annotations

from collections.abc import Mapping


class FaultLatch:
    """The faults seen since the last reading: a frame that is lost must not hide them.

    Bits add up. Codes do not, as two of them would make a third: the first one is kept.

    Attributes:
        word: All bits, or the first code, 0 for none.
    """

    def __init__(self, names: Mapping[int, str] | None = None) -> None:
        """See nothing yet.

        Args:
            names: What the drive's description calls its faults, by word or bit.
        """
        self._names = names or {}
        self._lists_codes = any(word & (word - 1) for word in self._names)
        self.word = 0

    def see(self, word: float | None) -> None:
        """Keep a fault word, None where a frame carries none."""
        if word and not (self._lists_codes and self.word):
            self.word |= int(word)

    def clear(self, carried: int) -> None:
        """Forget what a reading has carried; a fault seen after it was composed stays.

        Args:
            carried: The reading's fault word.
        """
        if not self._lists_codes or carried == self.word:
            self.word &= ~carried

    @property
    def name(self) -> str:
        """The word's name, or the names of its bits; empty where there is none."""
        if self._lists_codes or self.word in self._names:
            return self._names.get(self.word, "")
        bits = (1 << number for number in range(self.word.bit_length()))
        return ", ".join(self._names[bit] for bit in bits if self.word & bit and bit in self._names)

    @property
    def complaint(self) -> str | None:
        """Faults that no reading has carried yet, as text."""
        return describe_fault(self.word, self.name) if self.word else None


def describe_fault(word: int, name: str) -> str:
    """Return a fault in words.

    Args:
        word: The drive's fault word.
        name: Its name, empty for none.
    """
    return f"drive fault: word {word:#x}" + (f" ({name})" if name else "")
