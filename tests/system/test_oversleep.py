"""A daemon that is kept from running for a while, on a real bus whose frames pile up meanwhile."""

from __future__ import annotations

import itertools
import time

import pytest

from tests.system.conftest import MakeSite
from tests.system.site import Site

pytestmark = pytest.mark.slow

STALE_S = 0.08
ASLEEP_S = 0.12
"""Longer than a value may be old, and shorter than the grace of a drive that stops by itself."""

TICK_S = 1.0 / 120.0
NAPS = 3


def test_a_daemon_that_was_stopped_goes_on_with_the_newest_frame(make_site: MakeSite) -> None:
    """The oldest frame that waits is far too old, and the newest is fresh: no trip, no burst."""
    site = make_site(
        {
            "interlocks.stale_s": str(STALE_S),
            "recording.flush_s": "0.5",
            "realtime.priority": "50",
        }
    )
    site.start("--initial-voltage", "280")
    site.prefer_device()
    site.run_drive()
    for _ in range(NAPS):
        with site.stalled(site.daemon):
            time.sleep(ASLEEP_S)
        time.sleep(1.0)
    missed = site.ear.on("telemetry/drive")[-1].content["missed"]
    assert missed >= NAPS * int(0.8 * ASLEEP_S / TICK_S)
    assert site.await_state(state="running")["trip"] is None
    assert site.stop_daemon() == 0
    _ticked_once_after_each_nap(site)
    replayed = site.replay()
    assert replayed.returncode == 0, replayed.stdout + replayed.stderr
    assert replayed.stdout.splitlines()[1:] == ["every command is bit-equal"]


def _ticked_once_after_each_nap(site: Site) -> None:
    rows = site.session().ticks.select(["sequence", "tick", "fresh", "lateness_us"]).to_pylist()
    assert [row["sequence"] for row in rows] == list(range(len(rows)))
    ends = [
        later
        for earlier, later in itertools.pairwise(rows)
        if later["tick"] - earlier["tick"] >= 0.8 * ASLEEP_S / TICK_S
    ]
    assert len(ends) >= NAPS
    assert all(row["fresh"] for row in ends)
    # a burst would be ticks of readings that had waited for as long as the daemon slept
    assert max(row["lateness_us"] for row in rows) < 0.9e6 * ASLEEP_S
