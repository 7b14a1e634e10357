"""Estimation methods behind their interface: a third one needs no change of the controller."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import get_args

import numpy as np
import pytest

from adaptdrive.config.load import Estimator
from adaptdrive.control.estimator import EstimatorState
from adaptdrive.control.lambda_method import LambdaMethod
from adaptdrive.control.load import Load
from adaptdrive.control.method import Method
from adaptdrive.control.methods import METHODS
from adaptdrive.control.settings import Learning
from adaptdrive.control.signals import Mode
from adaptdrive.pure import build_name
from tests.closed_loop.bench import EXACT, Bench, order, square_wave


@dataclass(frozen=True, slots=True)
class Projection(LambdaMethod):
    """The projection algorithm (Goodwin and Sin 1984, 3.3.1) on the regressor of the λ-method."""

    step: float = 1.0

    def take_in(self, state: EstimatorState, learning: Learning, load: Load) -> None:
        power = sum(r * r for r in state.sample.regressor)
        for i, r in enumerate(state.sample.regressor):
            state.estimate.theta[i] += self.step * r * state.estimate.innovation / power


def innovations(method: Method) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    bench = Bench(replace(EXACT, learning=replace(EXACT.learning, method=method)))
    bench.motor.disks = 2
    for second in range(480):
        bench.run(1.0, order(square_wave(second), Mode.FIXED))
    return np.array([decision.innovation for decision in bench.decisions])


def test_the_configuration_offers_every_method() -> None:
    assert get_args(Estimator.model_fields["method"].annotation) == tuple(METHODS)


@pytest.mark.skipif(
    build_name() == "compiled", reason="a class in Python cannot inherit from a compiled one"
)
def test_a_third_method_learns_in_the_same_controller() -> None:
    learnt, frozen = innovations(Projection()), innovations(Projection(step=0.0))
    last = slice(-120, None)
    assert np.sqrt(np.mean(learnt[last] ** 2)) < 0.2 * np.sqrt(np.mean(frozen[last] ** 2))
