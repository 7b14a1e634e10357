"""Keeps a fault word from the frame that shows it until a reading has carried it."""

from __future__ import annotations

from collections.abc import Mapping


class FaultLatch:
    """The faults seen since the last reading: a frame that is lost must not hide them.

    Attributes:
        word: All of them, 0 for none.
    """

    def __init__(self, names: Mapping[int, str] | None = None) -> None:
        """See nothing yet.

        Args:
            names: What the drive's description calls its faults, by word or bit.
        """
        self._names = names or {}
        self.word = 0

    def see(self, word: float | None) -> None:
        """Keep a fault word, None where a frame carries none."""
        if word:
            self.word |= int(word)

    def clear(self, carried: int) -> None:
        """Forget what a reading has carried; a fault seen after it was composed stays.

        Args:
            carried: The reading's fault word.
        """
        self.word &= ~carried

    @property
    def name(self) -> str:
        """The word's name, or the names of its bits; empty where there is none."""
        if self.word in self._names:
            return self._names[self.word]
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
