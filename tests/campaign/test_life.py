"""The life of a motor is drawn, reaches the plant, and leaves other runs as they were."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from adaptdrive.control.signals import Mode, Stage
from adaptdrive_sim.campaign.bench import Scenario, Stand, draw
from adaptdrive_sim.campaign.judge import judge
from adaptdrive_sim.campaign.life import Life, volt_Nm
from adaptdrive_sim.campaign.settings import LifeRanges, read_campaign
from adaptdrive_sim.course import Run
from adaptdrive_sim.plants.motor import Motor
from tests.support import compiled

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


def eventful(seed: int = 3, **life: object) -> Stand:
    """A short run of a motor like the model, without noise, whose reference stands still."""
    standard = read_campaign(Path("standard.toml"))
    load = standard.load.model_copy(update={"gain": (1.0, 1.0), "inertia": (1.0, 1.0)})
    noise = standard.noise.model_copy(update={"sigma": (0.0, 0.0), "spike_share": (0.0, 0.0)})
    ranges = LifeRanges.model_validate({"constant": 1.0, **life})
    changes = {"load": load, "noise": noise, "life": ranges, "duration_s": 240.0}
    return Stand(draw(standard.model_copy(update=changes), seed))


def held_V(outcome: Run) -> float:
    return float(np.mean(outcome["applied_V"][-20:]))


@compiled
def test_torque_and_friction_take_the_volts_that_were_drawn() -> None:
    def held(**life: object) -> float:
        return held_V(eventful(seed, **life).run(Mode.FIXED))

    step = {"torque_changes": (1, 1), "torque_V": (15.0, 15.0)}
    early = (eventful(seed, **step).scenario for seed in range(20))
    seed = next(one.seed for one in early if one.life.torque_times_s[0] < 120.0)
    plain = held()
    assert held(**step) - plain == pytest.approx(15.0, abs=0.3)
    assert held(coulomb_V=(8.0, 8.0)) - plain == pytest.approx(8.0, abs=0.3)
    speed = eventful(seed).references[0] / 3.3
    assert held(drag_V=(8.0, 8.0)) - plain == pytest.approx(8.0 * speed**2, abs=0.3)


@compiled
def test_a_motor_coasts_while_the_drive_is_off_and_is_caught_again() -> None:
    stand = eventful(restarted=1.0, off_s=(10.0, 10.0))
    course = stand.course(Mode.ADAPTIVE)
    (stop,) = course.stops
    assert [course.stage(k) for k in (stop[0] - 1, stop[0], stop[-1], stop[-1] + 1)] == [
        *(Stage.RUN, Stage.OFF),
        *(Stage.PRECHARGE, Stage.RUN),
    ]
    outcome = stand.run_deployed(Mode.ADAPTIVE)
    assert outcome.interlock == 0
    assert len(outcome.decisions) == np.count_nonzero(stand.running())
    outputs = outcome["output"]
    assert np.all(np.isnan(outputs[stop[0] : stop[-1] + 1]))
    assert outputs[stop[-1] + 2] < 0.9 * stand.references[0]
    assert outputs[-1] == pytest.approx(stand.references[0], abs=0.01)
    assert np.isfinite(judge(stand, outcome, outcome)["cost_adaptive"])


@compiled
@pytest.mark.parametrize("mode", [Mode.FIXED, Mode.ADAPTIVE])
def test_compiled_code_lives_the_same_life(mode: Mode) -> None:
    campaign = read_campaign(Path("life.toml")).model_copy(update={"duration_s": 600.0})
    stand = Stand(next(one for s in SEEDS if _is_full(one := draw(campaign, s))))
    found, expected = stand.run(mode), stand.run_deployed(mode)
    assert found.interlock == expected.interlock == 0
    for name in ("adaptive", "accepted", "verdict"):
        assert np.array_equal(found[name], expected[name])
    np.testing.assert_allclose(found.trace, expected.trace, rtol=1e-6, atol=1e-9)


def _is_full(scenario: Scenario) -> bool:
    life = scenario.life
    ramped = max(life.inertia_ramps_s, default=0.0) > 0.0
    return len(life.torques_V) > 4 and ramped and bool(life.idle_s) and not life.stop_times_s
