"""Work between the ticks: causes of late ticks, garbage, and the watchdog."""

import asyncio
import gc
import socket
import time
from collections.abc import Callable, Mapping
from functools import partial

from adaptdrive.runtime.reports import TickReport

# Causes of a late tick: the processor time that the daemon itself used before it.

_SHARE_WORTH_NAMING = 0.2
"""Least share of the lateness that the daemon must have used the processor for to be named."""

_QUIET_S = 60.0
"""Least time between two reports: a busy machine must not flood the log."""

LATE_US = 2000.0
"""Lateness from which a tick is reported: a quarter of a half cycle, which no idle machine has."""


class LatencyDetector:
    """Counts late ticks, and reports them once a minute with the cause of the last one."""

    def __init__(
        self,
        report: Callable[[str], None],
        clock: Callable[[], float],
        used: Callable[[], float] = time.process_time,
    ) -> None:
        """Watch nothing yet.

        Args:
            report: Receives the report as one sentence.
            clock: Monotonic clock in seconds.
            used: Returns the processor time of this process in seconds.
        """
        self._report = report
        self._clock = clock
        self._used = used
        self._used_s = used()
        self._collected_s = self._collects_since_s = 0.0
        self._reported_s = float("-inf")
        self._withheld = 0
        self._worst_us = 0.0

    def open(self) -> None:
        """Note garbage collections from now on."""
        gc.callbacks.append(self._on_collection)

    def close(self) -> None:
        """Note nothing any more."""
        if self._on_collection in gc.callbacks:
            gc.callbacks.remove(self._on_collection)

    def ticked(self, lateness_us: float, tick_us: float) -> None:
        """Look at a tick that has just ended.

        Args:
            lateness_us: How late it began.
            tick_us: How long it took.
        """
        last_s, self._used_s = self._used_s, self._used()
        collected_s, self._collected_s = self._collected_s, 0.0
        if lateness_us < LATE_US:
            return
        now_s = self._clock()
        self._worst_us = max(self._worst_us, lateness_us)
        if now_s - self._reported_s < _QUIET_S:
            self._withheld += 1
            return
        cause = _cause(lateness_us, (self._used_s - last_s) * 1e6 - tick_us, collected_s * 1e3)
        withheld = (
            f"; {self._withheld} more since the last of these events, the worst "
            f"{self._worst_us * 1e-3:.2f} ms late"
            if self._withheld
            else ""
        )
        self._reported_s, self._withheld, self._worst_us = now_s, 0, 0.0
        self._report(f"tick {lateness_us * 1e-3:.2f} ms late: {cause}{withheld}")

    def _on_collection(self, phase: str, _: dict[str, int]) -> None:
        now_s = self._clock()
        if phase == "start":
            self._collects_since_s = now_s
        else:
            self._collected_s += now_s - self._collects_since_s


def _cause(lateness_us: float, used_us: float, collected_ms: float) -> str:
    if used_us < _SHARE_WORTH_NAMING * lateness_us:
        return "nothing of the daemon ran; another process had the CPU, or the frame was late"
    return (
        f"the daemon itself used {used_us * 1e-3:.2f} ms of processor time since the tick before, "
        f"{collected_ms:.2f} ms of it to collect garbage"
    )


# Work between the ticks: preparation for the next frame, causes of late ticks, garbage.

COLLECT_TICKS = 240
"""Ticks between two collections: one in two seconds."""

_MIDDLE_EVERY = 10
"""Collections of the youngest objects to one of the middle ones: the ratio of Python's own."""

_FULL_EVERY = 300
"""Least collections between two full ones: each takes 10 ms and more, even with the drive off."""


class IdleCollector:
    """Collects garbage in the slack after a tick, in place of Python's own bad moments.

    While a drive runs, only young objects are looked at: a full collection takes as long as
    everything that lives is large, ten milliseconds and more with many commands remembered. It
    waits until the drive is off.
    """

    def __init__(self) -> None:
        self._ticks = self._collections = 0

    def is_due(self) -> bool:
        """Count a tick; whether a collection is due after it."""
        self._ticks += 1
        return self._ticks % COLLECT_TICKS == 0

    def collect(self, *, idle: bool) -> int:
        """Collect what became garbage since the freeze.

        Args:
            idle: Whether the drive is off, so that a late tick does no harm.

        Returns:
            The generation that was collected.
        """
        self._collections += 1
        generation = 0 if self._collections % _MIDDLE_EVERY else 1
        if idle and self._collections >= _FULL_EVERY:
            self._collections, generation = 0, 2
        gc.collect(generation)
        return generation


class TickSupport:
    """Collects garbage in the idle time after the ticks of one drive, and explains late ticks."""

    def __init__(
        self,
        warn: Callable[[str, str], None],
        clock: Callable[[], float],
    ) -> None:
        """Begin to note garbage collections.

        Args:
            warn: Takes kind and text of an event: the cause of a late tick.
            clock: Monotonic clock in seconds.
        """
        self._loop = asyncio.get_running_loop()
        self._collector = IdleCollector()
        self._detector = LatencyDetector(partial(warn, "latency"), clock)
        self._detector.open()

    def ticked(self, report: TickReport, *, idle: bool) -> None:
        """Look at a tick that has just ended; the next one is far.

        Args:
            report: Its times.
            idle: Whether the drive is off, so that a late tick does no harm.
        """
        self._detector.ticked(report.lateness_us, report.tick_us)
        if self._collector.is_due():
            self._loop.call_soon(partial(self._collector.collect, idle=idle))

    def close(self) -> None:
        """Note garbage collections no longer."""
        self._detector.close()


# The service manager: ready, status, and the watchdog that the fast loop feeds.


class ServiceManager:
    """Sends messages of the sd_notify protocol; does nothing without a service manager."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        """Connect to the manager that the environment names.

        Args:
            environment: Process environment, with NOTIFY_SOCKET and WATCHDOG_USEC or without.
        """
        self._socket: socket.socket | None = None
        address = environment.get("NOTIFY_SOCKET", "")
        if address:
            if address.startswith("@"):
                address = "\0" + address[1:]
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.settimeout(0.0)
            self._address = address
        watchdog_us = environment.get("WATCHDOG_USEC", "")
        self._feed_every_s = int(watchdog_us) * 1e-6 / 4.0 if watchdog_us.isdigit() else 0.0
        self._unsent: dict[str, str] = {}
        self._fed_s = float("-inf")
        self._status = ""

    def ready(self) -> None:
        """Configuration, bus and loop are up."""
        self._notify("READY=1")

    def status(self, text: str) -> None:
        """Send the status in one line, if it has changed."""
        if text != self._status:
            self._status = text
            self._notify(f"STATUS={text}")

    def stopping(self) -> None:
        """An orderly stop has begun."""
        self._notify("STOPPING=1")

    def feed(self, now_s: float) -> None:
        """Report a tick that met its deadline, four times per watchdog period."""
        if self._unsent:
            self._deliver()
        if self._feed_every_s and now_s - self._fed_s >= self._feed_every_s:
            self._fed_s = now_s
            self._notify("WATCHDOG=1")

    def close(self) -> None:
        """Stop speaking."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _notify(self, message: str) -> None:
        """Send a message after those that wait; a newer one of its kind takes its place there."""
        if self._socket is not None:
            self._unsent[message.partition("=")[0]] = message
            self._deliver()

    def _deliver(self) -> None:
        """Send what waits as far as the manager has room; nothing waits for one that is gone."""
        while self._socket is not None and self._unsent:
            kind, message = next(iter(self._unsent.items()))
            try:
                self._socket.sendto(message.encode(), self._address)
            except BlockingIOError:
                return
            except OSError:
                pass
            del self._unsent[kind]
