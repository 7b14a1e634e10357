"""The order of calls to a controller: the same live, simulated and replayed.

At tick n the decision that is due takes effect first, then the fast half runs. At n = kQ the fast
half leaves a snapshot. The decision made of it is due at tick kQ + L, or at the first tick after
its delivery when it comes later. When a run ends, what was decided for it is void.
"""

from typing import Final, Protocol

from adaptdrive.control.signals import Command, Decision, Measurement, Order, Snapshot, Stage

_RUN: Final[Stage] = Stage.RUN  # found at once by compiled code


class TwoRate(Protocol):
    """A controller with a fast and a slow half."""

    def tick(self, measurement: Measurement, order: Order) -> Command:
        """Run the fast half."""

    def take_snapshot(self) -> Snapshot | None:
        """Return the snapshot made in the last tick, once."""

    def decide(self, snapshot: Snapshot) -> Decision:
        """Run the slow half."""

    def apply(self, decision: Decision) -> None:
        """Let a decision take effect from the next tick on."""


class Schedule:
    """Calls one controller in the order above.

    Attributes:
        applied_k: Slow index of the decision that took effect at the last tick, -1 for none.
        late_decisions: Decisions that were not there at their tick.
    """

    def __init__(self, controller: TwoRate, latency_ticks: int) -> None:
        """Begin with nothing decided.

        Args:
            controller: The controller.
            latency_ticks: L, ticks from a snapshot to the effect of its decision.
        """
        self._controller = controller
        self._latency_ticks = latency_ticks
        self._due: tuple[int, Decision] | None = None
        self._run_tick: int | None = None
        self.applied_k = -1
        self.late_decisions = 0

    def tick(self, measurement: Measurement, order: Order) -> Command:
        """Apply what is due, then run the fast half."""
        self.applied_k = -1
        if order.stage is not _RUN:
            self._run_tick = self._due = None
        elif self._run_tick is None:
            self._run_tick = measurement.tick
        if self._due is not None and measurement.tick >= self._due[0]:
            self._apply(measurement.tick, *self._due)
        return self._controller.tick(measurement, order)

    def take_snapshot(self) -> Snapshot | None:
        """Return the snapshot made in the last tick, once."""
        return self._controller.take_snapshot()

    def deliver(self, snapshot: Snapshot, decision: Decision) -> bool:
        """Take a decision for its tick; False when the run of its snapshot is over."""
        if self._run_tick is None or snapshot.tick < self._run_tick:
            return False
        self._due = (snapshot.tick + self._latency_ticks, decision)
        return True

    def decide(self, snapshot: Snapshot) -> Decision:
        """Run the slow half at once, as a runner does in which nothing waits."""
        decision = self._controller.decide(snapshot)
        self.deliver(snapshot, decision)
        return decision

    def _apply(self, tick: int, due_tick: int, decision: Decision) -> None:
        self._due = None
        self.late_decisions += tick > due_tick
        self._controller.apply(decision)
        self.applied_k = decision.k
