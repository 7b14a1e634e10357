"""Which interlock is evaluated when, with watches that note how they are called."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import pytest

from adaptdrive.control.signals import Command
from adaptdrive.runtime.timebase import HalfCycles
from adaptdrive.safety.facts import Reading
from adaptdrive.safety.frames import FrameRate
from adaptdrive.safety.interlocks import InterlockBoard, Limits
from adaptdrive.safety.timing import Timing
from adaptdrive.safety.trips import Trip
from adaptdrive.util.quantity import Display
from tests.loopback_port import LoopbackPort
from tests.support import a_trip, text_of
from tests.unit.runtime.bench import CALM

TICK_S = 2.0**-7
"""A half cycle whose multiples are exact."""

START_S = 64.0
STALE_S = 0.0625
LIMITS = Limits(boost_voltage_max_V=430.0, output_max=5.0, display=Display("V"))


@dataclass
class NotedWatch:
    """Gives the cause that a test sets."""

    cause: str | None = None
    seen: list[float] = field(default_factory=list)
    forgotten: int = 0

    def forget(self) -> None:
        self.forgotten += 1

    def find_cause(self, reading: Reading) -> Trip | None:
        self.seen.append(reading.output)
        return None if self.cause is None else a_trip(self.cause)


def new_board(
    *watches: NotedWatch, rate: FrameRate | None = None, ticks_per_reading: int = 1
) -> InterlockBoard:
    """A board that has not been looked at yet."""
    timing = Timing(TICK_S, STALE_S, ticks_per_reading)
    port = LoopbackPort(lambda _: None, timing=timing)
    return InterlockBoard(LIMITS, timing, watches, port, HalfCycles(None, TICK_S).counts, rate)


def board(*watches: NotedWatch, ticks_per_reading: int = 1) -> InterlockBoard:
    """A board without a rate, that has been looked at once."""
    built = new_board(*watches, ticks_per_reading=ticks_per_reading)
    built.look(START_S)
    return built


def cause_of(
    of: InterlockBoard, now_s: float, *, running: bool = True, bridge: bool = False,
    **changes: object,
) -> str | None:  # fmt: skip
    reading = replace(CALM, arrival_s=now_s, oldest_s=now_s, **changes)  # type: ignore[arg-type]
    monitor = of._port.monitor
    monitor.command(Command(0.0, 300.0, bridge=bridge))
    monitor.report(on=reading.bridge, asked_s=now_s, came_s=now_s)
    return text_of(of.running_cause(reading, now_s, running=running, bridge=bridge))


@pytest.mark.parametrize(("ticks_per_reading", "limit_ticks"), [(1, 8), (60, 120)])
def test_a_gap_may_last_as_long_as_a_reading_is_fresh_and_two_readings_take(
    ticks_per_reading: int, limit_ticks: int
) -> None:
    limit_s = limit_ticks * TICK_S
    of = board(ticks_per_reading=ticks_per_reading)
    assert of.gap_cause(START_S + limit_s) is None
    assert cause_of(of, START_S + limit_s) is None
    again_s = START_S + 2.0 * limit_s + TICK_S
    told = (
        f"overslept: the daemon did not run for {1e3 * (limit_s + TICK_S):.0f} ms, "
        f"limit {1e3 * limit_s:g} ms: "
    )
    assert str(of.gap_cause(again_s)).startswith(told)
    assert (cause_of(of, again_s) or "").startswith(told)
    assert cause_of(of, again_s + limit_s) is None


def test_while_a_drive_starts_its_watches_forget() -> None:
    watches = NotedWatch("first"), NotedWatch("second")
    assert cause_of(board(*watches), START_S, running=False) is None
    assert [(one.seen, one.forgotten) for one in watches] == [([], 1), ([], 1)]


def test_a_watch_is_asked_when_nothing_else_trips_and_forgets_nothing_in_a_run() -> None:
    watch = NotedWatch("stuck")
    of = board(watch)
    assert (cause_of(of, START_S, output=6.0) or "").startswith("output above its limit: ")
    assert watch.seen == []
    assert cause_of(of, START_S) == "stuck"
    assert watch.forgotten == 0


def test_without_a_reading_a_drive_is_not_energised() -> None:
    cause = board().running_cause(None, START_S, running=True, bridge=True)
    assert str(cause) == "stale: no measurement yet"


@pytest.mark.parametrize("running", [False, True])
@pytest.mark.parametrize("bridge", [False, True])
def test_a_bridge_has_to_be_on_where_it_was_commanded_in_a_run(
    *, running: bool, bridge: bool
) -> None:
    of, causes = board(), []
    for number in range(60):
        now_s = START_S + number * TICK_S
        causes.append(cause_of(of, now_s, running=running, bridge=bridge))
    stopped = "drive stopped: its bridge is off although it was commanded on; it has not come on"
    stopped += f" within {30e3 * TICK_S:.0f} ms"
    assert causes[-1] == (stopped if running and bridge else None)


def rate_of(share: float, readings: int) -> FrameRate:
    """The rate of a drive that sends at a share of the right one."""
    rate = FrameRate(TICK_S, 1, counted=True)
    for number in range(readings):
        rate.add(START_S + number * TICK_S / share, 1, stood_in=False)
    return rate


@pytest.mark.parametrize(
    ("rate", "known", "cause"),
    [
        (None, True, None),
        (rate_of(1.0, 30), False, None),
        (rate_of(1.0, 240), True, None),
        (rate_of(0.8, 240), False, "frame rate: the drive sends 102.4 readings/s"),
    ],
)
def test_the_rate_of_a_drive_that_is_the_clock_must_be_known_and_right(
    rate: FrameRate | None, *, known: bool, cause: str | None
) -> None:
    of = new_board(rate=rate)
    assert (of.unknown_rate(START_S) is None) is known
    reading = replace(CALM, arrival_s=START_S, oldest_s=START_S)
    standing = of.standing_cause(reading, START_S)
    assert standing is None if cause is None else str(standing).startswith(cause)


@pytest.mark.parametrize(
    ("pauses_ticks", "named_ms"),
    [
        ((), None),
        ((3.0,), None),  # as late as a reading may be
        ((9.0,), 70),
        ((9.0, 20.0, 9.0), 156),
        ((20.0, *[1.0] * 230), 156),
        ((20.0, *[1.0] * 250), None),  # a rate is judged over 240 half cycles
        ((20.0, *[1.0] * 250, 9.0), 70),
    ],
)
@pytest.mark.parametrize("rate", [rate_of(1.0, 30), rate_of(0.8, 240)])
def test_a_busy_machine_is_named_where_its_pauses_may_be_what_is_wrong_with_the_rate(
    rate: FrameRate, pauses_ticks: tuple[float, ...], named_ms: int | None
) -> None:
    of, now_s = new_board(rate=rate), START_S
    of.look(now_s)
    for pause_ticks in pauses_ticks:
        now_s += pause_ticks * TICK_S
        of.look(now_s)
    reading = replace(CALM, arrival_s=now_s, oldest_s=now_s)
    said = of.unknown_rate(now_s) if rate.cause is None else of.standing_cause(reading, now_s)
    named = f"this machine was busy: the daemon did not run for {named_ms} ms"
    assert (named in str(said)) is (named_ms is not None)
    assert ("gateway" in str(said)) is (rate.cause is None and named_ms is None)
    assert ("line_frequency_Hz" in str(said)) is (rate.cause is not None)


def test_a_count_may_stand_for_as_long_as_a_reading_is_fresh() -> None:
    rate = FrameRate(TICK_S, 1, counted=True)
    of = new_board(rate=rate)
    rate.add(START_S, None, stood_in=False)
    for number in range(1, 10):
        now_s = START_S + number * TICK_S
        rate.add(now_s, None, stood_in=False, repeated=True)
        reading = replace(CALM, arrival_s=now_s, oldest_s=now_s)
        standing = of.standing_cause(reading, now_s)
        assert (standing is None) == (number <= 8)
    assert standing is not None
    assert str(standing).startswith(
        "half-cycle counter: the drive's count has stood for 70 ms while"
    )
    assert "limit 62.5 ms" in str(standing)
