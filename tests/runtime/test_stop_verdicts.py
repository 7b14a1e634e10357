"""The verdict on a stop from what the drive reports, moment by moment, in exact times."""

from __future__ import annotations

import math
from dataclasses import replace

from adaptdrive.config.timing import Timing
from adaptdrive.runtime.stop_watch import Stop, StopWatch
from tests.runtime.bench import CALM

READING_S = 2.0**-7
LIMIT_S = 0.5
STOP_S = 64.0
TIMING = Timing(READING_S, stale_s=0.05, start_s=0.25, stop_s=LIMIT_S)


class Watched:
    """A stop at 64 s, and the readings after it."""

    def __init__(self, slack_s: float | None = 0.0) -> None:
        self.watch = StopWatch(TIMING, slack_s)
        self.watch.command(STOP_S)

    def judge(self, after_s: float, *, bridge: bool, safe_s: float = -math.inf) -> Stop:
        now_s = STOP_S + after_s
        reading = replace(CALM, arrival_s=now_s, oldest_s=now_s, bridge=bridge)
        return self.watch.judge(reading, safe_s, now_s)


def test_a_stop_may_last_as_long_as_its_limit() -> None:
    watched = Watched()
    assert watched.judge(LIMIT_S, bridge=True) is Stop.AWAITED
    assert watched.judge(LIMIT_S + READING_S, bridge=True) is Stop.OVERDUE


def test_a_report_that_comes_later_has_longer() -> None:
    watched = Watched(slack_s=0.25)
    assert watched.judge(0.75, bridge=True) is Stop.AWAITED
    assert watched.judge(0.75 + READING_S, bridge=True) is Stop.OVERDUE


def test_a_drive_without_a_word_has_stopped_when_it_has_taken_the_command() -> None:
    watched = Watched(slack_s=None)
    assert watched.judge(0.1, bridge=True, safe_s=math.inf) is Stop.AWAITED
    assert watched.judge(0.2, bridge=True, safe_s=STOP_S) is Stop.CONFIRMED


def test_two_flickers_with_the_bridge_off_between_them_deny_nothing() -> None:
    watched = Watched()
    for number in range(10):
        assert watched.judge(number + 1.0, bridge=False) is Stop.CONFIRMED
        assert watched.judge(number + 1.5, bridge=True) is Stop.CONFIRMED


def test_a_denied_stop_begins_anew() -> None:
    watched = Watched()
    watched.judge(1.0, bridge=False)
    verdicts = [watched.judge(2.0 + 0.25 * number, bridge=True) for number in range(5)]
    assert verdicts == [Stop.CONFIRMED, Stop.DENIED, Stop.AWAITED, Stop.AWAITED, Stop.OVERDUE]
    assert watched.judge(4.0, bridge=False) is Stop.CONFIRMED


def test_a_drive_that_was_energised_confirms_its_next_stop_anew() -> None:
    watched = Watched()
    watched.judge(1.0, bridge=False)
    watched.judge(1.5, bridge=True)
    watched.watch.release()
    watched.watch.command(STOP_S + 2.0)
    assert watched.judge(2.25, bridge=True) is Stop.AWAITED
    assert watched.judge(2.5, bridge=False) is Stop.CONFIRMED
    assert watched.judge(3.0, bridge=True) is Stop.CONFIRMED
    assert watched.judge(3.5, bridge=True) is Stop.DENIED


def test_the_reason_names_the_time_since_the_stop() -> None:
    watched = Watched()
    why = watched.watch.why_not(None, math.inf, STOP_S + 2.0)
    assert why.startswith("it has not taken the safe command 2000 ms after the stop; ")


class Started:
    """The start of a drive at 64 s, whose bridge stays off while its boost voltage rises."""

    def __init__(self, *, confirmed: bool) -> None:
        self.watch = StopWatch(TIMING, 0.0)
        self.watch.command(STOP_S)
        if confirmed:
            off = replace(CALM, arrival_s=STOP_S + 0.25, oldest_s=STOP_S + 0.25, bridge=False)
            assert self.watch.judge(off, STOP_S, STOP_S + 0.25) is Stop.CONFIRMED

    def judge(self, after_s: float, *, bridge: bool) -> Stop:
        now_s = STOP_S + after_s
        reading = replace(CALM, arrival_s=now_s, oldest_s=now_s, bridge=bridge)
        return self.watch.judge(reading, -math.inf, now_s)


def test_a_bridge_that_was_off_before_the_start_denies_it_by_its_second_reading() -> None:
    started = Started(confirmed=True)
    assert started.judge(0.5, bridge=True) is Stop.CONFIRMED
    assert started.judge(0.5, bridge=True) is Stop.CONFIRMED  # the same reading
    assert started.judge(0.625, bridge=True) is Stop.DENIED


def test_a_flicker_in_the_start_denies_nothing() -> None:
    started = Started(confirmed=True)
    for number in range(10):
        assert started.judge(1.0 + number, bridge=True) is Stop.CONFIRMED
        assert started.judge(1.5 + number, bridge=False) is Stop.CONFIRMED


def test_a_stop_that_a_start_has_cut_short_may_last_as_long_as_any() -> None:
    started = Started(confirmed=False)
    assert started.judge(LIMIT_S, bridge=True) is Stop.AWAITED
    assert started.judge(LIMIT_S + READING_S, bridge=True) is Stop.OVERDUE


def test_an_off_in_the_start_is_its_stop_and_a_bridge_that_is_on_after_it_denies_it() -> None:
    started = Started(confirmed=False)
    assert started.judge(0.125, bridge=False) is Stop.CONFIRMED
    assert started.judge(0.25, bridge=True) is Stop.CONFIRMED
    assert started.judge(0.375, bridge=True) is Stop.DENIED


def test_an_off_from_the_moment_of_the_stop_is_none_of_it() -> None:
    started = Started(confirmed=False)
    assert started.judge(0.0, bridge=False) is Stop.AWAITED
    assert started.judge(0.25, bridge=True) is Stop.AWAITED
    assert started.judge(0.375, bridge=True) is Stop.AWAITED
