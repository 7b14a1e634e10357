"""The share of refused frames, from the counts of a port that are known exactly."""

from __future__ import annotations

from dataclasses import asdict

import pytest

from adaptdrive.hardware.port import PortStatistics
from adaptdrive.runtime.refused_share import WINDOW_S, RefusedShare

STEP_S = 0.1


class Counting:
    """A port whose counts grow by a fixed number in each step."""

    def __init__(self, limit: float = 0.0) -> None:
        self.share = RefusedShare("drive", limit)
        self.counts = asdict(PortStatistics())
        self.now_s = 0.0
        self.reported: list[str] = []

    def pass_time(self, seconds: float, **each_step: int) -> None:
        for _ in range(round(seconds / STEP_S)):
            self.now_s += STEP_S
            for name, number in each_step.items():
                self.counts[name] += number
            found = self.share.add(self.now_s, dict(self.counts))
            if found is not None:
                self.reported.append(found)


@pytest.mark.parametrize(
    ("each_step", "share"),
    [
        ({"received": 20, "wrong_checksum": 10}, "50%"),
        ({"received": 20, "wrong_length": 20}, "100%"),
        ({"received": 20, "counter_stuck": 4}, "20%"),
        ({"received": 40, "foreign": 20, "out_of_range": 10}, "50%"),
        ({"received": 5, "exceptions": 5}, "50%"),
        ({"received": 5, "timeouts": 5}, "50%"),
        ({"received": 5, "timeouts": 5, "wrong_checksum": 5}, "50%"),
    ],
)
def test_a_large_share_is_reported_with_its_reason(each_step: dict[str, int], share: str) -> None:
    port = Counting()
    port.pass_time(3.0 * WINDOW_S, **each_step)
    (text,) = port.reported
    assert f"drive: {share} of" in text
    assert list(each_step)[-1] in text
    assert port.share.cause is None


def test_a_burst_and_a_rare_disturbance_are_not_reported() -> None:
    port = Counting()
    port.pass_time(2.0 * WINDOW_S, received=24)
    port.pass_time(0.3, received=24, wrong_checksum=24)
    port.pass_time(2.0 * WINDOW_S, received=24, wrong_checksum=1)
    assert port.reported == []


def test_it_is_reported_again_after_a_good_window() -> None:
    port = Counting()
    for _ in range(3):
        port.pass_time(2.0 * WINDOW_S, received=24, wrong_checksum=12)
        port.pass_time(2.0 * WINDOW_S, received=24)
    assert len(port.reported) == 3


def test_a_share_about_the_limit_is_reported_once() -> None:
    port = Counting()
    for _ in range(10):
        port.pass_time(WINDOW_S, received=100, wrong_checksum=11)
        port.pass_time(WINDOW_S, received=100, wrong_checksum=8)
    assert len(port.reported) == 1


def test_a_share_at_its_limit_is_a_cause_until_it_falls() -> None:
    port = Counting(limit=0.5)
    port.pass_time(2.0 * WINDOW_S, received=20, wrong_checksum=9)
    assert port.share.cause is None
    port.pass_time(2.0 * WINDOW_S, received=20, wrong_checksum=11)
    assert port.share.cause is not None
    assert port.share.cause.startswith("refused frames: drive: 55% of")
    port.pass_time(2.0 * WINDOW_S, received=20)
    assert port.share.cause is None


def test_silence_is_no_refusal() -> None:
    port = Counting(limit=0.5)
    port.pass_time(3.0 * WINDOW_S)
    port.pass_time(3.0 * WINDOW_S, timeouts=5)
    assert port.reported == []
    assert port.share.cause is None
