"""A run in which somebody else than the controller decides V_c."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from adaptdrive.control.controller import Controller
from adaptdrive.control.schedule import Schedule
from adaptdrive.control.signals import Command, Decision, Measurement, Mode, Order, Snapshot
from adaptdrive_sim.course import NO_TRIPS, Course, Run
from adaptdrive_sim.site import Site

Decide = Callable[[int, float, float], float]
"""V_c in V from k, the mean of the output in its window and the mean applied V_c."""


def run_held(site: Site, course: Course, decide: Decide) -> Run:
    """Run the fast half of a controller, from rest and without interlocks; V_c is given.

    Args:
        site: The controller, whose slow half does not run, and the plant.
        course: What happens.
        decide: Gives V_c.

    Returns:
        A run that has the columns up to the applied V_c alone.
    """
    held = _HeldSite(site, decide)
    return held.run(replace(course, trips=NO_TRIPS))


class _FastHalf:
    """A controller that somebody else decides for."""

    def __init__(self, controller: Controller, decide: Decide) -> None:
        self._controller, self._decide = controller, decide

    def tick(self, measurement: Measurement, order: Order) -> Command:
        """Run the fast half."""
        return self._controller.tick(measurement, order)

    def take_snapshot(self) -> Snapshot | None:
        """Return the snapshot made in the last tick, once."""
        return self._controller.take_snapshot()

    def decide(self, snapshot: Snapshot) -> Decision:
        """Ask for V_c."""
        return Decision(
            k=snapshot.k,
            boost_reference_V=float(self._decide(snapshot.k, snapshot.output, snapshot.applied_V)),
            controller=Mode.FIXED,
            accepted=False,
            reason="",
            estimates={},
            gains=(),
            innovation=math.nan,
            excitation=math.nan,
            handover_step_V=math.nan,
        )

    def apply(self, decision: Decision) -> None:
        """Let a decision take effect from the next tick on."""
        self._controller.apply(decision)


class _HeldSite(Site):
    """A site with such a controller."""

    def __init__(self, site: Site, decide: Decide) -> None:
        super().__init__(site.controller, site.world, site.wire)
        latency_ticks = site.controller.settings.rates.latency_ticks
        self._schedule = Schedule(_FastHalf(site.controller, decide), latency_ticks)

    def note(self, run: Run, k: int) -> Decision:
        """Fill the columns of a slow period that are known."""
        snapshot, decision = self.snapshot, self.decision
        assert snapshot is not None
        assert decision is not None
        run["output"][k], run["measured"][k] = self.world.true_output, snapshot.output
        run["boost_reference_V"][k] = decision.boost_reference_V
        run["applied_V"][k] = snapshot.applied_V
        return decision
