"""Settings of the runtime of one drive, and the interface of its fast loop to the rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from adaptdrive.config.services import Realtime
from adaptdrive.config.timing import Timing
from adaptdrive.control.signals import Decision, Snapshot
from adaptdrive.runtime.capacitor import CapacitorLimits
from adaptdrive.runtime.guard import CommandLimits
from adaptdrive.runtime.interlocks import Limits, Watch
from adaptdrive.runtime.limits import MachineLimits
from adaptdrive.runtime.reports import TickReport


@dataclass(slots=True)
class TickCounts:
    """Counts since the start.

    Attributes:
        ticks: Ticks run.
        missed: Half cycles that passed without a tick.
        held: Stand-in ticks.
        withheld: Commands that were not given to the port: the drive must report first.
    """

    ticks: int = 0
    missed: int = 0
    held: int = 0
    withheld: int = 0


@dataclass(frozen=True, slots=True)
class FastLoopSettings:
    """Settings of the fast loop.

    Attributes:
        limits: Trip levels.
        command: Limits of what may be sent.
        timing: Times of the drive.
        latency_ticks: L, ticks from a snapshot to the effect of its decision.
        late_fraction: Lateness of a frame, in ticks, at which a stand-in tick runs.
        timer_standin: Whether the timer stands in at all.
        watches: Factories of the watches over the output, in the order of their causes.
        drive_clocks: Whether the drive decides when a reading comes.
        capacitor: The boost capacitor that this process charges, None where the drive does.
    """

    limits: Limits
    command: CommandLimits
    timing: Timing
    latency_ticks: int
    late_fraction: float
    timer_standin: bool
    watches: tuple[Callable[[], Watch], ...] = ()
    drive_clocks: bool = True
    capacitor: CapacitorLimits | None = None


@dataclass(frozen=True, slots=True)
class DaemonSettings:
    """Settings of the runtime.

    Attributes:
        machine: Operator's limits.
        pole: Closed-loop pole at start.
        fast: The fast loop.
        report_s: Time between two drive reports.
        realtime: How hard the fast loop is protected from the rest of the machine.
        refused_share: Share of refused frames that trips the drive, 0 for none.
    """

    machine: MachineLimits
    pole: float
    fast: FastLoopSettings
    report_s: float
    realtime: Realtime
    refused_share: float = 0.0


class LoopSurroundings(Protocol):
    """Interfaces of the fast loop to the rest of the runtime; every call returns at once."""

    def now_s(self) -> float:
        """Monotonic time."""

    def arm(self, deadline_s: float) -> None:
        """Call `on_deadline` at a monotonic time."""

    def met_deadline(self, now_s: float) -> None:
        """Take note of a tick that was in time."""

    def ticked(self, report: TickReport) -> None:
        """Take the report of a complete tick."""

    def snapshot_taken(self, snapshot: Snapshot) -> bool:
        """Queue a snapshot for the slow loop; False when it has fallen hopelessly behind."""

    def decided(self, snapshot: Snapshot, decision: Decision) -> None:
        """Take note of a decision that takes effect."""

    def not_stopped(self, detail: str) -> None:
        """Take note of a stop that the drive has not confirmed in time."""

    def run_ended(self) -> None:
        """Discard what was decided: the drive is no longer running."""
