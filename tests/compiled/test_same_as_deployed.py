"""The compiled run against the deployed controller, interpreted, on the same noise."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from adaptdrive.control.controller import Controller
from adaptdrive.control.settings import Probing
from adaptdrive.control.signals import Mode
from adaptdrive_sim.campaign.bench import Stand, deployed, draw
from adaptdrive_sim.campaign.settings import Campaign, read_campaign
from adaptdrive_sim.course import Course
from adaptdrive_sim.plants.motor import Motor
from adaptdrive_sim.site import Site
from adaptdrive_sim.world import World

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


def probed(stand: Stand) -> tuple[Site, Course]:
    """A controller that probes a load at rest, of which nothing is known."""
    random, own = np.random.default_rng(5), deployed()
    periods = 240
    course = Course(
        references=np.full(periods, 3.0),
        sizes=np.ones(periods),
        over_s=0.0,
        disturbances=4e-4 * random.standard_normal(periods * 120 + 1),
        mode=Mode.ADAPTIVE,
        pole=own.pole,
        steady=True,
    )
    world = World(Motor(stand.scenario.motor()))
    probing = Probing(amplitude=0.09, stale_periods=100, lowest=0.0, highest=4.5)
    controller = Controller(replace(own.settings, probing=probing), own.load)
    return Site(controller, world), course


def test_a_probe_is_the_same() -> None:
    stand = Stand(draw(read_campaign(Path("standard.toml")), 1))
    site, course = probed(stand)
    expected = site.run(course)
    site, course = probed(stand)
    found = site.run(course, compiled=True)
    assert found.interlock == 0
    shifts = [one.probe for one in expected.decisions]
    assert np.nanmax(shifts) == pytest.approx(0.09)
    np.testing.assert_allclose(found["boost_reference_V"], expected["boost_reference_V"], atol=1e-6)


@pytest.mark.parametrize("seed", range(1, 51))
def test_a_whole_run_is_the_same(seed: int) -> None:
    compare(seed, Mode.ADAPTIVE)
