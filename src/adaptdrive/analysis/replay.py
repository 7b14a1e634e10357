"""Replay: the controller runs again on recorded measurements, with the same or other settings.

The order of calls is that of `control.schedule`. The record holds the tick at which each
decision took effect, which may be late, and on which snapshots the daemon decided at all.
"""

import math
import struct
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from adaptdrive.config import Configuration
from adaptdrive.config.file import read_tables, validate_configuration
from adaptdrive.control.schedule import Schedule, TwoRate
from adaptdrive.control.signals import Command, Decision, Snapshot
from adaptdrive.recording.reader import Session
from adaptdrive.recording.session import INFO_FILE, TableName
from adaptdrive.runtime.reports import TICK_COLUMNS, TickReport
from adaptdrive.util.errors import ConfigurationError, Flaw, RecordingError
from adaptdrive.util.quantity import rebuild

# Replay: the controller runs again on recorded measurements, and its commands are compared.

_COLUMNS = tuple(column.name for column in TICK_COLUMNS)
_COMMANDED = ("current_scale_S", "boost_reference_V", "bridge")
_DECIDED = ("boost_reference_V", "controller", "accepted", "gains")


@dataclass(frozen=True, slots=True)
class Difference:
    """The values recorded and replayed at one tick."""

    tick: int
    recorded: Mapping[str, Any]
    replayed: Mapping[str, Any]

    def __str__(self) -> str:
        return f"at tick {self.tick}: recorded {_text(self.recorded)}; now {_text(self.replayed)}"


@dataclass(frozen=True, slots=True)
class Gap:
    """Ticks that were run and not recorded.

    Attributes:
        before_tick: First recorded tick after them.
        missing: How many; negative where the record goes back.
    """

    before_tick: int
    missing: int

    def __str__(self) -> str:
        return f"{self.missing} before tick {self.before_tick}"


@dataclass(slots=True)
class ReplayReport:
    """Result of a replay.

    Attributes:
        session: Name of the session.
        ticks: Fast ticks replayed.
        slow_steps: Slow steps replayed.
        differing_commands: Commands that are not the recorded ones to the last bit.
        first_command: The first of them.
        largest: Largest difference by quantity of the command; only quantities that differ.
        differing_decisions: Slow steps that came out differently.
        first_decision: The first of them.
        gaps: Where ticks are missing from the record.
        unmatched: Slow indices that took effect in the record, but had no decision in the replay.
    """

    session: str
    ticks: int = 0
    slow_steps: int = 0
    differing_commands: int = 0
    first_command: Difference | None = None
    largest: dict[str, float] = field(default_factory=dict)
    differing_decisions: int = 0
    first_decision: Difference | None = None
    gaps: list[Gap] = field(default_factory=list)
    unmatched: list[int] = field(default_factory=list)

    @property
    def exact(self) -> bool:
        """True when the record is whole and every command came out bit-equal."""
        return not (self.gaps or self.unmatched or self.differing_commands)

    def __str__(self) -> str:
        return "\n".join(self._lines())

    def _lines(self) -> Iterator[str]:
        yield f"{self.session}: replayed {self.ticks} ticks and {self.slow_steps} slow steps"
        if self.gaps:
            shown = ", ".join(map(str, self.gaps[:5])) + (", ..." if len(self.gaps) > 5 else "")
            yield f"cannot be exact, the record lacks ticks: {shown}"
        if self.unmatched:
            count, first = len(self.unmatched), self.unmatched[0]
            yield f"no decision to apply for {count} slow steps, the first at k = {first}"
        if self.first_command is None:
            yield "every command is bit-equal"
        else:
            yield f"{self.differing_commands} of {self.ticks} commands differ"
            yield f"first {self.first_command}"
            yield f"largest difference {_text(self.largest)}"
        if self.first_decision is not None:
            yield f"{self.differing_decisions} of {self.slow_steps} slow steps differ"
            yield f"first {self.first_decision}"


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
    if not player.report.ticks:
        raise RecordingError(session.path, "it holds no ticks to replay")
    return player.report


def recorded_ticks(session: Session) -> Iterator[TickReport]:
    """Yield the fast ticks of a session, in their order."""
    return map(partial(rebuild, TickReport), table_rows(session, TableName.TICKS, _COLUMNS))


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
        report: Its result so far.
        known: Ticks whose decisions are known; a session in progress grows while it is replayed.
    """

    def __init__(self, session: Session, controller: TwoRate) -> None:
        self.report = ReplayReport(session.path.name)
        self._controller = controller
        self._schedule = Schedule(controller, latency_ticks=0)  # delivered when it took effect
        steps = table_rows(session, TableName.SLOW, ("k", *_DECIDED))
        self._slow = {row["k"]: row for row in steps}
        self._decided = set(self._slow)
        self.known = 0
        for row in table_rows(session, TableName.TICKS, ("applied_k",)):
            # a decision that took effect was made, even where its own record is lost
            self._decided.add(row["applied_k"])
            self.known += 1
        self._pending: dict[int, tuple[Snapshot, Decision]] = {}
        self._next_sequence = 0

    def play(self, recorded: TickReport) -> None:
        """Replay one tick."""
        tick, missing = recorded.measurement.tick, recorded.sequence - self._next_sequence
        if missing:
            self.report.gaps.append(Gap(before_tick=tick, missing=missing))
        self._next_sequence = recorded.sequence + 1
        if recorded.applied_k >= 0:
            self._deliver(recorded.applied_k)
        command = self._schedule.tick(recorded.measurement, recorded.order)
        self.report.ticks += 1
        self._compare_commands(tick, recorded.command, command)
        snapshot = self._schedule.take_snapshot()
        if snapshot is not None and snapshot.k in self._decided:
            self._decide(snapshot)

    def _deliver(self, k: int) -> None:
        decided = self._pending.pop(k, None)
        if decided is None or not self._schedule.deliver(*decided):
            self.report.unmatched.append(k)
        self._pending = {other: kept for other, kept in self._pending.items() if other > k}

    def _compare_commands(self, tick: int, recorded: Command, replayed: Command) -> None:
        then, now = (
            {name: getattr(command, name) for name in _COMMANDED}
            for command in (recorded, replayed)
        )
        unlike = [name for name in then if _bits(then[name]) != _bits(now[name])]
        if unlike:
            report = self.report
            report.differing_commands += 1
            report.first_command = report.first_command or Difference(tick, then, now)
        for name in unlike:
            distance = _distance(then[name], now[name])
            report.largest[name] = max(distance, report.largest.get(name, 0.0))

    def _decide(self, snapshot: Snapshot) -> None:
        decision = self._controller.decide(snapshot)
        self._pending[snapshot.k] = snapshot, decision
        report = self.report
        report.slow_steps += 1
        if (row := self._slow.get(snapshot.k)) is None:
            return
        then = {name: row[name] for name in _DECIDED}
        now = {name: getattr(decision, name) for name in _DECIDED}
        now |= {"controller": decision.controller.value, "gains": list(decision.gains)}
        if any(_bits(then[name]) != _bits(now[name]) for name in then):
            report.differing_decisions += 1
            report.first_decision = report.first_decision or Difference(snapshot.tick, then, now)


def _bits(value: Any) -> Any:  # noqa: ANN401 - whatever a column holds
    """Return numbers as their bits; one NaN is as good as another."""
    if isinstance(value, list):
        return [_bits(one) for one in value]
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value
    return "NaN" if math.isnan(value) else struct.pack("<d", value)


def _distance(recorded: object, replayed: object) -> float:
    """Return the distance of two numbers; infinite if one of them is not a number."""
    if isinstance(recorded, float) and isinstance(replayed, int | float):
        distance = abs(recorded - replayed)
        return math.inf if math.isnan(distance) else distance
    return math.inf


def _text(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} = {value!r}" for name, value in values.items())


# Replay of a recorded configuration with some of its keys changed.


def reconfigured(text: str, source: Path, settings: Sequence[str]) -> Configuration:
    """Validate a configuration after setting keys such as `estimator.forgetting=0.95` in it.

    Args:
        text: The configuration, as TOML.
        source: Where it came from.
        settings: `KEY=VALUE`; the value as in TOML, but a string needs no quotes.

    Returns:
        The configuration, whole and consistent.

    Raises:
        ConfigurationError: A setting or its outcome is not valid; the key is named.
    """
    tables = read_tables(text, source)
    flaws = [flaw for setting in settings if (flaw := _set(tables, setting))]
    if flaws:
        raise ConfigurationError(source, flaws)
    return validate_configuration(tables, source)


def acts(text: str, source: Path, setting: str, acting: Callable[[Configuration], object]) -> bool:
    """Return whether a setting changes what acts; one that needs another setting, too, does.

    Args:
        text: The configuration, as TOML.
        source: Where it came from.
        setting: `KEY=VALUE`.
        acting: Returns what of a configuration acts.
    """
    try:
        changed = reconfigured(text, source, (setting,))
    except ConfigurationError:
        return True
    return acting(changed) != acting(reconfigured(text, source, ()))


def _set(tables: dict[str, Any], setting: str) -> Flaw | None:
    """Set one key in place; tables on the way are made. The flaw that prevents it, if any."""
    key, equals, value = setting.partition("=")
    path = [part.strip() for part in key.split(".")]
    if not equals or not all(path):
        return Flaw(setting, "is not KEY=VALUE, such as estimator.forgetting=0.95")
    table: Any = tables
    for depth, part in enumerate(path[:-1], 1):
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            return Flaw(key.strip(), f"{'.'.join(path[:depth])} is a value, not a table")
    table[path[-1]] = _value(value.strip())
    return None


def _value(text: str) -> Any:  # noqa: ANN401  whatever TOML can say
    try:
        tables = tomllib.loads(f"value = {text}")
    except tomllib.TOMLDecodeError:
        return text
    return tables["value"] if len(tables) == 1 else text
