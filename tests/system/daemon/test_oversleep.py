"""A daemon that is kept from running for a while, on a real bus whose frames pile up meanwhile."""

from __future__ import annotations

import itertools
import time
from datetime import UTC, datetime

import pytest

from tests.support import suspended_machine
from tests.system.conftest import MakeSite
from tests.system.daemon.site import BusEar, Site, until

ASLEEP_S = 0.06
TICK_S = 1.0 / 120.0
NAPS = 3


def test_a_thawed_daemon_energises_nothing(make_site: MakeSite) -> None:
    """Frozen for longer than `stale_s`: the drive hears safe commands only.

    All but one that was on its way to the bus when the daemon froze; a safe one is behind it.
    """
    site = make_site()
    site.start("--initial-voltage", "280")
    site.run_drive()
    with BusEar(site.config) as bus:
        until(lambda: bus.commands() and bus.commands()[-1].bridge, "the bridge is commanded on")
        with site.stalled(site.daemon):
            time.sleep(4.0)
            thawed_s = time.monotonic()
        trip = site.await_state(state="tripped")["trip"]
        known = len(bus.commands())
        until(lambda: len(bus.commands()) > known + 60, "half a second of commands")
        later = [command for command in bus.commands() if command.time_s > thawed_s]
    assert trip.startswith("overslept: the daemon did not run for ")
    assert len(later) > 60
    assert all(command.safe for command in later[1:])


@pytest.mark.proof
def test_after_a_short_stop_the_newest_frame_decides(make_site: MakeSite) -> None:
    """No trip, and no burst of ticks for the frames that piled up."""
    site = make_site({"realtime.priority": "50"})
    site.start("--initial-voltage", "280")
    site.run_drive()
    for _ in range(NAPS):
        with site.stalled(site.daemon):
            time.sleep(ASLEEP_S)
        time.sleep(1.0)
    least = NAPS * int(0.8 * ASLEEP_S / TICK_S)
    until(lambda: site.ear.on("telemetry/drive")[-1].content["missed"] >= least, "they are counted")
    assert site.await_state(state="running")["trip"] is None
    assert site.stop_daemon() == 0
    _ticked_once_after_each_nap(site)


@pytest.mark.proof
def test_after_a_suspend_every_part_has_the_same_clock(make_site: MakeSite) -> None:
    """A machine that was suspended for an hour before the daemon started."""
    site = make_site()
    site.start_broker()
    site.start_device("--initial-voltage", "280")
    site.start_daemon(*suspended_machine(3600))
    site.await_measurement()
    site.run_drive()
    site.let_periods_pass(1)
    assert site.await_state(state="running")["trip"] is None
    assert site.stop_daemon() == 0
    last = site.session().ticks.column("utc")[-1].as_py()
    assert abs((datetime.now(UTC) - last).total_seconds()) < 600.0


def _ticked_once_after_each_nap(site: Site) -> None:
    rows = site.session().ticks.select(["sequence", "tick", "fresh"]).to_pylist()
    assert [row["sequence"] for row in rows] == list(range(len(rows)))
    ends = [
        later
        for earlier, later in itertools.pairwise(rows)
        if later["tick"] - earlier["tick"] >= 0.8 * ASLEEP_S / TICK_S
    ]
    assert len(ends) >= NAPS
    assert all(row["fresh"] for row in ends)
