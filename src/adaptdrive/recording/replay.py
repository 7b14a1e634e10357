"""Replay: the controller runs again on recorded measurements, and its commands are compared.

The order of calls is that of `control.schedule`. The record holds the tick at which each
decision took effect, which may be late, and on which snapshots the daemon decided at all.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import islice
from typing import Any

from adaptdrive.control.columns import rebuild
from adaptdrive.control.schedule import Schedule, TwoRate
from adaptdrive.control.signals import Command, Decision, Snapshot
from adaptdrive.errors import RecordingError
from adaptdrive.recording.reader import Session
from adaptdrive.recording.replay_report import Difference, Gap, ReplayReport
from adaptdrive.recording.session import INFO_FILE, SLOW, TICKS
from adaptdrive.runtime.reports import TICK_COLUMNS, TickReport

_COLUMNS = tuple(column.name for column in TICK_COLUMNS)
_COMMANDED = ("current_scale_S", "boost_reference_V", "bridge")
_DECIDED = ("boost_reference_V", "controller", "accepted", "gains")


def replay(session: Session, controller: TwoRate) -> ReplayReport:
    """Run a controller on the measurements and orders of a session.

    Args:
        session: The recorded session.
        controller: A new controller, built from the session's configuration or from another one.

    Returns:
        What differs from the record.

    Raises:
        RecordingError: The session holds no ticks, or is the record of a trip in the middle of a
            run, which does not hold the state of the controller at its begin.
    """
    _refuse_middle(session)
    player = _Player(session, controller)
    for recorded in islice(recorded_ticks(session), player.known):
        player.play(recorded)
    report = player.report()
    if not report.ticks:
        raise RecordingError(session.path, "it holds no ticks to replay")
    return report


def recorded_ticks(session: Session) -> Iterator[TickReport]:
    """Yield the fast ticks of a session, in their order."""
    return map(partial(rebuild, TickReport), table_rows(session, TICKS, _COLUMNS))


def table_rows(session: Session, table: str, columns: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Yield rows of a table as Python values, without holding all of them at once."""
    for batch in session.batches(table, columns):
        yield from batch.to_pylist()


def _refuse_middle(session: Session) -> None:
    first = session.info.first_sequence
    if first > 0:
        parent = session.path.absolute().parent
        whole = parent if (parent / INFO_FILE).is_file() else "the session that it is a part of"
        raise RecordingError(session.path, f"it begins at tick {first} of a run: replay {whole}")


class _Player:
    """One replay under way.

    Attributes:
        known: Ticks whose decisions are known; a session in progress grows while it is replayed.
    """

    def __init__(self, session: Session, controller: TwoRate) -> None:
        self._session = session
        self._controller = controller
        self._schedule = Schedule(controller, latency_ticks=0)  # delivered when it took effect
        self._slow = {row["k"]: row for row in table_rows(session, SLOW, ("k", *_DECIDED))}
        self._decided = set(self._slow)
        self.known = 0
        for row in table_rows(session, TICKS, ("applied_k",)):
            # a decision that took effect was made, even where its own record is lost
            self._decided.add(row["applied_k"])
            self.known += 1
        self._pending: dict[int, tuple[Snapshot, Decision]] = {}
        self._next_sequence = 0
        self._ticks = 0
        self._slow_steps = 0
        self._gaps: list[Gap] = []
        self._unmatched: list[int] = []
        self._commands = _Comparison()
        self._decisions = _Comparison()

    def play(self, recorded: TickReport) -> None:
        """Replay one tick."""
        self._note_gap(recorded)
        if recorded.applied_k >= 0:
            self._deliver(recorded.applied_k)
        command = self._schedule.tick(recorded.measurement, recorded.order)
        tick = recorded.measurement.tick
        self._commands.compare(tick, _command_values(recorded.command), _command_values(command))
        self._ticks += 1
        snapshot = self._schedule.take_snapshot()
        if snapshot is not None and snapshot.k in self._decided:
            self._decide(snapshot)

    def report(self) -> ReplayReport:
        """Return the result."""
        return ReplayReport(
            session=self._session.path.name,
            ticks=self._ticks,
            slow_steps=self._slow_steps,
            differing_commands=self._commands.differing,
            first_command=self._commands.first,
            largest=self._commands.largest,
            differing_decisions=self._decisions.differing,
            first_decision=self._decisions.first,
            gaps=tuple(self._gaps),
            unmatched=tuple(self._unmatched),
        )

    def _note_gap(self, recorded: TickReport) -> None:
        missing = recorded.sequence - self._next_sequence
        if missing != 0:
            self._gaps.append(Gap(before_tick=recorded.measurement.tick, missing=missing))
        self._next_sequence = recorded.sequence + 1

    def _deliver(self, k: int) -> None:
        decided = self._pending.pop(k, None)
        if decided is None or not self._schedule.deliver(*decided):
            self._unmatched.append(k)
        self._pending = {other: kept for other, kept in self._pending.items() if other > k}

    def _decide(self, snapshot: Snapshot) -> None:
        decision = self._controller.decide(snapshot)
        self._pending[snapshot.k] = snapshot, decision
        self._slow_steps += 1
        row = self._slow.get(snapshot.k)
        if row is not None:
            recorded = {name: row[name] for name in _DECIDED}
            self._decisions.compare(snapshot.tick, recorded, _decision_values(decision))


class _Comparison:
    """Counts and remembers what differs in a series of named values."""

    def __init__(self) -> None:
        self.differing = 0
        self.first: Difference | None = None
        self.largest: dict[str, float] = {}

    def compare(self, tick: int, recorded: dict[str, Any], replayed: dict[str, Any]) -> None:
        """Compare one set of values, bit for bit."""
        unlike = [name for name in recorded if not _alike(recorded[name], replayed[name])]
        if not unlike:
            return
        self.differing += 1
        if self.first is None:
            self.first = Difference(tick, recorded, replayed)
        for name in unlike:
            distance = _distance(recorded[name], replayed[name])
            self.largest[name] = max(distance, self.largest.get(name, 0.0))


def _command_values(command: Command) -> dict[str, Any]:
    return {name: getattr(command, name) for name in _COMMANDED}


def _decision_values(decision: Decision) -> dict[str, Any]:
    whole = {name: getattr(decision, name) for name in _DECIDED}
    return whole | {"controller": decision.controller.value, "gains": list(decision.gains)}


def _alike(recorded: object, replayed: object) -> bool:
    """Return whether two values are the same to the last bit; one NaN is as good as another."""
    if isinstance(recorded, list) and isinstance(replayed, list):
        same_length = len(recorded) == len(replayed)
        return same_length and all(map(_alike_items, recorded, replayed))
    return _alike_items(recorded, replayed)


def _alike_items(recorded: object, replayed: object) -> bool:
    if isinstance(recorded, float) and isinstance(replayed, int | float):
        if math.isnan(recorded) and math.isnan(replayed):
            return True
        return struct.pack("<d", recorded) == struct.pack("<d", replayed)
    return recorded == replayed


def _distance(recorded: object, replayed: object) -> float:
    """Return the distance of two numbers; infinite if one of them is not a number."""
    if isinstance(recorded, float) and isinstance(replayed, int | float):
        distance = abs(recorded - replayed)
        return math.inf if math.isnan(distance) else distance
    return math.inf
