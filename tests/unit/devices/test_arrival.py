"""The age of a frame, whenever the wall clock is set, against a kernel that the test simulates."""

from __future__ import annotations

from dataclasses import dataclass

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.devices.can.integrity import ArrivalClock

STEPS_s = st.one_of(st.floats(-7200.0, 7200.0), st.floats(-0.1, 0.1), st.just(0.0))
WAITS_s = st.lists(st.floats(0.0, 0.5), min_size=1, max_size=20)


@dataclass
class Machine:
    """Both clocks of a machine."""

    now_s: float = 50.0
    wall_ahead_s: float = 1.7e9

    def monotonic(self) -> float:
        return self.now_s

    def wall(self) -> float:
        return self.now_s + self.wall_ahead_s

    def frame(self) -> can.Message:
        return can.Message(timestamp=self.wall())


@given(waits_s=WAITS_s)
def test_without_a_step_the_age_is_exact(waits_s: list[float]) -> None:
    machine = Machine()
    arrivals = ArrivalClock(machine.monotonic, machine.wall)
    for wait_s in waits_s:
        frame = machine.frame()
        machine.now_s += wait_s
        assert arrivals.waited_s(frame) == pytest.approx(wait_s, abs=1e-5)


@given(step_s=STEPS_s, stamped=st.lists(st.floats(0.0, 0.3), min_size=1, max_size=8))
def test_frames_that_wait_while_the_clock_is_set_look_no_younger(
    step_s: float, stamped: list[float]
) -> None:
    """All of them wait while the clock is set, and are read one after the other."""
    machine = Machine()
    arrivals = ArrivalClock(machine.monotonic, machine.wall)
    empty_s = machine.now_s
    waiting = []
    for gap_s in stamped:
        waiting.append((machine.now_s, machine.frame()))
        machine.now_s += gap_s
    machine.wall_ahead_s += step_s
    for arrived_s, frame in waiting:
        age_s = machine.now_s - arrived_s
        assert age_s - 0.002 <= arrivals.waited_s(frame) <= machine.now_s - empty_s


@given(steps_s=st.lists(STEPS_s, min_size=1, max_size=10), gap_s=st.floats(0.001, 0.05))
def test_after_steps_ages_are_exact_once_the_queue_was_empty(
    steps_s: list[float], gap_s: float
) -> None:
    machine = Machine()
    arrivals = ArrivalClock(machine.monotonic, machine.wall)
    for step_s in steps_s:
        arrivals.begin_drain()
        machine.wall_ahead_s += step_s
        arrivals.waited_s(machine.frame())
        arrivals.end_drain()
        late = machine.frame()
        machine.now_s += gap_s
        assert arrivals.waited_s(late) == pytest.approx(gap_s, abs=0.002)
        assert arrivals.waited_s(machine.frame()) <= 0.002


@pytest.mark.parametrize("waited_s", [0.2, 1.5, 30.0])
def test_a_frame_is_as_old_as_it_is_however_old(waited_s: float) -> None:
    machine = Machine()
    arrivals = ArrivalClock(machine.monotonic, machine.wall)
    arrivals.begin_drain()
    arrivals.end_drain()
    frame = machine.frame()
    machine.now_s += waited_s
    arrivals.begin_drain()
    assert arrivals.waited_s(frame) == pytest.approx(waited_s, abs=1e-5)


def test_no_frame_is_older_than_its_queue() -> None:
    machine = Machine()
    arrivals = ArrivalClock(machine.monotonic, machine.wall)
    frame = machine.frame()
    machine.now_s += 10.0
    arrivals.begin_drain()
    arrivals.end_drain()
    machine.now_s += 0.003
    assert arrivals.waited_s(frame) == pytest.approx(0.003, abs=1e-9)
