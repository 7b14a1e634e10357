"""Replay against a small two-rate controller with memory in both halves."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from adaptdrive.analysis.replay import replay
from adaptdrive.control.signals import (
    Command,
    Decision,
    Estimate,
    Measurement,
    Mode,
    Order,
    Snapshot,
    Stage,
)
from adaptdrive.recording.reader import Session, read_session
from adaptdrive.recording.records import Header
from adaptdrive.recording.session import create_session
from adaptdrive.runtime.reports import LoadReport, TickReport
from adaptdrive.util.errors import RecordingError
from tests.unit.recording.material import INFO, make_batch, record_messages

Q = 12
LATENCY = 2
LATE_K = 7
NEVER_DECIDED_K = 11
MISSED_HALF_CYCLES = (100, 101, 250)
MODE_CHANGE = 180


@dataclass
class StandIn:
    """The slow half learns a gain and asks for a voltage; the fast half integrates towards it."""

    step: float = 0.37
    voltage: float = 250.0
    total: float = 0.0
    last_tick: int = 0
    gain: float = 1.0
    snapshot: Snapshot | None = None

    def tick(self, measurement: Measurement, order: Order) -> Command:
        elapsed = measurement.tick - self.last_tick
        self.total += math.sin(measurement.output) * elapsed / 3.0
        if measurement.tick // Q != self.last_tick // Q:
            k, output = measurement.tick // Q, measurement.output
            period_s = Q * measurement.tick_period_s
            self.snapshot = Snapshot(
                k, measurement.tick, period_s, order, output, (), (), 280.0, True, 0
            )
        self.last_tick = measurement.tick
        return Command(self.total / self.voltage, self.voltage, order.stage is Stage.RUN)

    def take_snapshot(self) -> Snapshot | None:
        taken, self.snapshot = self.snapshot, None
        return taken

    def decide(self, snapshot: Snapshot) -> Decision:
        adaptive = snapshot.order.mode is Mode.ADAPTIVE
        if adaptive:
            self.gain += self.step * math.tanh(snapshot.output - self.gain)
        voltage = 250.0 + 10.0 * self.gain * (snapshot.order.reference - snapshot.output)
        estimates = {"g": Estimate(self.gain, math.nan)}
        gains = (self.gain, math.nan)
        mode = snapshot.order.mode
        return Decision(snapshot.k, voltage, mode, adaptive, "", estimates, gains, 0.1, 0.2, 0.3)

    def apply(self, decision: Decision) -> None:
        self.voltage = decision.boost_reference_V


@dataclass
class Daemon:
    """Runs a controller as the runtime does, and reports it."""

    controller: StandIn
    ticks: list[TickReport] = field(default_factory=list)
    slow: list[LoadReport] = field(default_factory=list)
    waiting: dict[int, Decision] = field(default_factory=dict)

    def run(self, ticks: int) -> None:
        for tick in range(1, ticks):
            if tick not in MISSED_HALF_CYCLES:
                self._run_tick(tick)

    def _run_tick(self, tick: int) -> None:
        measurement = Measurement(
            tick, 1 / 120, 280.0, 120.0, 400.0, 3.0 + math.sin(tick / 7.0), tick % 50 != 0
        )
        mode = Mode.ADAPTIVE if tick >= MODE_CHANGE else Mode.FIXED
        order = Order(Stage.RUN if tick > 5 else Stage.OFF, 3.2, mode, 0.7)
        decision = self.waiting.pop(tick, None)
        if decision is not None:
            self.controller.apply(decision)
        command = self.controller.tick(measurement, order)
        k = -1 if decision is None else decision.k
        self.ticks.append(
            TickReport(len(self.ticks), measurement, order, k, command, 10.0, math.nan)
        )
        snapshot = self.controller.take_snapshot()
        if snapshot is not None and snapshot.k != NEVER_DECIDED_K:
            self._decide(snapshot)

    def _decide(self, snapshot: Snapshot) -> None:
        decision = self.controller.decide(snapshot)
        late = 5 if snapshot.k == LATE_K else 0
        self.waiting[snapshot.tick + LATENCY + late] = decision
        self.slow.append(LoadReport(snapshot, decision))


@pytest.fixture
def daemon() -> Daemon:
    daemon = Daemon(StandIn())
    daemon.run(600)
    return daemon


def recorded(directory: Path, ticks: Sequence[TickReport], slow: Sequence[LoadReport]) -> Session:
    record_messages(directory, Header(INFO, ""), make_batch(ticks, slow, last=True))
    return read_session(directory)


def commands(step: float) -> Iterator[tuple[int, Command]]:
    """The commands of a run with that gain: a second way to where a replay should differ."""
    daemon = Daemon(StandIn(step=step))
    daemon.run(600)
    return ((report.measurement.tick, report.command) for report in daemon.ticks)


def test_a_whole_record_replays_to_the_same_commands(directory: Path, daemon: Daemon) -> None:
    report = replay(recorded(directory, daemon.ticks, daemon.slow), StandIn())
    assert report.exact
    assert report.ticks == 599 - len(MISSED_HALF_CYCLES)
    assert report.slow_steps == len(daemon.slow) == 48
    assert report.differing_decisions == 0
    assert "every command is bit-equal" in str(report)


def test_a_changed_gain_is_found_at_the_tick_where_it_first_matters(
    directory: Path, daemon: Daemon
) -> None:
    pairs = list(zip(commands(0.37), commands(0.38), strict=True))
    unlike = [(tick, ours, theirs) for (tick, ours), (_, theirs) in pairs if ours != theirs]
    tick, ours, theirs = unlike[0]
    report = replay(recorded(directory, daemon.ticks, daemon.slow), StandIn(step=0.38))
    assert not report.exact
    assert report.differing_commands == len(unlike)
    assert report.first_command is not None
    assert report.first_command.tick == tick > MODE_CHANGE
    assert report.first_command.recorded["boost_reference_V"] == ours.boost_reference_V
    assert report.first_command.replayed["boost_reference_V"] == theirs.boost_reference_V
    assert report.largest["boost_reference_V"] == max(
        abs(ours.boost_reference_V - theirs.boost_reference_V) for _, ours, theirs in unlike
    )
    assert report.first_decision is not None
    assert report.first_decision.tick == tick - LATENCY
    assert f"{len(unlike)} of {report.ticks} commands differ" in str(report)
    assert f"first at tick {tick}: recorded" in str(report)


def test_one_bit_is_a_difference(directory: Path, daemon: Daemon) -> None:
    changed = daemon.ticks[300]
    scale = math.nextafter(changed.command.current_scale_S, math.inf)
    daemon.ticks[300] = replace(changed, command=replace(changed.command, current_scale_S=scale))
    report = replay(recorded(directory, daemon.ticks, daemon.slow), StandIn())
    assert report.differing_commands == 1
    assert report.first_command is not None
    assert report.first_command.tick == changed.measurement.tick
    assert report.largest == {"current_scale_S": scale - changed.command.current_scale_S}


def test_minus_zero_is_not_zero_and_any_nan_is_nan(directory: Path) -> None:
    class Constant(StandIn):
        def tick(self, measurement: Measurement, order: Order) -> Command:
            return Command(0.0, -math.nan, False)

    order = Order(Stage.OFF, 0.0, Mode.FIXED, 0.7)
    answers = [Command(0.0, math.nan, False), Command(-0.0, math.nan, False)]
    ticks = [
        TickReport(i, Measurement(i, 0.01, 0.0, 0.0, 0.0, 0.0), order, -1, answer, 0.0, 0.0)
        for i, answer in enumerate(answers)
    ]
    report = replay(recorded(directory, ticks, []), Constant())
    assert report.differing_commands == 1
    assert report.first_command is not None
    assert report.first_command.tick == 1
    assert report.largest == {"current_scale_S": 0.0}


def test_ticks_missing_from_the_record_are_told_apart_from_missed_half_cycles(
    directory: Path, daemon: Daemon
) -> None:
    ticks = daemon.ticks[:300] + daemon.ticks[320:]
    report = replay(recorded(directory, ticks, daemon.slow), StandIn())
    (gap,) = report.gaps
    assert gap.missing == 20
    assert gap.before_tick == daemon.ticks[320].measurement.tick
    assert not report.exact
    assert f"the record lacks ticks: 20 before tick {gap.before_tick}" in str(report)


def test_slow_steps_missing_from_the_record_do_not_spoil_the_commands(
    directory: Path, daemon: Daemon
) -> None:
    assert replay(recorded(directory, daemon.ticks, []), StandIn()).exact


def test_a_decision_that_took_effect_from_nowhere_is_reported(
    directory: Path, daemon: Daemon
) -> None:
    daemon.ticks[200] = replace(daemon.ticks[200], applied_k=4711)
    report = replay(recorded(directory, daemon.ticks, daemon.slow), StandIn())
    assert report.unmatched == [4711]
    assert not report.exact
    assert "the first at k = 4711" in str(report)


def test_a_record_without_ticks_is_an_error(directory: Path) -> None:
    with pytest.raises(RecordingError, match="no ticks"):
        replay(recorded(directory, [], []), StandIn())


def test_a_session_that_grows_meanwhile_is_replayed_as_far_as_it_was_known(
    tmp_path: Path, daemon: Daemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = 400
    early = [report for report in daemon.slow if report.snapshot.tick < known]
    begun, grown = (
        recorded(create_session(tmp_path / name, INFO, ""), ticks, slow)
        for name, ticks, slow in (
            ("begun", daemon.ticks[:known], early),
            ("grown", daemon.ticks, daemon.slow),
        )
    )
    look = Session.batches
    looks = iter((begun, begun, grown))  # slow steps, ticks, and the ticks again
    monkeypatch.setattr(Session, "batches", lambda _, *words: look(next(looks), *words))
    report = replay(grown, StandIn())
    assert report.exact
    assert report.ticks == known
