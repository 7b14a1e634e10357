"""The life of a motor is drawn, reaches the plant, and leaves other runs as they were."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from adaptdrive.control.signals import Mode
from adaptdrive_sim.campaign.settings import LifeRanges, read_campaign
from adaptdrive_sim.campaign.stands import Life, Scenario, Stand, draw, volt_Nm
from adaptdrive_sim.plants.motor import Motor

SEEDS = range(210_001, 210_101)


@pytest.fixture(scope="module")
def drawn() -> list[Scenario]:
    campaign = read_campaign(Path("life.toml"))
    return [draw(campaign, seed) for seed in SEEDS]


def test_a_life_leaves_every_other_draw_as_it_was() -> None:
    wide = read_campaign(Path("wide.toml"))
    eventful = wide.model_copy(update={"life": LifeRanges(torque_changes=(3, 3), torque_V=(1, 2))})
    before, after = draw(wide, 7), draw(eventful, 7)
    assert before.life == Life(inertia_ramps_s=(0.0,) * len(before.change_times_s))
    names = [one.name for one in fields(Scenario) if one.name != "life"]
    assert [getattr(before, name) for name in names] == [getattr(after, name) for name in names]
    assert len(after.life.torques_V) == 3


def test_everything_happens_in_some_runs_and_not_in_others(drawn: list[Scenario]) -> None:
    lives = [scenario.life for scenario in drawn]
    for happens in (
        [bool(life.torques_V) for life in lives],
        [0.0 in life.torque_ramps_s for life in lives],
        [bool(life.idle_times_s) for life in lives],
        [np.inf in life.idle_s for life in lives],
        [bool(life.stop_times_s) for life in lives],
    ):
        assert {True, False} == set(happens)
    assert max(life.largest_torque_V for life in lives) <= 20.0
    assert min(life.offset for life in lives) < -0.04 < 0.04 < max(life.offset for life in lives)


def test_no_set_point_needs_more_than_v_c_has(drawn: list[Scenario]) -> None:
    for scenario in drawn:
        stand = Stand(scenario)
        world = stand.world()
        motor = world.load
        assert isinstance(motor, Motor)
        motor.disturb(volt_Nm() * scenario.life.largest_torque_V)
        assert world.boost_voltage_for(scenario.reference.high - scenario.life.offset) < 400.0


@pytest.mark.parametrize("mode", [Mode.FIXED, Mode.ADAPTIVE])
def test_a_life_of_everything_is_lived_to_its_end(mode: Mode) -> None:
    campaign = read_campaign(Path("life.toml")).model_copy(update={"duration_s": 600.0})
    stand = Stand(next(one for s in SEEDS if _is_full(one := draw(campaign, s))))
    run = stand.run(mode)
    assert run.interlock == 0
    assert stand.plan.stops
    assert np.isfinite(run["output"][stand.running()]).all()


def _is_full(scenario: Scenario) -> bool:
    life = scenario.life
    ramped = max(life.inertia_ramps_s, default=0.0) > 0.0
    return len(life.torques_V) > 4 and ramped and bool(life.idle_s) and bool(life.stop_times_s)
