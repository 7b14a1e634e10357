"""Campaigns: whole experiments a second, on one process and on two."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from statistics import median

from adaptdrive_sim.campaign.settings import read_campaign
from tests.benchmarks.campaign_speed import measure
from tests.benchmarks.rows import Extent, Row

COUNTS = (1, 2)
WANTED_per_s = 100.0


def rows(extent: Extent) -> Iterator[Row]:
    """All rows of this file."""
    campaign = read_campaign(Path("standard.toml"))
    runs, rounds = extent.pick((80, 9), (40, 3), (4, 1))
    found = measure(campaign, COUNTS, runs=runs, rounds=rounds)
    one, two = (median(each.experiments_per_s for each in found[count]) for count in COUNTS)
    cpu_ms = median(each.cpu_ms for each in found[1])
    note = f"{cpu_ms:.1f} ms CPU for 22 simulated minutes"
    yield Row("campaign on one process, experiments a second", one, "/s", note=note)
    yield Row(
        "campaign on two processes, experiments a second",
        two,
        "/s",
        one,
        "one process",
        f"at least {WANTED_per_s:.0f}",
        two >= WANTED_per_s,
    )
