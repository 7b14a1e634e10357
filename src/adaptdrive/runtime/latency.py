"""Causes of a late tick: the processor time that the daemon itself used before it."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable

_SHARE_WORTH_NAMING = 0.2
"""Least share of the lateness that the daemon must have used the processor for to be named."""

_QUIET_S = 60.0
"""Least time between two reports: a busy machine must not flood the log."""


class LatencyDetector:
    """Counts late ticks, and reports them once a minute with the cause of the last one."""

    def __init__(
        self,
        late_us: float,
        report: Callable[[str], None],
        clock: Callable[[], float],
        used: Callable[[], float] = time.process_time,
    ) -> None:
        """Watch nothing yet.

        Args:
            late_us: Lateness from which a tick is reported.
            report: Receives the report as one sentence.
            clock: Monotonic clock in seconds.
            used: Returns the processor time of this process in seconds.
        """
        self._late_us = late_us
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
        if lateness_us < self._late_us:
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
