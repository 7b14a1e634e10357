"""The recorder of a daemon by hand: its reports go through the product's archive, as they come.

A tape that ends is replayed, and held against what was published.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import msgspec

from adaptdrive.config.root import Configuration
from adaptdrive.recording.records import EventRow, Header
from adaptdrive.runtime.reports import Event, LoadReport, TickReport
from tests.integration.faults.by_hand import DaemonByHand
from tests.unit.recording.material import INFO, make_batch, record_messages
from tools.soak.verdict import Judged, Published, judge_elsewhere

HELD = 20_000
"""Reports that a queue holds: more than two minutes of ticks."""


class Tape:
    """One session of a daemon by hand."""

    def __init__(self, folder: Path, daemon: DaemonByHand, configuration: Configuration) -> None:
        """Begin a session.

        Args:
            folder: Takes it; it is removed when it was judged.
            daemon: Whose reports are recorded.
            configuration: Of the daemon, for the replay.
        """
        self._folder = folder
        folder.mkdir()
        self._configuration = configuration
        self._ticks = daemon.hub.subscribe(TickReport, size=HELD)
        self._others = daemon.hub.subscribe(Event, LoadReport, size=HELD)
        self._published_ticks = self._published_events = 0

    def flush(self, *, last: bool = False) -> None:
        """Write what was reported since the last call."""
        ticks = [one for one in self._ticks.drain() if isinstance(one, TickReport)]
        others = self._others.drain()
        events = [one for one in others if isinstance(one, Event)]
        slow = [one for one in others if isinstance(one, LoadReport)]
        rows = [self._event_row(i, one) for i, one in enumerate(events, self._published_events + 1)]
        self._published_ticks += len(ticks)
        self._published_events += len(events)
        batch = msgspec.structs.replace(make_batch(ticks, slow, last=last), events=rows)
        record_messages(self._folder, Header(INFO, ""), batch)

    def _event_row(self, number: int, event: Event) -> EventRow:
        kind, severity = event.kind, event.severity.value
        return EventRow(INFO.started, event.tick, kind, severity, event.detail, 0.0, number)

    def judge(self) -> Judged:
        """Close the session, replay it, and remove it."""
        self.flush(last=True)
        dropped = bool(self._ticks.dropped or self._others.dropped)
        published = Published(self._published_ticks, self._published_events, dropped)
        judged = judge_elsewhere(self._folder, self._configuration, published)
        shutil.rmtree(self._folder)
        return judged
