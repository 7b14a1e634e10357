from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from adaptdrive_sim.campaign.settings import Campaign, read_campaign
from adaptdrive_sim.campaign.stands import Scenario, draw


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    return read_campaign(Path("standard.toml"))


@pytest.fixture(scope="module")
def drawn(campaign: Campaign) -> list[Scenario]:
    return [draw(campaign, seed) for seed in range(2000)]


def test_a_seed_draws_the_same_run_again(campaign: Campaign) -> None:
    assert draw(campaign, 7) == draw(campaign, 7)
    noise = draw(campaign, 7).disturbances(100)
    assert np.array_equal(noise, draw(campaign, 7).disturbances(100))


def test_everything_stays_within_its_range(campaign: Campaign, drawn: list[Scenario]) -> None:
    low, high = campaign.load.inertia
    for scenario in drawn:
        assert all(low <= inertia <= high for inertia in scenario.inertias)
        ratios = np.array(scenario.inertias[1:]) / np.array(scenario.inertias[:-1])
        assert np.all(np.abs(np.log(ratios)) >= np.log(campaign.load.change_min) - 1e-12)
        assert 0.06 <= scenario.step <= 0.2
        assert scenario.sigma <= 0.02 * scenario.step
        assert scenario.output_delay_ticks in {0, 1, 2}


def test_a_wide_campaign_asks_for_nothing_that_v_c_cannot_hold() -> None:
    campaign = read_campaign(Path("wide.toml"))
    scenarios = [draw(campaign, seed) for seed in range(100)]
    for one in scenarios:
        least, most = 2.2 * one.gain, 4.4 * one.gain
        assert least < one.reference.low < one.reference.high < most
    assert min(one.gain for one in scenarios) < 0.65
    assert max(one.step for one in scenarios) > 0.9
