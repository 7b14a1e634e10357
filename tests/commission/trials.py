"""Many experiments on random loads, and their judgement against the true parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptdrive.app.loads import build_load
from adaptdrive.commission.evaluate import evaluate
from adaptdrive.errors import AdaptdriveError
from tests.commission.draws import KINDS, experiment

CLOSE = 0.05
SIGMAS = 3.0
BAND = (-0.5, 1.5)
"""Movement from rest, as a share of the movement asked for, that the documentation states."""


@dataclass(frozen=True, slots=True)
class Trial:
    """An experiment on one random load.

    Attributes:
        refusal: Why it ended early; empty where it did not.
        errors: Relative error of each parameter.
        sigmas: The same in its own standard deviations.
        peak: Largest movement of the true output from rest, over the movement asked for.
        duration_s: Length of the experiment.
    """

    refusal: str
    errors: dict[str, float]
    sigmas: dict[str, float]
    peak: float
    duration_s: float

    @property
    def right(self) -> bool:
        """True if each parameter is close, or within its stated deviation."""
        return not self.refusal and all(
            abs(error) <= CLOSE or abs(self.sigmas[name]) <= SIGMAS
            for name, error in self.errors.items()
        )


def trial(kind: str, seed: int) -> Trial:
    random = np.random.default_rng([seed, 15])
    draw = KINDS[kind](random)
    truth = draw.truth
    try:
        found, rig = experiment(draw, random)
        parameters = evaluate(found, build_load(draw.configuration)).parameters
    except AdaptdriveError as problem:
        return Trial(str(problem), {}, {}, 0.0, 0.0)
    assert found.outcome is not None
    return Trial(
        refusal="",
        errors={name: one.value / truth[name] - 1.0 for name, one in parameters.items()},
        sigmas={name: (one.value - truth[name]) / one.std for name, one in parameters.items()},
        peak=(rig.highest - found.outcome.rest) / draw.target.move,
        duration_s=rig.time_s,
    )
