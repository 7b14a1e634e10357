"""When a bridge that is off although it was commanded on is a stop, in exact times."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from adaptdrive.config.timing import Timing
from adaptdrive.runtime.bridge_watch import BridgeWatch
from tests.runtime.bench import CALM

TICK_S = 2.0**-7
STOPPED = "drive stopped: its bridge is off although it was commanded on"


def never_on(half_cycles: int) -> str:
    return f"{STOPPED}; it has not come on within {half_cycles * 1e3 * TICK_S:.0f} ms"


class Seen:
    """A drive whose bridge is looked at."""

    def __init__(
        self,
        ticks_per_reading: int = 1,
        *,
        reported: bool = True,
        cycle: float = 0.0,
        timeout: float | None = None,
    ) -> None:
        self._watch = BridgeWatch(
            Timing(
                TICK_S,
                stale_s=0.05,
                ticks_per_reading=ticks_per_reading,
                command_timeout_s=None if timeout is None else timeout * TICK_S,
            ),
            reported=reported,
            cycle_s=cycle * TICK_S,
        )
        self.cause: str | None = None

    def look(
        self,
        ticks: float,
        *,
        bridge: bool,
        commanded: bool = True,
        due: bool = True,
        unwatched: float = 1.0,
        old: float = 0.0,
        reported: float | None = None,
        polled: float = 0.0,
    ) -> bool:
        """Return whether it has stopped, some half cycles after 64 s, by a reading of that age.

        The bridge in it was reported at the same time, or so many half cycles ago. A poll for the
        reading took some half cycles.
        """
        now_s = 64.0 + ticks * TICK_S
        time_s = now_s - old * TICK_S
        bridge_s = None if reported is None else now_s - reported * TICK_S
        oldest_s = time_s - polled * TICK_S
        reading = replace(
            CALM, arrival_s=time_s, oldest_s=oldest_s, bridge=bridge, bridge_s=bridge_s
        )
        self.cause = self._watch.find_cause(
            reading, commanded=commanded, due=due, unwatched_s=unwatched * TICK_S, now_s=now_s
        )
        assert self.cause is None or self.cause.startswith(STOPPED)
        return self.cause is not None

    @property
    def awaits_report(self) -> bool:
        return self._watch.must_report(0.0)

    def awaits_from(self, limit: float, of: str) -> None:
        """A report is waited for from a time on, and not before, in which none has come."""
        for ticks, awaited in ((limit - 0.1, False), (limit + 0.1, True)):
            ages: dict[str, Any] = {of: ticks}
            self.look(ticks, bridge=True, **ages)
            assert self.awaits_report is awaited

    def must_report(self, unwatched: float) -> bool:
        return self._watch.must_report(unwatched * TICK_S)


@pytest.mark.parametrize(("ticks_per_reading", "last"), [(1, 29), (10, 20), (60, 120)])
def test_a_bridge_has_thirty_half_cycles_and_three_readings(
    ticks_per_reading: int, last: int
) -> None:
    seen = Seen(ticks_per_reading)
    assert not seen.look(0.0, bridge=False)
    assert not seen.look(last, bridge=False)
    assert seen.look(last + 1.5e-6 / TICK_S, bridge=False)
    assert seen.cause == never_on(max(30, 3 * ticks_per_reading))


def test_a_bridge_that_need_not_be_on_begins_anew() -> None:
    seen = Seen()
    seen.look(0.0, bridge=False)
    seen.look(20.0, bridge=False, commanded=False)
    assert not seen.look(40.0, bridge=False)
    assert not seen.look(69.0, bridge=False)
    assert seen.look(70.0, bridge=False)


@pytest.mark.parametrize("due", [False, True])
def test_a_bridge_that_has_come_on_and_is_off_is_a_stop_at_once(*, due: bool) -> None:
    seen = Seen()
    seen.look(0.0, bridge=False, commanded=False)
    seen.look(1.0, bridge=False, due=due)
    assert not seen.look(2.0, bridge=True, due=due)
    assert seen.look(32.0, bridge=False, due=due)
    assert seen.cause == STOPPED


@pytest.mark.parametrize("due", [False, True])
def test_a_bridge_that_bounces_while_it_switches_on_is_no_stop(*, due: bool) -> None:
    """A contact that opens once more; what energises waits for the next report."""
    seen = Seen()
    seen.look(0.0, bridge=False, commanded=False)
    seen.look(1.0, bridge=False, due=due)
    for ticks in (2.0, 4.0, 30.0):
        assert not seen.look(ticks, bridge=True, due=due)
        assert not seen.awaits_report
        assert not seen.look(ticks + 1.0, bridge=False, due=due)
        assert seen.awaits_report
    assert not seen.look(32.0, bridge=True, due=due)
    assert not seen.awaits_report


def test_a_bridge_that_is_commanded_off_while_it_bounces_begins_anew() -> None:
    seen = Seen()
    seen.look(0.0, bridge=True)
    seen.look(1.0, bridge=False)
    seen.look(2.0, bridge=False, commanded=False)
    assert not seen.awaits_report
    seen.look(3.0, bridge=True)
    assert not seen.look(4.0, bridge=False)


def test_a_bridge_that_stays_off_while_it_switches_on_is_a_stop() -> None:
    seen = Seen()
    seen.look(0.0, bridge=False, commanded=False)
    seen.look(1.0, bridge=True)
    assert not seen.look(2.0, bridge=False)
    assert not seen.look(2.5, bridge=False, old=0.5)
    assert seen.look(3.0, bridge=False)
    assert seen.cause == STOPPED


@pytest.mark.parametrize("silent", [False, True])
def test_a_bridge_that_had_the_time_to_stop_unseen_does_not_bounce(*, silent: bool) -> None:
    seen = Seen()
    seen.look(0.0, bridge=True)
    seen.look(14.0, bridge=True, old=14.0 if silent else 0.0, unwatched=1.0 if silent else 14.0)
    assert seen.look(15.0, bridge=False)


@pytest.mark.parametrize(("last_on", "stopped"), [(31.0, False), (32.0, True)])
def test_a_bridge_that_was_still_on_at_the_command_has_been_on_by_it_after_its_time(
    last_on: float, *, stopped: bool
) -> None:
    seen = Seen()
    seen.look(0.0, bridge=True, commanded=False)
    seen.look(1.0, bridge=True)
    assert not seen.look(last_on, bridge=True)
    assert seen.look(last_on + 1.0, bridge=False) is stopped


def test_a_bridge_that_was_still_on_at_the_command_and_has_switched_must_stay_on() -> None:
    seen = Seen()
    seen.look(0.0, bridge=True, commanded=False)
    assert not seen.look(1.0, bridge=True)
    assert not seen.look(2.0, bridge=False)
    assert not seen.look(3.0, bridge=True)
    assert seen.look(32.0, bridge=False)


def test_a_report_from_before_the_command_begins_no_time() -> None:
    """Its message comes once in 128 half cycles: the first one after the command is 2 later."""
    seen = Seen()
    assert not seen.look(0.0, bridge=False, old=126.0)
    assert not seen.look(2.0, bridge=False)
    assert not seen.look(29.0, bridge=False)
    assert seen.look(30.0, bridge=False)


def test_a_bridge_need_not_come_on_while_its_drive_starts() -> None:
    seen = Seen()
    assert not seen.look(0.0, bridge=False, due=False)
    assert not seen.look(100.0, bridge=False, due=False)
    assert not seen.look(101.0, bridge=False)
    assert not seen.look(130.0, bridge=False)
    assert seen.look(131.0, bridge=False)


@pytest.mark.parametrize("unwatched", [1.0, 2.1])
def test_a_bridge_that_has_come_on_must_stay_on_while_its_drive_starts(unwatched: float) -> None:
    seen = Seen()
    seen.look(0.0, bridge=True, due=False)
    assert seen.look(31.0, bridge=False, due=False, unwatched=unwatched)


@pytest.mark.parametrize(("unwatched", "named"), [(2.1, False), (10.0, False), (11.0, True)])
def test_the_time_in_which_a_bridge_went_off_unwatched_is_named(
    unwatched: float, *, named: bool
) -> None:
    """A time that no drive stops for, such as one late stand-in, is not named."""
    seen = Seen()
    seen.look(0.0, bridge=True)
    assert seen.look(11.0, bridge=False, unwatched=unwatched)
    gap = f"; the daemon had not run for {1e3 * unwatched * TICK_S:.0f} ms"
    assert seen.cause == STOPPED + (gap if named else "")


@pytest.mark.parametrize("commanded", [False, True])
def test_a_bridge_that_was_never_on_for_this_daemon_has_its_time(*, commanded: bool) -> None:
    seen = Seen()
    if not commanded:
        seen.look(-1.0, bridge=True, commanded=False)
    assert not seen.look(0.0, bridge=False, unwatched=100.0)


@pytest.mark.parametrize("silent", [False, True])
def test_the_time_in_which_a_bridge_went_off_is_named_in_whole_ms(*, silent: bool) -> None:
    seen = Seen()
    seen.look(0.0, bridge=True)
    if silent:
        seen.look(100.0, bridge=True, old=100.0)
        assert seen.look(101.0, bridge=False)
        assert seen.cause == f"{STOPPED}; nothing had been heard of it for 781 ms"
    else:
        assert seen.look(100.0, bridge=False, unwatched=100.0)
        assert seen.cause == f"{STOPPED}; the daemon had not run for 781 ms"


def test_no_time_is_named_in_which_a_bridge_has_not_come_on() -> None:
    """It has not stopped in that time."""
    seen = Seen()
    seen.look(0.0, bridge=False)
    seen.look(14.0, bridge=False, old=14.0)
    assert seen.look(45.0, bridge=False)
    assert seen.cause == never_on(30)


def test_a_time_unwatched_of_a_drive_that_was_off_is_none_of_the_next_command() -> None:
    seen = Seen()
    seen.look(0.0, bridge=False, commanded=False, unwatched=20.0)
    seen.look(1.0, bridge=True, old=1.5)
    assert not seen.awaits_report


def test_a_bridge_has_its_time_anew_after_each_command() -> None:
    """Its report is from before that command."""
    seen = Seen()
    seen.look(0.0, bridge=False)
    seen.look(50.0, bridge=False, commanded=False)
    seen.look(100.0, bridge=False, old=80.0)
    assert not seen.look(110.0, bridge=False)
    assert seen.look(130.0, bridge=False)


@pytest.mark.parametrize("looks", [1, 3])
def test_a_report_from_before_the_time_unwatched_does_not_end_it(looks: int) -> None:
    seen = Seen()
    seen.look(0.0, bridge=True)
    for number in range(looks):
        age = 11.0 + number
        assert not seen.look(age, bridge=True, old=age, unwatched=1.0 if number else 11.0)
    assert not seen.look(14.0, bridge=True, old=3.0)  # it had not arrived when that time ended
    assert seen.look(15.0, bridge=False)
    assert seen.cause == f"{STOPPED}; the daemon had not run for {1.1e4 * TICK_S:.0f} ms"


def test_the_longest_of_the_times_unwatched_is_named_and_the_last_of_them_counts() -> None:
    seen = Seen()
    seen.look(0.0, bridge=True)
    assert not seen.look(11.0, bridge=True, old=11.0, unwatched=11.0)
    assert not seen.look(16.0, bridge=True, old=2.0, unwatched=5.0)
    assert not seen.look(17.0, bridge=True, old=2.0)
    assert seen.look(18.0, bridge=False)
    assert seen.cause == f"{STOPPED}; the daemon had not run for {1.1e4 * TICK_S:.0f} ms"


@pytest.mark.parametrize("commanded", [False, True])
def test_a_bridge_that_was_on_after_the_time_unwatched_or_off_by_command_ends_that_time(
    *, commanded: bool
) -> None:
    seen = Seen()
    seen.look(0.0, bridge=True)
    assert not seen.look(40.0, bridge=True, old=10.0, unwatched=10.0)
    assert not seen.look(41.0, bridge=True, commanded=commanded, old=0.0 if commanded else 11.0)
    assert not seen.look(42.0, bridge=True, old=1.0)
    assert seen.look(43.0, bridge=False) is commanded
    assert seen.cause == (STOPPED if commanded else None)


@pytest.mark.parametrize(("unwatched_s", "awaits"), [(0.079, False), (0.081, True)])
def test_a_report_from_after_a_time_in_which_a_drive_may_have_stopped_is_waited_for(
    unwatched_s: float, *, awaits: bool
) -> None:
    seen, unwatched = Seen(), unwatched_s / TICK_S
    seen.look(0.0, bridge=True)
    seen.look(20.0, bridge=True, old=8.0, unwatched=unwatched)
    assert seen.awaits_report is awaits
    seen.look(21.0, bridge=True, old=1.0)
    assert seen.awaits_report is awaits
    seen.look(22.0, bridge=True)
    assert not seen.awaits_report


@pytest.mark.parametrize(
    ("timeout", "limit"),
    [(2.0, 1.5), (2.5, 1.5), (4.0, 3.0), (6.0, 4.8), (100.0, 10.24)],
)
def test_a_short_time_out_of_the_drive_shortens_the_time_unwatched(
    timeout: float, limit: float
) -> None:
    """What an unknown time-out permits, 80 ms, is the longest: a drive may start anew, too."""
    for unwatched, awaits in ((limit - 0.1, False), (limit + 0.1, True)):
        seen = Seen(timeout=timeout)
        seen.look(0.0, bridge=True)
        seen.look(20.0, bridge=True, old=1.0, unwatched=unwatched)
        assert seen.awaits_report is awaits


def test_a_time_unwatched_that_leaves_a_drive_on_is_neither_waited_for_nor_named() -> None:
    seen = Seen(timeout=4.0)
    seen.look(0.0, bridge=True)
    seen.look(20.0, bridge=True, old=1.0, unwatched=3.0)
    assert not seen.awaits_report
    assert seen.look(21.0, bridge=False)
    assert seen.cause == STOPPED


@pytest.mark.parametrize(
    ("timeout", "punctual", "late"), [(None, 10.2, 10.3), (4.0, 3.0, 3.1), (6.0, 4.7, 4.9)]
)
def test_before_a_late_command_a_drive_that_was_on_must_report(
    timeout: float | None, punctual: float, late: float
) -> None:
    seen = Seen(timeout=timeout)
    seen.look(0.0, bridge=True)
    assert not seen.must_report(punctual)
    assert seen.must_report(late)


@pytest.mark.parametrize(("reported", "on"), [(True, False), (False, True)])
def test_before_a_late_command_no_drive_must_report_that_cannot_show_a_stop(
    *, reported: bool, on: bool
) -> None:
    seen = Seen(reported=reported)
    seen.look(0.0, bridge=on)
    assert not seen.must_report(100.0)


def test_before_a_punctual_command_a_drive_that_was_silent_must_report() -> None:
    seen = Seen()
    seen.look(0.0, bridge=True)
    seen.look(11.0, bridge=True, old=11.0)
    assert seen.must_report(0.0)


def test_no_report_is_waited_for_of_a_drive_that_was_not_on() -> None:
    seen = Seen()
    seen.look(20.0, bridge=True, commanded=False, unwatched=20.0)
    assert not seen.awaits_report


@pytest.mark.parametrize(
    ("ticks_per_reading", "timeout", "limit"),
    [
        (1, None, 10.24),  # 80 ms, or two readings and a half
        (6, None, 15.0),
        (60, None, 150.0),
        (1, 4.0, 3.0),  # the command before the last reading may be the last one received
        (1, 6.0, 4.8),
        (1, 100.0, 10.24),
        (6, 16.0, 10.0),
        (6, 1000.0, 15.0),
    ],
)
def test_after_a_silence_which_a_short_time_out_of_the_drive_shortens_a_report_is_waited_for(
    ticks_per_reading: int, timeout: float | None, limit: float
) -> None:
    seen = Seen(ticks_per_reading, timeout=timeout)
    seen.look(0.0, bridge=True)
    seen.awaits_from(limit, "old")
    seen.look(limit + 1.0, bridge=True)
    assert not seen.awaits_report


@pytest.mark.parametrize(
    ("ticks_per_reading", "cycle", "timeout", "limit"),
    [
        (1, 60, 50.0, 150.0),  # not below the cycle: each report would be waited for
        (20, 60, 80.0, 60.0),
        (1, 60, 100.0, 80.0),
        (1, 60, 400.0, 150.0),
        (1, math.inf, None, 10.24),  # it comes nobody knows how often
        (1, math.inf, 6.0, 4.8),
        (1, math.inf, 50.0, 40.0),
    ],
)
def test_a_time_out_of_the_drive_limits_the_time_without_a_report_of_the_bridge(
    ticks_per_reading: int, cycle: float, timeout: float | None, limit: float
) -> None:
    seen = Seen(ticks_per_reading, cycle=cycle, timeout=timeout)
    seen.look(0.0, bridge=True)
    seen.awaits_from(limit, "reported")


def test_a_silence_in_which_a_bridge_went_off_is_named() -> None:
    seen = Seen()
    seen.look(0.0, bridge=True)
    for ticks in range(1, 21):
        assert not seen.look(ticks, bridge=True, old=ticks)
    assert seen.look(20.5, bridge=False)
    assert seen.cause == f"{STOPPED}; nothing had been heard of it for {2e4 * TICK_S:.0f} ms"


@pytest.mark.parametrize(("reported", "on"), [(True, False), (False, True)])
def test_no_report_is_waited_for_where_none_can_show_a_stop(*, reported: bool, on: bool) -> None:
    seen = Seen(reported=reported)
    seen.look(0.0, bridge=on)
    for ticks in range(1, 21):
        seen.look(ticks, bridge=on, old=ticks)
    assert not seen.awaits_report


def test_a_drive_that_reports_no_bridge_is_commanded_after_a_time_unwatched() -> None:
    """Its oldest value, which comes once in 60 half cycles, says nothing of its bridge."""
    seen = Seen(reported=False)
    seen.look(0.0, bridge=True)
    for ticks in range(20, 60):
        seen.look(ticks, bridge=True, unwatched=20.0 if ticks == 20 else 1.0, reported=ticks)
        assert not seen.awaits_report


def test_a_rare_report_of_the_bridge_is_no_silence_while_readings_come() -> None:
    """Its message comes once in 60 half cycles, and one may be lost."""
    seen = Seen(cycle=60)
    for ticks in range(1, 400):
        lost = 60 if 180 <= ticks < 240 else 0
        assert not seen.look(ticks, bridge=True, reported=ticks % 60 + lost)
        assert not seen.awaits_report


@pytest.mark.parametrize(
    ("ticks_per_reading", "cycle", "limit"), [(1, 1, 10.24), (1, 6, 15.0), (6, 1, 15.0)]
)
def test_a_report_of_the_bridge_that_is_missing_is_waited_for_while_readings_come(
    ticks_per_reading: int, cycle: float, limit: float
) -> None:
    """Another node sends the clock of the readings, and the drive is silent."""
    seen = Seen(ticks_per_reading, cycle=cycle)
    seen.look(0.0, bridge=True, reported=0.0)
    seen.awaits_from(limit, "reported")
    seen.look(limit + 1.0, bridge=True, reported=limit + 1.0)
    assert seen.awaits_report
    assert seen.look(limit + 2.0, bridge=False, reported=0.0)
    assert seen.cause == (
        f"{STOPPED}; nothing had been heard of it for {(limit + 1.0) * 1e3 * TICK_S:.0f} ms"
    )


def test_after_a_silence_a_rare_report_of_the_bridge_is_waited_for() -> None:
    seen = Seen(cycle=60)
    seen.look(0.0, bridge=True)
    for ticks in range(1, 21):
        seen.look(ticks, bridge=True, old=ticks, reported=ticks)
    for ticks in range(21, 40):
        assert not seen.look(ticks, bridge=True, reported=ticks)
        assert seen.awaits_report
    seen.look(40.0, bridge=True)
    assert not seen.awaits_report


def test_a_reading_ends_the_silence_in_which_its_poll_was_slow() -> None:
    """Each poll takes 28 half cycles instead of 6: its values were asked for in the silence."""
    seen = Seen(6)
    for ticks in range(28):
        seen.look(ticks, bridge=True, old=ticks)
    assert seen.awaits_report
    for ticks in range(28):
        seen.look(28.0 + ticks, bridge=True, old=ticks, polled=28.0)
        assert seen.awaits_report is (ticks > 15)
