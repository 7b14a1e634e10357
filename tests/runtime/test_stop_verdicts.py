"""The verdict on a stop from what the drive reports, moment by moment, in exact times."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from adaptdrive.config.timing import Timing
from adaptdrive.runtime.stop_watch import Stop, StopWatch
from tests.runtime.bench import CALM

READING_S = 2.0**-7
STOP_S = 64.0
TIMING = Timing(READING_S, stale_s=0.05, start_s=0.25, stop_s=0.5)
LATE_S = 0.5 + READING_S
WORDS = {
    "-": Stop.AWAITED,
    "ok": Stop.CONFIRMED,
    "late": Stop.OVERDUE,
    "denied": Stop.DENIED,
}
ON_OFF = [(1.0, False, "ok"), (1.5, True, "ok")]
"""A confirmed stop, and a flicker."""


def judged(watch: StopWatch, after_s: float, *, bridge: bool, safe_s: float = -math.inf) -> Stop:
    """What is known so long after the stop, by a reading of that moment."""
    now_s = STOP_S + after_s
    reading = replace(CALM, arrival_s=now_s, oldest_s=now_s, bridge=bridge)
    return watch.judge(reading, safe_s, now_s)


def stopped(slack_s: float | None = 0.0) -> StopWatch:
    watch = StopWatch(TIMING, slack_s)
    watch.command(STOP_S)
    return watch


@pytest.mark.parametrize(
    ("slack_s", "readings"),
    [
        (0.0, [(0.5, True, "-"), (LATE_S, True, "late")]),
        (0.25, [(0.75, True, "-"), (0.25 + LATE_S, True, "late")]),  # a report that comes later
        (0.0, [*ON_OFF, (2.0, False, "ok"), (2.5, True, "ok"), (3.0, False, "ok")]),  # flickers
        (0.0, [*ON_OFF, (1.5, True, "ok"), (2.0, True, "denied"), (2.25, True, "-"),
               (2.5, True, "-"), (2.75, True, "late"), (4.0, False, "ok")]),
        (0.0, [(0.125, False, "ok"), (0.25, True, "ok"), (0.375, True, "denied")]),
        (0.0, [(0.0, False, "-"), (0.25, True, "-"), (0.375, True, "-")]),  # from before the stop
    ],
)  # fmt: skip
def test_a_stop_is_what_the_drive_reports_after_it(
    slack_s: float, readings: list[tuple[float, bool, str]]
) -> None:
    watch = stopped(slack_s)
    found = [judged(watch, after_s, bridge=bridge) for after_s, bridge, _ in readings]
    assert found == [WORDS[word] for _, _, word in readings]


def test_a_drive_without_a_word_has_stopped_when_it_has_taken_the_command() -> None:
    watch = stopped(None)
    assert judged(watch, 0.1, bridge=True, safe_s=math.inf) is Stop.AWAITED
    assert judged(watch, 0.2, bridge=True, safe_s=STOP_S) is Stop.CONFIRMED


def test_a_drive_that_was_energised_confirms_its_next_stop_anew() -> None:
    watch = stopped()
    for after_s, bridge, _ in ON_OFF:
        judged(watch, after_s, bridge=bridge)
    watch.release()
    watch.command(STOP_S + 2.0)
    assert judged(watch, 2.25, bridge=True) is Stop.AWAITED
    assert judged(watch, 2.5, bridge=False) is Stop.CONFIRMED
    assert judged(watch, 3.0, bridge=True) is Stop.CONFIRMED
    assert judged(watch, 3.5, bridge=True) is Stop.DENIED


@pytest.mark.parametrize(("reading_s", "due_s"), [(1 / 120, 0.25), (0.2, 0.25), (1.0, 1.0)])
def test_a_drive_that_is_read_seldom_has_one_reading_to_obey(
    reading_s: float, due_s: float
) -> None:
    watch = StopWatch(Timing(reading_s, 0.05, start_s=0.25, stop_s=0.5), 0.0)
    watch.release(CALM, bridge=True)
    watch.command(STOP_S)
    assert judged(watch, due_s - 0.01, bridge=False) is Stop.AWAITED
    assert judged(watch, due_s + 0.01, bridge=False) is Stop.CONFIRMED


@pytest.mark.parametrize(("been_on", "confirmed"), [(False, False), (True, True)])
def test_a_bridge_that_has_been_on_and_went_off_by_itself_is_off_at_once(
    *, been_on: bool, confirmed: bool
) -> None:
    """Nothing of a command that it has obeyed already is under way."""
    watch = StopWatch(TIMING, 0.0)
    for on in (been_on, False):
        watch.release(replace(CALM, bridge=on), bridge=True)
    watch.command(STOP_S)
    assert (judged(watch, 0.125, bridge=False) is Stop.CONFIRMED) is confirmed


def test_the_reason_names_the_time_since_the_stop() -> None:
    why = stopped().why_not(None, math.inf, STOP_S + 2.0)
    assert why.startswith("it has not taken the safe command 2000 ms after the stop; ")
