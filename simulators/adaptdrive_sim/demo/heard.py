"""Messages that the demonstration receives over MQTT, with the keys that it uses.

A number is None where the payload has null, which stands for an unknown value in JSON.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import msgspec

from adaptdrive.control.reach import UNKNOWN
from adaptdrive.runtime import reports
from adaptdrive.runtime.reports import StateReport


class QuantilesMessage(msgspec.Struct, frozen=True):
    """Quantiles of a time in microseconds."""

    p50: float | None
    p99: float | None
    max: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class StateMessage(StateReport):
    """From `state`; the reach is not used here, and null where it is not known."""

    time: datetime
    reach: Any = UNKNOWN


class DriveMessage(msgspec.Struct, frozen=True):
    """From `telemetry/drive`."""

    boost_voltage_V: float | None
    load_power_W: float | None
    output: float | None
    ticks: int
    missed: int
    held: int
    lateness_us: QuantilesMessage


class EstimateMessage(msgspec.Struct, frozen=True):
    """One estimated parameter."""

    value: float | None
    std: float | None


class LoadMessage(msgspec.Struct, frozen=True):
    """From `telemetry/load`."""

    time: datetime
    k: int
    reference: float
    output: float | None
    boost_reference_V: float
    estimates: dict[str, EstimateMessage]
    controller: str
    handover_step_V: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class EventMessage(reports.Event):
    """From `event`."""

    time: datetime


class Truth(msgspec.Struct, frozen=True):
    """From the simulated drive: what an estimator is to find."""

    disks: int
    speed_rad_s: float
    gain: float
    tau_motor_s: float
    tau_filter_s: float

    @property
    def parameters(self) -> dict[str, float]:
        """The load's parameters, by the names that its estimates have."""
        return {
            "gain": self.gain,
            "tau_sum_s": self.tau_motor_s + self.tau_filter_s,
            "tau_product_s2": self.tau_motor_s * self.tau_filter_s,
        }


def known(value: float | None) -> float:
    """Return a number that may be absent; NaN where it is."""
    return math.nan if value is None else value
