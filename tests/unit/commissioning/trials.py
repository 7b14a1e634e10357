"""Many experiments on random loads, and their judgement against the true parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptdrive.app.loads import build_load
from adaptdrive.commissioning.evaluation import evaluate
from adaptdrive.commissioning.experiment import load_experiment
from adaptdrive.util.errors import AdaptdriveError
from tests.unit.commissioning.draws import KINDS, Draw, Rig, finish
from tests.unit.commissioning.loops import Loop, loop_around

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
        fall: Largest fall of the true output below rest, over the movement asked for.
        peak: Largest rise, likewise.
        duration_s: Length of the experiment.
        loop: The proposed loop around the true load; None without one.
    """

    refusal: str
    errors: dict[str, float]
    sigmas: dict[str, float]
    fall: float
    peak: float
    duration_s: float
    loop: Loop | None

    @property
    def right(self) -> bool:
        """True if each parameter is close, or within its stated deviation."""
        return not self.refusal and all(
            abs(error) <= CLOSE or abs(self.sigmas[name]) <= SIGMAS
            for name, error in self.errors.items()
        )


def trial(kind: str, seed: int) -> Trial:
    random = np.random.default_rng([seed, 15])
    return trial_of(KINDS[kind](random), random)


def trial_of(draw: Draw, random: np.random.Generator) -> Trial:
    truth = draw.truth
    found, rig = load_experiment(draw.target), Rig(draw, random)
    refusal, errors, sigmas, loop = "", {}, {}, None
    try:
        finish(found, rig)
        assert found.outcome is not None
        loads = [build_load(draw.configuration)]
        identified = evaluate(found.record, found.outcome, loads)
        parameters = identified.parameters
        errors = {name: one.value / truth[name] - 1.0 for name, one in parameters.items()}
        sigmas = {name: (one.value - truth[name]) / one.std for name, one in parameters.items()}
        loop = loop_around(draw, identified)
    except AdaptdriveError as problem:
        refusal = str(problem)
    return Trial(refusal, errors, sigmas, *rig.movement, rig.time_s, loop)
