"""The bounds within which a rate is believed, on a half cycle whose multiples are exact."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.runtime.frame_rate import FrameRate
from adaptdrive.runtime.half_cycles import HalfCycles

TICK_S = 2.0**-7
STRIDE = 12


class Sender:
    """Sends readings to a judge of their rate."""

    def __init__(self, *, stride: int = 1, counted: bool = True) -> None:
        self.rate = FrameRate(TICK_S, stride, counted=counted)
        self.now_s = 64.0
        self.rate.add(self.now_s, None, stood_in=False)

    def send(
        self, count: int = 1, *, after: float = 1.0, steps: int | None = 1, stood_in: bool = False
    ) -> None:
        """Send readings; `after` is the time between two of them in half cycles."""
        for _ in range(count):
            self.now_s += after * TICK_S
            self.rate.add(self.now_s, steps, stood_in=stood_in)


def test_a_rate_is_judged_from_half_a_second_on() -> None:
    sender = Sender()
    sender.send(59)
    assert not sender.rate.judged
    sender.send()
    assert sender.rate.judged


def test_a_drive_that_is_read_seldom_is_judged_by_ten_readings() -> None:
    sender = Sender(stride=STRIDE)
    sender.send(9, after=12.0, steps=STRIDE)
    assert not sender.rate.judged
    sender.send(after=12.0, steps=STRIDE)
    assert sender.rate.judged


@pytest.mark.parametrize(("rate", "judged"), [(1.14, True), (1.15, False), (0.89, True)])
def test_a_tenth_of_jitter_is_believed_in_the_shortest_window(rate: float, *, judged: bool) -> None:
    """6 % of the line and 2 half cycles of jitter in 30: 12.7 % of the time."""
    sender = Sender()
    sender.send(60, after=1.0 / rate)
    assert sender.rate.judged is judged


def test_a_wrong_rate_is_named_when_it_has_lasted_for_a_second() -> None:
    sender = Sender()
    sender.send(240)
    sender.send(30, after=0.5)
    assert not sender.rate.judged
    sender.send(239, after=0.5)
    assert sender.rate.cause is None
    sender.send(after=0.5)
    assert sender.rate.cause is not None


def test_a_rate_that_was_wrong_is_believed_once_half_of_the_window_is_right() -> None:
    sender = Sender()
    sender.send(240)
    sender.send(300, after=0.5)
    sender.send(59)
    assert sender.rate.cause is not None
    sender.send()
    assert sender.rate.cause is None
    assert sender.rate.judged


@given(
    stalls=st.lists(st.tuples(st.integers(60, 200), st.integers(1, 60)), min_size=1, max_size=20),
    modulus=st.sampled_from([16, 256, 65536]),
)
def test_frames_that_a_stalled_bus_delivers_at_once_are_no_fast_drive(
    stalls: list[tuple[int, int]], modulus: int
) -> None:
    """What was sent while the bus stalled arrives at the end of the stall."""
    base, sent = HalfCycles(modulus, TICK_S), 0
    for prompt, stalled in stalls:
        for late in (*[0] * prompt, *range(stalled, 0, -1)):
            sent += 1
            base.place(sent % modulus, (sent + late) * TICK_S, sent)
            assert base.rate.cause is None


def test_readings_that_arrive_all_at_once_have_no_rate() -> None:
    sender = Sender()
    sender.send(100, after=0.0)
    assert sender.rate.cause is None


def test_a_drive_that_is_read_seldom_may_not_come_at_another_rate() -> None:
    sender = Sender(stride=STRIDE)
    sender.send(60, after=12.0 / 1.25, steps=STRIDE)
    assert "the drive sends 13.33 readings/s, expected 10.67/s" in (sender.rate.cause or "")


def test_without_a_counter_frames_of_the_right_rate_survive_jitter() -> None:
    """Time takes every second of them for two half cycles."""
    for counted in (False, True):
        sender = Sender(counted=counted)
        for _ in range(200):
            sender.send(after=0.4, steps=1)
            sender.send(after=1.6, steps=2)
        assert (sender.rate.cause is None) is not counted


def test_readings_that_come_seldom_are_named_while_they_do() -> None:
    sender = Sender()
    sender.send(300, after=2.0, steps=2, stood_in=True)
    assert "the drive sends 64 readings/s, expected 128/s" in (sender.rate.cause or "")
    sender.send(300)
    assert sender.rate.cause is None


def test_readings_that_are_late_and_those_that_were_lost_in_a_stall_are_not_seldom() -> None:
    late, stalled = Sender(), Sender()
    late.send(300, stood_in=True)
    stalled.send(300, after=2.0, steps=2)
    assert (late.rate.cause, stalled.rate.cause) == (None, None)


def test_nine_in_ten_that_come_seldom_are_not_too_seldom() -> None:
    sender = Sender()
    for _ in range(60):
        sender.send()
        sender.send(9, after=2.0, steps=2, stood_in=True)
    assert sender.rate.cause is None
