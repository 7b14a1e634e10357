"""When a bridge that is off although it was commanded on is a stop, in exact times."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from adaptdrive.safety.monitor import BridgeWatch
from adaptdrive.safety.timing import Timing
from tests.support import text_of
from tests.unit.runtime.bench import CALM

TICK_S = 2.0**-7
E = 1.5e-6 / TICK_S
"""A little more than rounding, in half cycles."""

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
        self.watch = BridgeWatch(timing, reported=reported, cycle_s=cycle * TICK_S)
        self.cause: str | None = None

    def look(self, look: Look) -> str:
        """Return what follows."""
        ticks, bridge, _, how = look
        old, reported = how.get("old", 0.0), how.get("reported")
        now_s = 64.0 + ticks * TICK_S
        time_s = now_s - old * TICK_S
        reading = replace(
            CALM,
            arrival_s=time_s,
            oldest_s=time_s - how.get("polled", 0.0) * TICK_S,
            bridge=bridge,
            bridge_s=None if reported is None else now_s - reported * TICK_S,
        )
        cause = self.watch.find_cause(
            reading,
            commanded=how.get("commanded", True),
            due=how.get("due", True),
            unwatched_s=how.get("unwatched", 1.0) * TICK_S,
            now_s=now_s,
        )
        self.cause = text_of(cause)
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
    ({}, [off(0), off(50, **IDLE), off(100, old=80), off(110), off(130, "!")], never_on(30)),
    # a report from before the command begins no time: its message comes once in 128 half cycles
    ({}, [off(0, old=126), off(2), off(29), off(30, "!")], never_on(30)),
    ({}, [off(0, **EARLY), off(100, **EARLY), off(101), off(130), off(131, "!")], never_on(30)),
    # no time is named in which it has not come on: it has not stopped then
    ({}, [off(0), off(14, old=14), off(45, "!")], never_on(30)),
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
    ({}, [off(0, unwatched=100)], ""),
    ({}, [on(-1, **IDLE), off(0, unwatched=100)], ""),
    # the time in which it went off unseen is named, if it may have stopped for it
    ({}, [on(0), off(11, "!", unwatched=2.1)], ""),
    ({}, [on(0), off(11, "!", unwatched=10)], ""),
    ({}, [on(0), off(11, "!", unwatched=11)], not_run(11)),
    ({}, [on(0), off(100, "!", unwatched=100)], not_run(100)),
    ({}, [on(0), on(100, "?", old=100), off(101, "!")], not_heard(100)),
    ({}, [on(0), *(on(n, "?" if n > 10 else ".", old=n) for n in range(1, 21)), off(20.5, "!")],
     not_heard(20)),
    ({"timeout": 4}, [on(0), on(20, old=1, unwatched=3), off(21, "!")], ""),
    # a report from before that time does not end it, nor one that had not arrived at its end
    ({}, [on(0), on(11, "?", old=11, unwatched=11), on(14, "?", old=3), off(15, "!")], not_run(11)),
    ({}, [on(0), *(on(n, "?", old=n, unwatched=11 if n == 11 else 1) for n in (11, 12, 13)),
          on(14, "?", old=3), off(15, "!")], not_run(11)),
    # of several such times the longest is named, and the last one counts
    ({}, [on(0), on(11, "?", old=11, unwatched=11), on(16, "?", old=2, unwatched=5),
          on(17, "?", old=2), off(18, "!")], not_run(11)),
    ({}, [on(0), on(40, old=10, unwatched=10), on(41), on(42, old=1), off(43, "!")], ""),
    ({}, [on(0), on(40, old=10, unwatched=10), on(41, old=11, **IDLE), on(42, old=1),
          off(43)], ""),
    ({}, [on(0), on(20, old=8, unwatched=0.079 / TICK_S), on(21, old=1), on(22)], ""),
    ({}, [on(0), on(20, "?", old=8, unwatched=0.081 / TICK_S), on(21, "?", old=1), on(22)], ""),
    ({}, [off(0, unwatched=20, **IDLE), on(1, old=1.5)], ""),
    ({}, [on(20, unwatched=20, **IDLE)], ""),
    # where no report can show a stop, none is waited for
    ({"reported": False}, [on(0), *(on(n, old=n) for n in range(1, 21))], ""),
    ({}, [off(0), *(off(n, old=n) for n in range(1, 21))], ""),
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
