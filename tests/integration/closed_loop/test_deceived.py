"""The whole fast loop and a sensor that lies, or does not: what trips, and how soon."""

from __future__ import annotations

import pytest

from tests.support import sample
from tools.proof.deceived import honest, lied_to


@pytest.mark.parametrize(
    ("load", "seed"), sample([("motor", 100), ("battery", 100), ("motor", 101)], 1)
)
def test_an_honest_sensor_of_a_wrong_model_trips_nothing(load: str, seed: int) -> None:
    assert honest((load, seed)) == ""


@pytest.mark.parametrize(
    ("fault", "longest_s"),
    sample(
        [("wire broken: reads 0", 1.0), ("reversed from the start", 30.0), ("decays, 3 s", 45.0)], 1
    ),
)
def test_a_sensor_that_lies_trips(fault: str, longest_s: float) -> None:
    assert lied_to(("motor", fault, 1)) < longest_s
