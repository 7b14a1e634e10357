"""Which explanation of an alarm is kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from adaptdrive.control import rivals as riv
from adaptdrive.control.evidence import WINDOW
from adaptdrive.control.hypotheses import BOTH, DISTURBANCE, LOAD, NOTHING
from adaptdrive.control.regression import theta_of
from tests.closed_loop.bench import MOTOR, SCALED_LEARNING

LEARNING = replace(
    SCALED_LEARNING, bias=True, alert=True, initial_state=True, initial_covariance=1e8
)
COUNT = 6
POWER = 1e-8
NOMINAL = [
    *theta_of(LEARNING, MOTOR, list(MOTOR.numerator), list(MOTOR.denominator)),
    0.0,
    0.0,
    0.0,
]
UNSURE, SURE = 1e8, 1e2
"""Variances over σ²: deviations of 1 and of 0.001 in θ."""


def compared(scores: dict[int, float], samples: int, variance: float = SURE) -> riv.Rivals:
    """Explanations with these scores after some samples, each with the nominal θ."""
    rivals = riv.new_rivals(COUNT)
    rivals.samples, rivals.anchor.power = samples, POWER
    for kind, score in scores.items():
        branch = rivals.branches[kind]
        branch.theta[:], branch.score = NOMINAL, score
        branch.upper[:] = np.eye(COUNT).ravel().tolist()
        branch.diagonal[:] = [variance] * COUNT
    return rivals


@pytest.mark.parametrize(("variance", "kept"), [(UNSURE, DISTURBANCE), (SURE, BOTH)])
def test_an_explanation_that_leaves_the_load_unknown_replaces_no_known_one(
    variance: float, kept: int
) -> None:
    scores = {NOTHING: -59.1, DISTURBANCE: -43.4, LOAD: -44.7, BOTH: -38.3}
    rivals = compared(scores, WINDOW, variance)
    assert riv.is_settled(rivals, LEARNING, MOTOR)
    assert rivals.kind == kept


def test_far_ahead_of_all_others_an_unknown_load_is_better_than_a_wrong_one() -> None:
    scores = {NOTHING: -90.0, DISTURBANCE: -70.0, LOAD: -60.0, BOTH: -38.3}
    rivals = compared(scores, WINDOW, UNSURE)
    assert riv.is_settled(rivals, LEARNING, MOTOR)
    assert rivals.kind == BOTH
