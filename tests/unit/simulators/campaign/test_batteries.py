"""Batteries in a campaign: drawn, charged by the daemon's machine, judged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from adaptdrive_sim.campaign import repeat_run, run_campaign
from adaptdrive_sim.campaign.batteries import BatteryCampaign, BatteryScenario, draw_battery
from adaptdrive_sim.campaign.settings import FOLDER, read_campaign_of
from adaptdrive_sim.plants.battery import Battery

SHIPPED = Path("battery.toml")
TEXT = (FOLDER / SHIPPED).read_text(encoding="utf-8")
SEEDS = range(310_001, 310_101)


def read_battery_campaign(path: Path) -> BatteryCampaign:
    return read_campaign_of(path, {"battery": BatteryCampaign})


def scenarios() -> list[BatteryScenario]:
    campaign = read_battery_campaign(SHIPPED)
    return [draw_battery(campaign, seed) for seed in SEEDS]


def test_every_voltage_is_drawn_and_some_batteries_age() -> None:
    drawn = scenarios()
    full_V = np.array([4.1 * one.cells for one in drawn])
    assert full_V.min() < 20.0
    assert 300.0 < full_V.max() < 404.0
    assert np.median(full_V) == pytest.approx(70.0, rel=0.3)
    assert {True, False} == {one.growth > 1.0 for one in drawn}


def test_every_charger_has_the_power_and_the_reach_of_the_example() -> None:
    for one in scenarios():
        configuration = one.configuration()
        assert one.largest_A * 4.1 * one.cells == pytest.approx(14.0 * 82.0)
        coupling = one.world(Battery(one.battery())).coupling
        needed_V = 4.1 * one.cells + one.largest_A * coupling.droop_Ohm
        assert 0.9 * 400.0 * coupling.ratio < needed_V < 400.0 * coupling.ratio
        assert configuration.load.reference_max == one.largest_A


@pytest.mark.proof
def test_a_campaign_is_written_and_a_run_is_repeated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(TEXT.replace("duration_s = 360.0", "duration_s = 300.0"), encoding="utf-8")
    rows = run_campaign(path, tmp_path, scheduler=None, processes=1, runs=2)
    assert pq.read_table(tmp_path / "results.parquet").to_pylist() == rows
    assert (tmp_path / "influences.png").stat().st_size > 10_000
    repeat_run(path, rows[0]["seed"], tmp_path)
    recorded = pq.read_table(tmp_path / f"run-{rows[0]['seed']}.parquet").to_pylist()
    assert {row["mode"] for row in recorded} == {"fixed", "adaptive"}
    printed = capsys.readouterr().out
    assert "2 runs, each fixed and adaptive" in printed
    assert "adaptive in force for half of the constant current" in printed
