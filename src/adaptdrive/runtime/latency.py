"""Causes of a late tick: the event loop's last callbacks, garbage collections and sleeps.

The loop notes what it runs in a ring; nothing of it is looked at until a tick is late.
"""

from __future__ import annotations

import asyncio
import gc
import selectors
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

from adaptdrive.clock.now import now_s

_RING = 256
"""Callbacks remembered: more than run in one tick."""

_NAMED = 3
"""Causes that one report names."""

_SHARE_WORTH_NAMING = 0.2
"""Least share of the lateness of a cause that is named."""

_QUIET_S = 60.0
"""Least time between two reports: a busy machine must not flood the log."""

SLEEP = "sleep"
COLLECTION = "garbage collection"
UNKNOWN = "unknown"

Entry = tuple[float, Any]
"""Start of an activity, and its source: a handle of the loop or a word."""


class _Ready(deque[Any]):
    """asyncio's queue of callbacks, which notes each one that is taken out to run."""

    ring: deque[Entry]

    def popleft(self) -> Any:  # noqa: ANN401 - handles, as in the base class
        handle = super().popleft()
        self.ring.append((now_s(), handle))
        return handle


class _Selector(selectors.DefaultSelector):
    """Notes when the loop has nothing more to run."""

    ring: deque[Entry]

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        self.ring.append((now_s(), SLEEP))
        return super().select(timeout)


class WatchedLoop(asyncio.SelectorEventLoop):
    """asyncio's event loop with a memory of what it ran last.

    Attributes:
        ring: The last entries, oldest first.
    """

    def __init__(self) -> None:
        self.ring: deque[Entry] = deque(maxlen=_RING)
        selector = _Selector()
        selector.ring = self.ring
        super().__init__(selector)
        ready = _Ready(self._ready)  # type: ignore[has-type]
        ready.ring = self.ring
        self._ready = ready


class LatencyDetector:
    """Counts late ticks, and reports them once a minute with the callbacks of the last one."""

    def __init__(
        self,
        late_us: float,
        report: Callable[[str], None],
        clock: Callable[[], float],
        ring: deque[Entry] | None = None,
    ) -> None:
        """Watch nothing yet.

        Args:
            late_us: Lateness from which a tick is reported.
            report: Receives the report as one sentence.
            clock: Monotonic clock in seconds, the one that lateness is measured with.
            ring: The loop's memory; without one only garbage collections are named.
        """
        self._late_us = late_us
        self._report = report
        self._clock = clock
        self._ring: deque[Entry] = deque(maxlen=_RING) if ring is None else ring
        self._reported_s = float("-inf")
        self._withheld = 0
        self._worst_us = 0.0
        self._interrupted: object = UNKNOWN
        self._watching = ring is not None

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
        if lateness_us < self._late_us:
            return
        now_s = self._clock()
        self._worst_us = max(self._worst_us, lateness_us)
        if now_s - self._reported_s < _QUIET_S:
            self._withheld += 1
            return
        began_s = now_s - tick_us * 1e-6
        causes = self._causes(began_s - lateness_us * 1e-6, began_s)
        withheld = (
            f"; {self._withheld} more since the last of these events, the worst "
            f"{self._worst_us * 1e-3:.2f} ms late"
            if self._withheld
            else ""
        )
        self._reported_s, self._withheld, self._worst_us = now_s, 0, 0.0
        self._report(f"tick {lateness_us * 1e-3:.2f} ms late: {causes}{withheld}")

    def _on_collection(self, phase: str, _: dict[str, int]) -> None:
        if phase == "start":
            self._interrupted = self._ring[-1][1] if self._ring else UNKNOWN
        self._ring.append((now_s(), COLLECTION if phase == "start" else self._interrupted))

    def _causes(self, due_s: float, began_s: float) -> str:
        """Return the activities between the due time and the start of a tick, longest first."""
        times: dict[str, float] = {}
        for name, spent_s in self._spent(due_s, began_s):
            times[name] = times.get(name, 0.0) + spent_s
        longest = sorted(times.items(), key=lambda item: -item[1])[:_NAMED]
        named = ", ".join(f"{name} {spent_s * 1e3:.2f} ms" for name, spent_s in longest)
        if sum(times.values()) >= _SHARE_WORTH_NAMING * (began_s - due_s):
            return named
        if not self._watching:
            return "this event loop does not record its callbacks"
        if self._ring and self._ring[0][0] > due_s:
            return f"more callbacks than are remembered, the last of them {named}"
        return "nothing of the daemon ran; another process had the CPU, or the frame was late"

    def _spent(self, due_s: float, began_s: float) -> Iterator[tuple[str, float]]:
        entries = [*self._ring, (began_s, SLEEP)]
        ends = [start_s for start_s, _ in entries[1:]]
        for (start_s, what), end_s in zip(entries[:-1], ends, strict=True):
            spent_s = min(end_s, began_s) - max(start_s, due_s)
            if spent_s > 0.0 and what != SLEEP:
                yield describe(what), spent_s


def describe(what: object) -> str:
    """The name of a callback or of the task that it drives."""
    if isinstance(what, str):
        return what
    callback = getattr(what, "_callback", what)
    owner = getattr(callback, "__self__", None)
    if isinstance(owner, asyncio.Task):
        return f"task {owner.get_name()!r}"
    return str(getattr(callback, "__qualname__", callback))
