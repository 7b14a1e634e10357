"""The order of calls, against a controller that only writes down how it is called."""

import math
from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.control.schedule import Schedule
from adaptdrive.control.signals import (
    SAFE_COMMAND,
    Command,
    Decision,
    Measurement,
    Mode,
    Order,
    Snapshot,
    Stage,
)

Q = 10


def make_order(stage: Stage) -> Order:
    return Order(stage, 3.0, Mode.FIXED, 0.7)


def make_decision(k: int) -> Decision:
    nan = math.nan
    return Decision(k, 250.0, Mode.FIXED, False, "", {}, (), nan, nan, nan)


@dataclass
class Scribe:
    """Takes a snapshot at each whole multiple of Q while it runs."""

    calls: list[tuple[str, int]] = field(default_factory=list)
    snapshot: Snapshot | None = None

    def tick(self, measurement: Measurement, order: Order) -> Command:
        tick = measurement.tick
        self.calls.append(("tick", tick))
        if order.stage is Stage.RUN and tick % Q == 0:
            self.snapshot = Snapshot(tick // Q, tick, 0.1, order, 3.0, (), (), 280.0, True, 0)
        return SAFE_COMMAND

    def take_snapshot(self) -> Snapshot | None:
        taken, self.snapshot = self.snapshot, None
        return taken

    def decide(self, snapshot: Snapshot) -> Decision:
        self.calls.append(("decide", snapshot.k))
        return make_decision(snapshot.k)

    def apply(self, decision: Decision) -> None:
        self.calls.append(("apply", decision.k))


@dataclass
class Bench:
    latency: int = 2
    scribe: Scribe = field(default_factory=Scribe)

    def __post_init__(self) -> None:
        self.schedule = Schedule(self.scribe, self.latency)

    def run(self, first: int, last: int, stage: Stage = Stage.RUN) -> list[Snapshot]:
        taken = []
        for tick in range(first, last):
            self.schedule.tick(Measurement(tick, 0.01, 280.0, 120.0, 0.0, 3.0), make_order(stage))
            snapshot = self.schedule.take_snapshot()
            if snapshot is not None:
                taken.append(snapshot)
        return taken

    def applied(self) -> list[tuple[int, int]]:
        """Slow index and tick of each decision that took effect."""
        calls = self.scribe.calls
        return [(k, calls[i + 1][1]) for i, (name, k) in enumerate(calls) if name == "apply"]


@given(latency=st.integers(1, Q - 1))
def test_a_decision_takes_effect_at_kq_plus_l(latency: int) -> None:
    bench = Bench(latency)
    for k in range(1, 4):
        (snapshot,) = bench.run(Q * k, Q * k + 1)
        bench.schedule.decide(snapshot)
        bench.run(Q * k + 1, Q * (k + 1))
    assert bench.applied() == [(k, Q * k + latency) for k in range(1, 4)]
    assert bench.schedule.late_decisions == 0


def test_a_late_decision_takes_effect_at_once_and_counts() -> None:
    bench = Bench()
    (snapshot,) = bench.run(10, 17)
    bench.schedule.deliver(snapshot, make_decision(snapshot.k))
    bench.run(17, 19)
    assert bench.applied() == [(1, 17)]
    assert bench.schedule.late_decisions == 1


@pytest.mark.parametrize("stage", [Stage.OFF, Stage.PRECHARGE])
def test_a_decision_is_void_when_its_run_ends(stage: Stage) -> None:
    bench = Bench()
    (snapshot,) = bench.run(10, 11)
    assert bench.schedule.deliver(snapshot, make_decision(snapshot.k))
    bench.run(11, 12, stage)
    bench.run(12, 20)
    assert bench.applied() == []


def test_a_decision_of_an_earlier_run_is_refused() -> None:
    bench = Bench()
    (snapshot,) = bench.run(10, 11)
    bench.run(11, 12, Stage.OFF)
    assert bench.schedule.deliver(snapshot, make_decision(snapshot.k)) is False
    bench.run(12, 13)
    assert bench.schedule.deliver(snapshot, make_decision(snapshot.k)) is False


def test_the_tick_of_effect_names_its_decision() -> None:
    bench = Bench()
    (snapshot,) = bench.run(10, 11)
    bench.schedule.decide(snapshot)
    named = []
    for tick in range(11, 15):
        bench.run(tick, tick + 1)
        named.append(bench.schedule.applied_k)
    assert named == [-1, 1, -1, -1]
