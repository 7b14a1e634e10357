"""A foreign motor whose inertia doubles and triples: known soon, and adaptive stays in force."""

from __future__ import annotations

import pytest

from tools.benchmarks.foreign_motor import draw, run


@pytest.mark.proof
@pytest.mark.parametrize("seed", range(31000, 31003))
def test_every_change_of_a_foreign_motor_is_known_and_survived(seed: int) -> None:
    _, judged = run(draw(seed))
    assert judged.known == [True, True], judged
    assert judged.in_force == [True, True], judged
    assert judged.fell_back == [False, False], judged
