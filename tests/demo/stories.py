"""Records of demonstrations that never were, for tests of what is made of them."""

from __future__ import annotations

from datetime import UTC, datetime

from adaptdrive.runtime.reports import Severity
from adaptdrive_sim.demo import heard
from adaptdrive_sim.demo.record import DemoRecord

BEGAN = datetime(2026, 11, 21, 12, 0, tzinfo=UTC)


class Clock:
    """A clock that tests turn by hand."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


def state(**changes: object) -> heard.StateMessage:
    values: dict[str, object] = {
        "time": BEGAN,
        "state": "running",
        "mode": "fixed",
        "controller": "fixed",
        "reason": "",
        "enabled": True,
        "setpoint": 3.0,
        "waveform": None,
        "pole": 0.7,
        "trip": None,
    }
    return heard.StateMessage(**{**values, **changes})  # type: ignore[arg-type]


def load(k: int, reference: float, output: float, controller: str = "fixed") -> heard.LoadMessage:
    estimates = {
        "gain": heard.EstimateMessage(0.011, 0.0001),
        "tau_sum_s": heard.EstimateMessage(33.4, 0.2),
        "tau_product_s2": heard.EstimateMessage(234.0, None),
    }
    return heard.LoadMessage(BEGAN, k, reference, output, 281.0, estimates, controller, 0.25)


def drive(ticks: int, output: float | None = 3.0) -> heard.DriveMessage:
    lateness = heard.QuantilesMessage(120.0, 900.0, 1500.0)
    return heard.DriveMessage(280.4, 440.0, output, ticks, 3, 17, lateness)


def truth(disks: int) -> heard.Truth:
    return heard.Truth(disks, 146.0, 0.011, 11.7 * disks, 10.0)


def event(detail: str, kind: str = "state", severity: str = "info") -> heard.EventMessage:
    return heard.EventMessage(kind, Severity(severity), detail, 0, time=BEGAN)


def steady_record(seconds: int, output: float = 3.0, reference: float = 3.0) -> DemoRecord:
    """A drive that has been held somewhere for a time."""
    clock = Clock()
    record = DemoRecord(BEGAN, clock)
    record.connected = record.online = True
    record.hear_state(state())
    record.hear_truth(truth(2))
    record.hear_drive(drive(ticks=100))
    for second in range(1, seconds + 1):
        clock.now_s += 1.0
        record.hear_load(load(second, reference, output))
        record.hear_drive(drive(100 + 120 * second, output))
    return record
