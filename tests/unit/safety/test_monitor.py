"""The verdict on a drive, in exact times: stops, doubts, another master, a stop not obeyed."""

from __future__ import annotations

import math
from typing import Any

import pytest

from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.safety.monitor import Doubt, Monitor, Verdict
from adaptdrive.safety.timing import Timing
from tests.support import text_of

TICK_S = 2.0**-7
E = 1.5e-6 / TICK_S
"""A little more than rounding, in half cycles."""

ON = Command(0.0, 300.0, bridge=True)
STOPPED = "drive stopped: its bridge is off although it was commanded on"

Look = tuple[float, bool, str, dict[str, Any]]
"""When a drive is looked at, what it says of its bridge, and what follows (`on` says how)."""


def on(ticks: float, follows: str = ".", **how: Any) -> Look:
    """Look at a bridge that is on: `!` a stop follows, `?` a report is waited for, `.` neither.

    Args:
        ticks: Half cycles since 64 s.
        follows: What follows.
        how: `commanded`, `due`, and in half cycles: `old` is the age of the reading, `reported`
            that of its bridge, `polled` how long its poll took, `unwatched` since the last look.
    """
    return ticks, True, follows, how


def off(ticks: float, follows: str = ".", **how: Any) -> Look:
    """Look at a bridge that is off."""
    return ticks, False, follows, how


def never_on(half_cycles: int) -> str:
    return f"; it has not come on within {half_cycles * 1e3 * TICK_S:.0f} ms"


def not_run(half_cycles: float) -> str:
    return f"; the daemon had not run for {half_cycles * 1e3 * TICK_S:.0f} ms"


def not_heard(half_cycles: float) -> str:
    return f"; nothing had been heard of it for {half_cycles * 1e3 * TICK_S:.0f} ms"


class Seen:
    """A drive whose bridge is looked at."""

    def __init__(
        self,
        stride: int = 1,
        *,
        reported: bool = True,
        cycle: float = 0.0,
        timeout: float | None = None,
    ) -> None:
        timeout_s = None if timeout is None else timeout * TICK_S
        timing = Timing(TICK_S, 0.05, ticks_per_reading=stride, command_timeout_s=timeout_s)
        self.now_s = 64.0
        slack_s = 0.0 if reported else None
        self.watch = Monitor(timing, lambda: self.now_s, slack_s=slack_s, cycle_s=cycle * TICK_S)
        self.cause: str | None = None
        self._told: tuple[float, bool] | None = None

    def command(self, *, on: bool) -> None:
        """Give the drive a command, which reaches it."""
        self.watch.command(ON if on else SAFE_COMMAND)
        self.watch.given = on

    def look(self, look: Look) -> str:
        """Return what follows."""
        ticks, bridge, _, how = look
        old, reported = how.get("old", 0.0), how.get("reported")
        now_s = 64.0 + ticks * TICK_S
        time_s = now_s - old * TICK_S
        came_s = time_s if reported is None else now_s - reported * TICK_S
        asked_s = came_s - how.get("polled", 0.0) * TICK_S
        self.now_s = now_s
        self.command(on=how.get("commanded", True))
        if self._told != (came_s, bridge):
            self._told = came_s, bridge
            self.watch.report(on=bridge, asked_s=asked_s, came_s=came_s)
        unwatched_s, due = how.get("unwatched", 1.0) * TICK_S, how.get("due", True)
        self.cause = text_of(self.watch.look(now_s, unwatched_s, time_s, due=due))
        if self.cause is not None:
            return "!"
        return "?" if self.watch.must_report(0.0) else "."


IDLE: dict[str, Any] = {"commanded": False}
EARLY: dict[str, Any] = {"due": False}
"""While its drive starts."""

SCRIPTS: list[tuple[dict[str, Any], list[Look], str]] = [
    # it has thirty half cycles to come on, and three readings
    ({}, [off(0), off(29), off(29 + E, "!")], never_on(30)),
    ({"stride": 10}, [off(0), off(20), off(20 + E, "!")], never_on(30)),
    ({"stride": 60}, [off(0), off(120), off(120 + E, "!")], never_on(180)),
    ({}, [off(0), off(20, **IDLE), off(40), off(69), off(70, "!")], never_on(30)),
    ({}, [off(0), off(50, **IDLE), off(100, "?", old=80), off(110), off(130, "!")], never_on(30)),
    # a report from before the command begins no time: its message comes once in 128 half cycles
    ({"cycle": 128}, [off(0, reported=126), off(2), off(29), off(30, "!")], never_on(30)),
    ({}, [off(0, **EARLY), off(100, **EARLY), off(101), off(130), off(131, "!")], never_on(30)),
    # no time is named in which it has not come on: it has not stopped then
    ({}, [off(0), off(14, "?", old=14), off(45, "!")], never_on(30)),
    # one that has come on and is off has stopped, also while its drive starts
    ({}, [off(0, **IDLE), off(1), on(2), off(32, "!")], ""),
    ({}, [off(0, **IDLE), off(1, **EARLY), on(2, **EARLY), off(32, "!", **EARLY)], ""),
    ({}, [on(0, **EARLY), off(31, "!", **EARLY)], ""),
    ({}, [on(0, **EARLY), off(31, "!", unwatched=2.1, **EARLY)], ""),
    # a contact that opens once more while it switches on bounces; what energises waits
    ({}, [off(0, **IDLE), off(1), on(2), off(3, "?"), on(4), off(5, "?"), on(30), off(31, "?"),
          on(32)], ""),
    ({}, [off(0, **IDLE), on(2, **EARLY), off(3, "?", **EARLY), on(4, **EARLY)], ""),
    ({}, [on(0), off(1, "?"), off(2, **IDLE), on(3), off(4, "?")], ""),
    ({}, [off(0, **IDLE), on(1), off(2, "?"), off(2.5, "?", old=0.5), off(3, "!")], ""),
    # unless it had the time to stop unseen
    ({}, [on(0), on(14, "?", old=14), off(15, "!")], not_heard(14)),
    ({}, [on(0), on(14, "?", unwatched=14), off(15, "!")], not_run(14)),
    # one that was still on at the command has been on by it once it has switched, or later
    ({}, [on(0, **IDLE), on(1), on(31), off(32)], ""),
    ({}, [on(0, **IDLE), on(1), on(32), off(33, "!")], ""),
    ({}, [on(0, **IDLE), on(1), off(2), on(3), off(32, "!")], ""),
    ({}, [off(0, "?", unwatched=100), off(1)], ""),
    ({}, [on(-1, **IDLE), off(0, "?", unwatched=100), off(1)], ""),
    # the time in which it went off unseen is named, if it may have stopped for it
    ({}, [on(0), off(11, "?", unwatched=2.1), off(12, "!")], ""),
    ({}, [on(0), off(11, "?", unwatched=10), off(12, "!")], ""),
    ({}, [on(0), off(11, "!", unwatched=11)], not_run(11)),
    ({}, [on(0), off(100, "!", unwatched=100)], not_run(100)),
    ({}, [on(0), on(100, "?", old=100), off(101, "!")], not_heard(100)),
    ({}, [on(0), *(on(n, "?" if n > 10 else ".", old=n) for n in range(1, 21)), off(20.5, "!")],
     not_heard(20)),
    ({"timeout": 4}, [on(0), on(20, old=1, unwatched=3), off(21, "?"), off(22, "!")], ""),
    # a report from before that time does not end it, nor one that had not arrived at its end
    ({}, [on(0), on(11, "?", old=11, unwatched=11), on(14, "?", old=3), off(15, "!")], not_run(11)),
    ({}, [on(0), *(on(n, "?", old=n, unwatched=11 if n == 11 else 1) for n in (11, 12, 13)),
          on(14, "?", old=3), off(15, "!")], not_run(11)),
    # nor one that was asked for before it
    ({}, [on(0), on(11, "?", old=11, unwatched=11), on(14, "?", polled=5), on(15)], ""),
    # of several such times the longest is named, and the last one counts
    ({}, [on(0), on(11, "?", old=11, unwatched=11), on(22, "?", old=22, unwatched=10.5),
          on(23, "?", old=2), off(24, "!")], not_run(11)),
    ({}, [on(0), on(40, old=10, unwatched=10), on(41), on(42, old=1), off(43, "!")], ""),
    ({}, [on(0), on(40, old=10, unwatched=10), on(41, old=11, **IDLE), on(42, old=1),
          off(43)], ""),
    ({}, [on(0), on(20, old=8, unwatched=0.079 / TICK_S), on(21, old=1), on(22)], ""),
    ({}, [on(0), on(20, "?", old=8, unwatched=0.081 / TICK_S), on(21, "?", old=1), on(22)], ""),
    ({}, [off(0, unwatched=20, **IDLE), on(1, old=1.5)], ""),
    ({}, [on(20, unwatched=20, **IDLE)], ""),
    # where no report can show a stop, none is waited for
    ({"reported": False}, [on(0), *(on(n, old=n) for n in range(1, 21))], ""),
    # one that has not come on may have done so unseen, and stopped
    ({}, [off(0), *(off(n, "?" if n > 10 else ".", old=n) for n in range(1, 21)), off(21)], ""),
    ({"reported": False}, [on(0), on(20, unwatched=20, reported=20), on(59, reported=59)], ""),
    # a report that comes once in 60 half cycles, and may be lost, is no silence by itself
    ({"cycle": 60}, [on(n, reported=n % 60 + (60 if 180 <= n < 240 else 0))
                     for n in range(1, 400)], ""),
    ({"cycle": 60}, [on(0), on(20, "?", old=20, reported=20),
                     *(on(n, "?", reported=n) for n in range(21, 40)), on(40)], ""),
    # one that is missing while readings come is: another node sends their clock
    *(({"stride": stride, "cycle": cycle},
       [on(0, reported=0), on(limit + 1, "?", reported=limit + 1), off(limit + 2, "!", reported=0)],
       not_heard(limit + 1)) for stride, cycle, limit in [(1, 1, 10.24), (1, 6, 15), (6, 1, 15)]),
    # a reading ends the silence in which its poll was slow: 28 half cycles instead of 6
    ({"stride": 6}, [on(0), on(27, "?", old=27),
                     *(on(28 + n, "?" if n > 15 else ".", old=n, polled=28) for n in range(28))],
     ""),
]  # fmt: skip


@pytest.mark.parametrize(("drive", "looks", "named"), SCRIPTS)
def test_a_stop_is_found_when_it_is_one(
    drive: dict[str, Any], looks: list[Look], named: str
) -> None:
    seen = Seen(**drive)
    assert [seen.look(one) for one in looks] == [follows for _, _, follows, _ in looks]
    assert seen.cause == (STOPPED + named if looks[-1][2] == "!" else None)


@pytest.mark.parametrize(
    ("drive", "of", "limit"),
    [
        # 80 ms, or two readings and a half; of a drive that stops sooner by itself less: the
        # command before the last reading may be the last one that it received
        ({}, "old", 10.24),
        ({"stride": 6}, "old", 15.0),
        ({"stride": 60}, "old", 150.0),
        ({"timeout": 4}, "old", 3.0),
        ({"timeout": 6}, "old", 4.8),
        ({"timeout": 100}, "old", 10.24),
        ({"stride": 6, "timeout": 16}, "old", 10.0),
        ({"stride": 6, "timeout": 1000}, "old", 15.0),
        ({"cycle": 60, "timeout": 50}, "reported", 150.0),  # else each would be waited for
        ({"stride": 20, "cycle": 60, "timeout": 80}, "reported", 60.0),
        ({"cycle": 60, "timeout": 100}, "reported", 80.0),
        ({"cycle": 60, "timeout": 400}, "reported", 150.0),
        ({"cycle": math.inf}, "reported", 10.24),  # it comes nobody knows how often
        ({"cycle": math.inf, "timeout": 6}, "reported", 4.8),
        ({"cycle": math.inf, "timeout": 50}, "reported", 40.0),
        ({"timeout": 2}, "unwatched", 1.5),
        ({"timeout": 2.5}, "unwatched", 1.5),
        ({"timeout": 4}, "unwatched", 3.0),
        ({"timeout": 6}, "unwatched", 4.8),
        ({"timeout": 100}, "unwatched", 10.24),
    ],
)
def test_a_report_is_waited_for_after_a_time_in_which_a_drive_may_have_stopped(
    drive: dict[str, Any], of: str, limit: float
) -> None:
    for ticks, follows in ((limit - 0.1, "."), (limit + 0.1, "?")):
        seen = Seen(**drive)
        seen.look(on(0))
        at, old = (20.0, {"old": 1.0}) if of == "unwatched" else (ticks, {})
        how: dict[str, Any] = {**old, of: ticks}
        assert seen.look(on(at, **how)) == follows
    assert seen.look(on(200.0)) == "."


@pytest.mark.parametrize(
    ("drive", "looks", "punctual", "late"),
    [
        ({}, [on(0)], 10.2, 10.3),
        ({"timeout": 4}, [on(0)], 3.0, 3.1),
        ({"timeout": 6}, [on(0)], 4.7, 4.9),
        ({"reported": False}, [on(0)], 100.0, math.inf),
        ({}, [off(0)], 100.0, math.inf),
        ({}, [on(0), on(11, old=11)], -math.inf, 0.0),
    ],
)
def test_before_a_late_command_a_drive_that_was_on_must_report_if_it_can(
    drive: dict[str, Any], looks: list[Look], punctual: float, late: float
) -> None:
    seen = Seen(**drive)
    for one in looks:
        seen.look(one)
    assert math.isinf(punctual) or not seen.watch.must_report(punctual * TICK_S)
    assert math.isinf(late) or seen.watch.must_report(late * TICK_S)


# Facts that a port reports without a look.


class Driven(Seen):
    """A drive that has come on by command, with two seconds for the safe command."""

    def __init__(self, *, reported: bool = True) -> None:
        super().__init__(reported=reported)
        self.look(off(0, commanded=False))
        self.look(off(1))
        self.look(on(40))

    def pass_s(self, seconds: float) -> Monitor:
        self.now_s += seconds
        return self.watch


def stopped(drive: Driven, *, on: bool = False) -> str | None:
    """Return the trip after the next report."""
    monitor = drive.pass_s(TICK_S)
    monitor.report(on=on, asked_s=drive.now_s, came_s=drive.now_s)
    return text_of(monitor.look(drive.now_s, TICK_S, drive.now_s, due=True))


def verdict(drive: Seen) -> Verdict:
    """The verdict now."""
    return drive.watch.verdict


def test_another_master_is_remembered_for_five_seconds() -> None:
    drive = Seen()
    assert drive.watch.trip_cause is None
    drive.watch.note_foreign("0x200 Command")
    drive.now_s += 4.9
    assert "1 x frame 0x200 Command, the last 4.9 s ago" in str(drive.watch.trip_cause)
    drive.watch.note_foreign("0x200 Command")
    drive.now_s += 5.0
    assert "2 x frame" in str(drive.watch.trip_cause)
    drive.now_s += 0.1
    assert drive.watch.trip_cause is None
    drive.watch.note_foreign("0x200 Command")
    assert "1 x frame" in str(drive.watch.trip_cause)


def test_a_drive_that_stopped_while_its_bus_was_lost_waits_for_the_safe_command() -> None:
    drive = Driven()
    drive.watch.lose()
    assert verdict(drive) is Verdict.MAY_HAVE_STOPPED
    assert stopped(drive) == f"{STOPPED}; the bus was lost meanwhile"
    assert verdict(drive) is Verdict.STOPPED
    drive.watch.command(SAFE_COMMAND)
    drive.watch.command(ON)
    assert verdict(drive) is Verdict.OBEYS


def test_a_drive_that_was_on_before_its_command_and_stopped_while_its_bus_was_lost_trips() -> None:
    drive = Driven()
    drive.command(on=False)
    drive.command(on=True)
    assert stopped(drive, on=True) is None
    drive.watch.lose()
    assert stopped(drive) == f"{STOPPED}; the bus was lost meanwhile"


def test_a_drive_that_reports_on_after_its_bus_was_lost_is_driven_on() -> None:
    drive = Driven()
    drive.watch.lose()
    assert stopped(drive, on=True) is None
    assert verdict(drive) is Verdict.OBEYS


def test_a_drive_that_never_reports_its_bridge_is_not_driven_on_after_a_lost_bus() -> None:
    drive = Driven(reported=False)
    assert drive.pass_s(1e3).verdict is Verdict.OBEYS
    drive.watch.lose()
    assert stopped(drive) == f"{STOPPED}; the bus was lost meanwhile"


def test_a_counter_that_leaps_after_a_lost_bus_leaves_the_loss_as_the_cause() -> None:
    drive = Driven()
    drive.watch.doubt(Doubt.LEAPT, drive.now_s)
    drive.watch.lose()
    assert stopped(drive) == f"{STOPPED}; the bus was lost meanwhile"


def test_a_report_of_off_keeps_commands_back_before_anybody_has_looked() -> None:
    drive = Driven()
    drive.watch.report(on=False, asked_s=drive.now_s, came_s=drive.now_s)
    assert verdict(drive) is Verdict.STOPPED


def test_a_silence_keeps_commands_back_before_anybody_has_looked() -> None:
    drive = Driven()
    assert drive.pass_s(0.079).verdict is Verdict.OBEYS
    assert drive.pass_s(0.002).verdict is Verdict.MAY_HAVE_STOPPED


def test_reports_that_come_faster_than_readings_may_all_be_of_one_bounce() -> None:
    drive = Seen()
    drive.look(off(0, commanded=False))
    drive.look(off(1))
    drive.look(on(2))
    for ticks in (2.1, 2.2, 2.8):
        drive.watch.report(on=False, asked_s=64.0 + ticks * TICK_S, came_s=64.0 + ticks * TICK_S)
        assert verdict(drive) is Verdict.MAY_HAVE_STOPPED
    drive.watch.report(on=True, asked_s=64.0 + 2.9 * TICK_S, came_s=64.0 + 2.9 * TICK_S)
    assert verdict(drive) is Verdict.OBEYS


def test_a_drive_that_was_on_may_have_stopped_although_nothing_was_sent_since_a_loss() -> None:
    """A second loss, or a queue that is full, comes before the next command has gone out."""
    drive = Driven()
    drive.watch.lose()
    assert stopped(drive, on=True) is None
    drive.watch.command(ON)
    drive.watch.lose()
    assert verdict(drive) is Verdict.MAY_HAVE_STOPPED
    assert stopped(drive, on=True) is None
    assert drive.pass_s(0.09).verdict is Verdict.MAY_HAVE_STOPPED


def test_a_command_that_goes_out_after_the_safe_one_ends_it() -> None:
    """The reply to the safe command came after another one had been decided."""
    drive = told_to_stop()
    drive.watch.command(ON)
    drive.watch.take(SAFE_COMMAND)
    drive.watch.offer(ON)
    assert drive.watch.safe_s == math.inf


def test_a_frame_that_may_be_old_ends_no_doubt() -> None:
    drive = Driven()
    drive.watch.doubt(Doubt.LEAPT, drive.now_s)
    drive.watch.hint(on=True, came_s=drive.now_s + TICK_S)
    assert drive.watch.look(drive.now_s + TICK_S, TICK_S, drive.now_s, due=True) is None
    assert verdict(drive) is Verdict.MAY_HAVE_STOPPED
    assert "its alive counter leapt" in str(stopped(drive))


def overdue_s(drive: Seen, after_s: float) -> float:
    drive.now_s += after_s
    return drive.watch.overdue_s


def told_to_stop(*, acknowledges: bool = False) -> Seen:
    """A drive that is on, and has been given the safe command."""
    drive = Driven()
    drive.watch._acknowledges = acknowledges
    drive.command(on=False)
    drive.watch.take(SAFE_COMMAND)
    return drive


def test_a_drive_that_stays_on_does_not_obey_after_its_time_from_the_first_command() -> None:
    drive = told_to_stop()
    began_s = drive.now_s
    assert overdue_s(drive, 0.75) == -0.25
    drive.watch.take(SAFE_COMMAND)
    assert verdict(drive) is Verdict.OBEYS
    assert overdue_s(drive, 0.5) == 0.25
    assert verdict(drive) is Verdict.DISOBEYS
    assert drive.watch.safe_s == began_s
    drive.watch.report(on=False, asked_s=drive.now_s, came_s=drive.now_s)
    assert verdict(drive) is Verdict.OBEYS
    drive.watch.hint(on=True, came_s=drive.now_s)
    assert verdict(drive) is Verdict.DISOBEYS


def test_its_time_begins_anew_after_another_command() -> None:
    drive = told_to_stop()
    overdue_s(drive, 10.0)
    drive.command(on=True)
    assert drive.watch.safe_s == math.inf
    drive.command(on=False)
    drive.watch.take(SAFE_COMMAND)
    assert overdue_s(drive, 0.75) == -0.25


def test_a_drive_that_is_off_obeys_once_it_has_acknowledged_the_safe_command() -> None:
    drive = told_to_stop(acknowledges=True)
    drive.watch.report(on=False, asked_s=drive.now_s, came_s=drive.now_s)
    assert overdue_s(drive, 0.5) == -math.inf
    drive.watch.lose()
    assert overdue_s(drive, 1.0 + 2 * TICK_S) == TICK_S  # a second and a reading of the new link
    drive.watch.take(SAFE_COMMAND)
    assert overdue_s(drive, 1e3) == -math.inf


def test_what_a_lost_bus_has_carried_is_unknown_where_nothing_acknowledges_it() -> None:
    drive = told_to_stop()
    drive.watch.lose()
    assert overdue_s(drive, 1e3) == -math.inf
