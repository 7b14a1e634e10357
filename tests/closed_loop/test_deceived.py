"""The whole fast loop and a sensor that lies, or does not: what trips, and how soon."""

from __future__ import annotations

import pytest

from tools.proof.deceived import honest, lied_to

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("job", [("motor", 100), ("motor", 101), ("battery", 100)], ids=str)
def test_an_honest_sensor_of_a_wrong_model_trips_nothing(job: tuple[str, int]) -> None:
    assert honest(job) == ""


@pytest.mark.parametrize(
    ("fault", "longest_s"),
    [("reversed from the start", 30.0), ("wire broken: reads 0", 1.0), ("decays, 3 s", 45.0)],
)
def test_a_sensor_that_lies_trips(fault: str, longest_s: float) -> None:
    assert lied_to(("motor", fault, 1)) < longest_s
