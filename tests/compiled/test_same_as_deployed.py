"""The compiled run against the deployed controller, interpreted, on the same noise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from adaptdrive.control.signals import Mode
from adaptdrive_sim.campaign.bench import Stand, draw
from adaptdrive_sim.campaign.settings import Campaign, read_campaign

DECISIONS = ("adaptive", "accepted", "verdict")

pytestmark = [pytest.mark.proof, pytest.mark.timeout(3600)]


def compare(seed: int, mode: Mode, duration_s: float | None = None) -> None:
    campaign: Campaign = read_campaign(Path("standard.toml"))
    if duration_s is not None:
        campaign = campaign.model_copy(update={"duration_s": duration_s})
    stand = Stand(draw(campaign, seed))
    expected = stand.run_deployed(mode)
    found = stand.run(mode)
    assert found.interlock == expected.interlock
    assert len(expected.decisions) == len(stand.times_s)
    for name in DECISIONS:
        assert np.array_equal(found[name], expected[name])
    voltages = found["boost_reference_V"] - expected["boost_reference_V"]
    assert np.max(np.abs(voltages)) < 1e-6
    np.testing.assert_allclose(found.trace, expected.trace, rtol=1e-6, atol=1e-9)


def test_a_short_run_is_the_same_with_the_fixed_controller() -> None:
    compare(1, Mode.FIXED, duration_s=120.0)


@pytest.mark.parametrize("seed", range(1, 51))
def test_a_whole_run_is_the_same(seed: int) -> None:
    compare(seed, Mode.ADAPTIVE)
