"""The share of its frames that a port has to refuse, over a window of time.

A lost or disturbed frame now and then is what the age of the values is for. A large share of them
for long is a mistake in the configuration, a second sender or a bad cable. It can go unnoticed:
where every other frame is refused, no value ever grows old.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

from adaptdrive.runtime.reports import DriveReport

WINDOW_S = 5.0
"""Longer than a burst of noise, shorter than the time to damage a load."""

_LEAST_FRAMES = 20
"""Frames in a window from which on a share is judged: one of them is half of the share noted."""

_NOTED_SHARE = 0.1
"""Share that is reported; a bus in order refuses less than one frame in a thousand."""

_FORGOTTEN_SHARE = 0.05
"""Share below which the next one is reported again."""

_CAUSES = {
    "wrong_checksum": "is data_id, data_id_mode or the algorithm of [bus.integrity] another one, "
    "does a second sender use the id, or is the cable disturbed?",
    "wrong_length": "does the DBC, the EDS or the register map describe another version?",
    "counter_stuck": "does the sender hang, or does a gateway repeat its frames?",
    "out_of_range": "is a scale, an offset or a range wrong, or a sensor broken?",
    "exceptions": "does the device have these registers, and does it take commands (remote mode)?",
    "timeouts": "are the baud rate, the device id and the cable right, and the time-out long "
    "enough?",
}


class RefusedShares:
    """Measures the shares of the drive's port and of the separate sensor buses."""

    def __init__(self, limit: float) -> None:
        """Start without a count.

        Args:
            limit: Share that must not be reached while the drive is energised, 0 for any.
        """
        self._limit = limit
        self._ports: dict[str, RefusedShare] = {}

    def add(self, books: DriveReport) -> list[str]:
        """Take the counts of every port, and return what is to be reported."""
        ports = {"drive": books.bus} | {one.name: one.bus for one in books.sensors}
        found = [self._port(name).add(books.time_s, counts) for name, counts in ports.items()]
        return [text for text in found if text is not None]

    @property
    def cause(self) -> str | None:
        """Reason not to energise the drive, None for no reason."""
        causes = (port.cause for port in self._ports.values())
        return next((cause for cause in causes if cause is not None), None)

    def _port(self, name: str) -> RefusedShare:
        return self._ports.setdefault(name, RefusedShare(name, self._limit))


class RefusedShare:
    """Measures the share of one port."""

    def __init__(self, name: str, limit: float) -> None:
        """Start without a count.

        Args:
            name: Name of the port in reports.
            limit: Share that must not be reached while the drive is energised, 0 for any.
        """
        self._name = name
        self._limit = limit
        self._marks: deque[tuple[float, Mapping[str, int]]] = deque()
        self._noted = False
        self.cause: str | None = None

    def add(self, now_s: float, counts: Mapping[str, int]) -> str | None:
        """Take the counts of the port, and judge its share anew.

        Args:
            now_s: Monotonic time.
            counts: Its statistics by name.

        Returns:
            What is to be reported, None for nothing new.
        """
        marks = self._marks
        marks.append((now_s, counts))
        while len(marks) > 1 and now_s - marks[1][0] >= WINDOW_S:
            marks.popleft()
        since_s, first = marks[0]
        grown = {name: counts[name] - first[name] for name in counts}
        judged = _judged(grown)
        if now_s - since_s < WINDOW_S or judged < _LEAST_FRAMES:
            self.cause = None
            return None
        refused = _refused(grown)
        share = min(1.0, sum(refused.values()) / judged)
        text = self._text(share, judged, refused)
        trips = self._limit and share >= self._limit
        self.cause = f"refused frames: {text}, limit {self._limit:.0%}" if trips else None
        noted, least = self._noted, _FORGOTTEN_SHARE if self._noted else _NOTED_SHARE
        self._noted = share >= least
        return text if self._noted and not noted else None

    def _text(self, share: float, judged: int, refused: Mapping[str, int]) -> str:
        reason = max(refused, key=lambda name: refused[name])
        return (
            f"{self._name}: {share:.0%} of the last {judged} frames were refused, most for "
            f"{reason} ({refused[reason]}): {_CAUSES[reason]} `adaptdrive probe` shows them"
        )


def _judged(grown: Mapping[str, int]) -> int:
    """Return the frames that were meant for this port; for one that polls, its requests.

    A port that receives nothing refuses nothing: its values age.
    """
    asked = grown["exceptions"] + grown["timeouts"]
    if not asked:
        return grown["received"] - grown["foreign"]
    heard = grown["received"] + grown["exceptions"]
    return heard + grown["timeouts"] if heard else 0


def _refused(grown: Mapping[str, int]) -> dict[str, int]:
    """Return the frames that were refused, by reason."""
    refused = {name: grown[name] for name in _CAUSES}
    # a disturbed reply on a serial line is a missing one, too
    disturbed = refused["wrong_checksum"] + refused["wrong_length"]
    refused["timeouts"] = max(0, refused["timeouts"] - disturbed)
    return refused
