"""Wall-clock time, whether it can be trusted, and delays: of log lines and of the next attempt."""

import ctypes
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum

WallClock = Callable[[], datetime]
"""Returns the present time in UTC."""

Monotonic = Callable[[], float]
"""Returns seconds on a clock that never steps."""


class Synchronisation(StrEnum):
    """Synchronisation of the wall clock with a time source."""

    SYNCHRONISED = "synchronised"
    UNSYNCHRONISED = "unsynchronised"
    UNKNOWN = "unknown"


# struct timex takes 208 bytes on 64-bit kernels; more room does no harm, zeros ask and set nothing.
_TIMEX_BYTES = 512
_TIME_ERROR = 5


def utc_now() -> datetime:
    """The wall clock of this machine."""
    return datetime.now(UTC)


def kernel_synchronisation() -> Synchronisation:
    """Ask the kernel whether its clock is kept right by NTP, PTP or a radio clock."""
    try:
        answer = ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(_TIMEX_BYTES))
    except (OSError, AttributeError):
        return Synchronisation.UNKNOWN
    if answer < 0:
        return Synchronisation.UNKNOWN
    return Synchronisation.UNSYNCHRONISED if answer == _TIME_ERROR else Synchronisation.SYNCHRONISED


@dataclass(slots=True)
class LogRation:
    """Lets so many lines into the log in each interval, and counts those that it withholds.

    Attributes:
        monotonic: Clock.
        lines: Lines in each interval.
        interval_s: Length of an interval.
        began_s: When the present interval began, on that clock.
        used: Lines written in it.
        withheld: Lines withheld since the last one that was written.
    """

    monotonic: Monotonic
    lines: int = 20
    interval_s: float = 10.0
    began_s: float = -math.inf
    used: int = 0
    withheld: int = 0

    def take(self) -> int | None:
        """Return how many lines were withheld before this one, None when this one is withheld."""
        now_s = self.monotonic()
        if now_s - self.began_s >= self.interval_s:
            self.began_s, self.used = now_s, 0
        if self.used >= self.lines:
            self.withheld += 1
            return None
        self.used += 1
        withheld, self.withheld = self.withheld, 0
        return withheld

    def lift(self) -> None:
        """Withhold nothing from here on."""
        self.lines = sys.maxsize


@dataclass(slots=True)
class BrokerBackoff:
    """Waiting times between attempts: doubling, capped, and spread so that a site does not surge.

    Attributes:
        uniform: Returns a random number between its two arguments.
        first_s: Longest wait after the first failure.
        longest_s: Longest wait at all.
        healthy_s: A connection that lived this long starts the count anew.
        failures: Failures in a row so far.
    """

    uniform: Callable[[float, float], float]
    first_s: float = 0.5
    longest_s: float = 30.0
    healthy_s: float = 10.0
    failures: int = 0

    def after(self, lived_s: float) -> float:
        """The wait, in seconds, after a connection that lived `lived_s` (0 for a failed one)."""
        self.failures = 0 if lived_s >= self.healthy_s else self.failures
        ceiling_s = min(self.longest_s, self.first_s * 2.0 ** min(self.failures, 30))
        self.failures += 1
        return self.uniform(0.5 * ceiling_s, ceiling_s)
