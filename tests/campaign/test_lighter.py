"""Loads that become lighter under the gains of a heavier one."""

from __future__ import annotations

from pathlib import Path

import pytest

from adaptdrive_sim.campaign.main import run_seed
from adaptdrive_sim.campaign.settings import read_campaign

WIDE = read_campaign(Path("wide.toml"))


@pytest.mark.parametrize("seed", [8007207, 8003293, 8008924])
def test_a_lighter_load_is_found_before_the_gains_of_the_heavy_one_have_swung_it(seed: int) -> None:
    """Inertia of 2.3 to 2.9 disks falls to 0.3 to 0.5 with a slow sine, a square and a triangle."""
    assert run_seed(WIDE, seed)["ratio"] < 1.05
