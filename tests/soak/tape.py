"""The recorder of a daemon by hand: its reports go through the product's writer, as they come.

A tape that ends is replayed, and held against what was published.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings
from adaptdrive.config.root import Configuration
from adaptdrive.control.controller import Controller
from adaptdrive.recording.batches import Batch, EventRow, Header, TickTable, slow_row
from adaptdrive.recording.reader import read_session
from adaptdrive.recording.replay import replay
from adaptdrive.recording.session import Dropped
from adaptdrive.recording.writer import PatientWriter
from adaptdrive.runtime.reports import Event, LoadReport, TickReport
from tests.faults.by_hand import DaemonByHand
from tests.recording.material import INFO

HELD = 20_000
"""Reports that a queue holds: more than two minutes of ticks."""


@dataclass(frozen=True, slots=True)
class Judged:
    """One session that was closed, read and replayed.

    Attributes:
        ticks: Ticks that were replayed.
        slow_steps: Slow steps that were replayed.
        events: Events that were read.
        flaws: What is not as it should be.
    """

    ticks: int
    slow_steps: int
    events: int
    flaws: tuple[str, ...]


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
        header = Header(INFO, "", str(folder.parent), str(folder), segment_s=1e9)
        self._writer = PatientWriter(header, lambda _: None)
        self._number = self._published_ticks = self._published_events = 0

    def flush(self, *, last: bool = False) -> None:
        """Write what was reported since the last call."""
        ticks = [one for one in self._ticks.drain() if isinstance(one, TickReport)]
        others = self._others.drain()
        events = [one for one in others if isinstance(one, Event)]
        slow = [slow_row(one) for one in others if isinstance(one, LoadReport)]
        rows = [self._event_row(i, one) for i, one in enumerate(events, self._published_events + 1)]
        self._published_ticks += len(ticks)
        self._published_events += len(events)
        self._number += 1
        table = TickTable()
        table.extend(ticks)
        batch = Batch(table.rows, table.packed(), slow, rows, Dropped(), last, number=self._number)
        self._writer.write(batch)

    def _event_row(self, number: int, event: Event) -> EventRow:
        kind, severity = event.kind, event.severity.value
        return EventRow(INFO.started, event.tick, kind, severity, event.detail, 0.0, number)

    def judge(self) -> Judged:
        """Close the session, replay it, and remove it."""
        self.flush(last=True)
        self._writer.finish()
        session = read_session(self._folder)
        if not self._published_ticks:
            return Judged(0, 0, len(session.events), ())
        settings, load = controller_settings(self._configuration), build_load(self._configuration)
        report = replay(session, Controller(settings, load))
        flaws = [] if report.exact else [str(report)]
        if report.differing_decisions:
            flaws.append(f"{report.differing_decisions} slow steps differ")
        if report.ticks != self._published_ticks:
            flaws.append(f"{self._published_ticks} ticks published, {report.ticks} recorded")
        if len(session.events) != self._published_events:
            flaws.append(f"{self._published_events} events, {len(session.events)} recorded")
        if self._ticks.dropped or self._others.dropped:
            flaws.append("a queue was too short")
        shutil.rmtree(self._folder)
        return Judged(report.ticks, report.slow_steps, len(session.events), tuple(flaws))
