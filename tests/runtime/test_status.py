"""What the service manager shows of a drive."""

from __future__ import annotations

import pytest

from adaptdrive.control.signals import Mode
from adaptdrive.runtime.accounts import status_line
from adaptdrive.runtime.reports import State, StateReport

TRIP = "over-voltage: v_bst = 431.0 V, limit 430 V"
LOST = "socketcan can0: [Errno 100] Network is down"
STALE = "stale: measurement is 1272 ms old, limit 50 ms"


@pytest.mark.parametrize(
    ("state", "bus_problem", "cause", "line"),
    [
        (State.STANDBY, None, None, "standby, waiting for enable"),
        (State.STANDBY, None, STALE, "standby, waiting for the drive (stale)"),
        (State.STANDBY, LOST, STALE, f"standby, waiting for the drive ({LOST})"),
        (State.STARTING, None, None, "starting, waiting for the boost voltage"),
        (State.TRIPPED, None, None, f"tripped, waiting for reset: {TRIP}"),
        (State.TRIPPED, None, STALE, f"tripped, waiting for its cause to go (stale): {TRIP}"),
        (State.RUNNING, None, None, "running, fixed controller: warming up"),
    ],
)
def test_it_says_what_is_awaited(
    state: State, bus_problem: str | None, cause: str | None, line: str
) -> None:
    report = StateReport(
        state=state,
        mode=Mode.ADAPTIVE,
        controller=Mode.FIXED,
        reason="warming up",
        enabled=state in (State.STARTING, State.RUNNING),
        setpoint=3.0,
        waveform=None,
        pole=0.7,
        trip=TRIP if state is State.TRIPPED else None,
    )
    assert status_line(report, bus_problem, cause) == line
    failed = status_line(report, bus_problem, cause, recorded=False)
    assert failed == f"{line}; recording has failed"
