"""Baths are drawn, run from start to end, and are judged as motors are."""

from __future__ import annotations

import math
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from adaptdrive_sim.campaign import read_any_campaign, run_campaign, run_seed
from adaptdrive_sim.campaign.settings import FOLDER, BathCampaign
from adaptdrive_sim.campaign.stands import BathScenario, BathStand, draw_bath
from adaptdrive_sim.plants.bath import Bath

BATHS = (FOLDER / "bath.toml").read_text(encoding="utf-8")
SEEDS = range(510_001, 510_101)


def campaign(**changes: float) -> BathCampaign:
    found = read_any_campaign(Path("bath.toml"))
    assert isinstance(found, BathCampaign)
    return found.model_copy(update=changes)


@pytest.fixture(scope="module")
def drawn() -> list[BathScenario]:
    return [draw_bath(campaign(), seed) for seed in SEEDS]


def test_everything_happens_in_some_runs_and_not_in_others(drawn: list[BathScenario]) -> None:
    for happens in (
        [bool(one.fill_times_s) for one in drawn],
        [bool(one.inflow_times_s) for one in drawn],
        [one.drift_K_per_h > 0.0 for one in drawn],
        [one.constant for one in drawn],
    ):
        assert {True, False} == set(happens)
    assert min(one.offset_K for one in drawn) < -0.4 < 0.4 < max(one.offset_K for one in drawn)
    assert max(abs(one.drift_K_per_h) for one in drawn) <= 1.0


def test_no_set_point_needs_more_than_v_c_has(drawn: list[BathScenario]) -> None:
    """At the worst moment: the inflow at its coldest or warmest, the heater old or new."""
    for scenario in drawn:
        bath = BathStand(scenario).world().load
        assert isinstance(bath, Bath)
        shift_K = abs(scenario.drift_K_per_h) * scenario.turn_s / 3600.0
        for share in scenario.inflows:
            bath.disturb(share / scenario.inflows[0])
            low, high = scenario.reference.low, scenario.reference.high
            most = bath.source_for(high - scenario.offset_K + shift_K, 1.0) / 0.25
            least = bath.source_for(low - scenario.offset_K - shift_K, 1.0) / 0.25
            assert 200.0 < least < most < 400.0


@pytest.mark.proof
def test_a_campaign_of_baths_leaves_a_row_for_each_seed_and_pictures(tmp_path: Path) -> None:
    path = tmp_path / "short.toml"
    path.write_text(BATHS.replace("duration_s = 10800.0", "duration_s = 4800.0"), encoding="utf-8")
    rows = run_campaign(path, tmp_path, scheduler=None, processes=1, runs=2)
    assert [row["seed"] for row in rows] == [500_001, 500_002]
    assert all(math.isfinite(row["ratio"]) for row in rows)
    table = pq.read_table(tmp_path / "results.parquet").to_pylist()
    assert [row["ratio"] for row in table] == [row["ratio"] for row in rows]
    assert (tmp_path / "influences.png").stat().st_size > 10_000
    again = run_seed(read_any_campaign(path), 500_002)
    assert again["cost_adaptive"] == rows[1]["cost_adaptive"]
