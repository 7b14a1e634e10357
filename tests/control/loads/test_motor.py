"""The motor's model against the simulated motor's physics."""

import pytest

from adaptdrive.control.discretise import impulse_invariant_pair
from adaptdrive.control.loads.motor import motor_load, paper_model, physical
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from tests.control.systems import System


@pytest.mark.parametrize("disks", [1, 2, 3])
def test_the_model_is_that_of_the_simulated_motor(disks: int) -> None:
    truth = Motor(MotorParameters(), disks).model(0.25, 1.0)
    load = motor_load(truth["gain"], truth["tau_motor_s"], truth["tau_filter_s"])
    expected_model = {"gain": 0.011, "tau_motor_s": 11.7 * disks, "tau_filter_s": 10.0}
    assert {name: truth[name] for name in expected_model} == pytest.approx(expected_model, rel=1e-4)
    for rad_s in (0.001, 0.1, 3.0):
        s = 1j * rad_s
        expected = truth["gain"] / (
            (truth["tau_motor_s"] * s + 1.0) * (truth["tau_filter_s"] * s + 1.0)
        )
        found = System(list(load.numerator), list(load.denominator)).response(rad_s)
        assert found == pytest.approx(expected, rel=1e-12)


def test_its_parameters_have_names_in_their_order() -> None:
    load = motor_load(0.011, 11.7, 10.0)
    values = physical(list(load.numerator), list(load.denominator))
    assert dict(zip(load.names, values, strict=True)) == pytest.approx(
        {"gain": 0.011, "tau_sum_s": 21.7, "tau_product_s2": 117.0}
    )


def test_a_complex_pair_is_a_legal_motor() -> None:
    a, b = paper_model([0.0, 0.0, 1e-4], [1.0, 0.15, 0.01], 1.0)
    assert (a, b) == impulse_invariant_pair(1e-4 / 0.01, 15.0, 100.0, 1.0)
