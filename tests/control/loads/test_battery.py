"""The battery's model against the impedances of its circuit."""

import numpy as np
import pytest

from adaptdrive.control.loads.battery import battery_load, paper_model, physical
from tests.control.systems import System, held_polynomials

BATTERY = battery_load(turns_ratio=0.25, series_Ohm=1.2, relaxation_Ohm=0.3, relaxation_s=60.0)
SYSTEM = System(list(BATTERY.numerator), list(BATTERY.denominator))


def test_its_parameters_are_what_a_step_shows_first_and_last_and_how_fast() -> None:
    direct, final, tau_s = physical(SYSTEM.numerator, SYSTEM.denominator)
    assert direct == pytest.approx(0.25 / 1.2)
    assert final == pytest.approx(0.25 / 1.5)
    assert tau_s == pytest.approx(60.0 * 1.2 / 1.5)


def test_the_discrete_model_is_the_held_one_a_period_later() -> None:
    a, b = paper_model(SYSTEM.numerator, SYSTEM.denominator, 1.0)
    expected_a, expected_b = held_polynomials(SYSTEM, 1.0)
    assert np.allclose(a, expected_a, rtol=1e-12)
    assert np.allclose(b, [0.0, *expected_b], rtol=0.0, atol=1e-12)
    assert len(b) == BATTERY.paper_taps + 1
