"""Whether a drive that is commanded off confirms its stop, and stays off."""

import math
from enum import Enum, auto
from typing import Final

from adaptdrive.safety.facts import Reading
from adaptdrive.safety.timing import Timing
from adaptdrive.safety.trips import Trip, TripKind

_STAYS: Final = "the drive does not stop"

_ON_READINGS = 2
"""Readings with the bridge on that are no flicker of a drive that has just stopped."""


class Stop(Enum):
    """State of the stop of a drive that is commanded off."""

    AWAITED = auto()
    CONFIRMED = auto()
    OVERDUE = auto()
    DENIED = auto()
    """The bridge came on, or was found on, without a command of this daemon."""


class StopWatch:
    """Compares the bridge that an idle drive reports with the safe command in force."""

    def __init__(self, timing: Timing, slack_s: float | None) -> None:
        """Expect a confirmation from the start on.

        Args:
            timing: Times of the drive.
            slack_s: Additional delay of the report of the bridge, None for a drive that never
                reports it.
        """
        self._confirmable = slack_s is not None
        self._coming_s = timing.coming_s
        self.limit_s = timing.switched_off_s + (slack_s or 0.0)
        self._commanded_s = math.inf
        self._confirmed = False
        self._coming = self._been_on = False
        self._come_s = -math.inf
        self._on: list[float] = []

    def release(self, reading: Reading | None = None, *, bridge: bool = False) -> None:
        """Note that the drive is energised: the next stop begins anew.

        Args:
            reading: The latest reading, None before the first.
            bridge: Whether the last command had the bridge on.
        """
        self._been_on = bridge and (self._been_on or (reading is not None and reading.bridge))
        self._coming = bridge and not self._been_on
        self._commanded_s, self._confirmed = math.inf, False

    def command(self, now_s: float) -> None:
        """Note that the drive is commanded off; the first time since its release counts."""
        if self._commanded_s == math.inf:
            self._commanded_s = now_s
            if self._coming:
                self._come_s = now_s + self._coming_s

    def judge(self, reading: Reading | None, safe_s: float, now_s: float) -> Stop:
        """Return what is known now.

        Args:
            reading: The latest reading, None before the first.
            safe_s: When bus or drive took the safe command, infinite while neither has.
            now_s: Monotonic time.
        """
        if not self._confirmable:
            self._confirmed = self._confirmed or safe_s < math.inf
        elif reading is not None and reading.bridge and self._confirmed:
            return self._denied(reading, now_s)
        elif reading is not None and not reading.bridge:
            self._on.clear()
            self._been_on = False
            due_s = max(safe_s, self._commanded_s, self._come_s)
            self._confirmed = self._confirmed or reading.bridge_reported_s > due_s
        if self._confirmed:
            return Stop.CONFIRMED
        return Stop.OVERDUE if now_s - self._commanded_s > self.limit_s else Stop.AWAITED

    def _denied(self, reading: Reading, now_s: float) -> Stop:
        """The bridge is on after a confirmed stop: denied by the second such reading.

        One that no other follows in the time of a stop is the drive's last report.
        """
        if reading.arrival_s not in self._on:
            self._on.append(reading.arrival_s)
        if len(self._on) < _ON_READINGS and now_s - reading.arrival_s <= self.limit_s:
            return Stop.CONFIRMED
        self.await_again(reading.arrival_s)
        return Stop.DENIED

    def await_again(self, now_s: float) -> None:
        """Wait for a confirmation again."""
        self._confirmed, self._commanded_s = False, now_s

    def unconfirmed(self, reading: Reading | None, safe_s: float, now_s: float) -> Trip:
        """Return why the stop is not confirmed, and the likeliest remedy."""
        waited = f"{(now_s - self._commanded_s) * 1e3:.0f} ms after the stop"
        if safe_s == math.inf:
            return Trip(
                TripKind.STOP_NOT_TAKEN,
                f"{_STAYS}: it has not taken the safe command {waited}; check that it accepts "
                "commands from the bus (remote mode, write access), and disconnect its supply",
            )
        if reading is not None and reading.bridge and reading.bridge_reported_s > self._commanded_s:
            return Trip(
                TripKind.NOT_STOPPED,
                f"{_STAYS}: its bridge is still on {waited}; check that it accepts commands from "
                "the bus (remote mode, checksum, another sender), and disconnect its supply",
            )
        return Trip(
            TripKind.STOP_NOT_REPORTED,
            f"{_STAYS}: it has not reported its bridge off {waited}; check its cable and its "
            "supply, and disconnect the supply before the load is touched",
        )
