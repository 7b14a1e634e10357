"""The motor's model against the simulated motor's physics."""

import pytest

from adaptdrive.control.discretise import impulse_invariant_pair
from adaptdrive.control.loads.motor import paper_model
from adaptdrive_sim.plants.motor import Motor, MotorParameters


@pytest.mark.parametrize("disks", [1, 2, 3])
def test_the_model_is_that_of_the_simulated_motor(disks: int) -> None:
    truth = Motor(MotorParameters(), disks).model(0.25, 1.0)
    expected_model = {"gain": 0.011, "tau_motor_s": 11.7 * disks, "tau_filter_s": 10.0}
    assert {name: truth[name] for name in expected_model} == pytest.approx(expected_model, rel=1e-4)


def test_a_complex_pair_is_a_legal_motor() -> None:
    a, b = paper_model([0.0, 0.0, 1e-4], [1.0, 0.15, 0.01], 1.0)
    assert (a, b) == impulse_invariant_pair(1e-4 / 0.01, 15.0, 100.0, 1.0)
