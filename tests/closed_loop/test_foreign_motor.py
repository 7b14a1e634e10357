"""A foreign motor whose inertia doubles and triples: known soon, and adaptive stays in force."""

from __future__ import annotations

import pytest

from adaptdrive_sim.plants.boost import BoostParameters
from adaptdrive_sim.world import World, WorldParameters
from tools.benchmarks.foreign_motor import ForeignMotor, draw, run, truth


@pytest.mark.proof
@pytest.mark.parametrize("seed", range(31000, 31003))
def test_every_change_of_a_foreign_motor_is_known_and_survived(seed: int) -> None:
    _, judged = run(draw(seed))
    assert judged.known == [True, True], judged
    assert judged.in_force == [True, True], judged
    assert judged.fell_back == [False, False], judged


def test_the_shown_truth_is_that_of_the_motor() -> None:
    motor = ForeignMotor()
    world = World(motor, WorldParameters(boost=BoostParameters()))
    world.settle(world.boost_voltage_for(3.1))
    rest_V, wanted = motor.source_for(3.1, 1.0), truth(1)
    for _ in range(12_000):
        motor.drive(rest_V + 0.25, 1.0, 1.0 / 120.0)
    assert (motor.output - 3.1) == pytest.approx(wanted["gain"], rel=0.02)
