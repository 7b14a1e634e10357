"""Phases and outcome of an experiment."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeVar

Result = TypeVar("Result")
Steps = Generator[bool, None, Result]
"""A phase: it advances with each sample, and ends with a result."""


class Phase(StrEnum):
    """Part of an experiment."""

    REST = "waiting for rest at the lowest voltage"
    ONSET = "raising the voltage until a current flows"
    CLIMB = "looking for the step that moves the output visibly"
    RETREAT = "taking the voltage back: the output would move too far"
    TEST = "switching the voltage"
    DONE = "done"


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of an experiment.

    Attributes:
        low_V: V_c at rest.
        high_V: V_c of the sequence's other level.
        rest: Output at rest.
        moved: Change of the output by the last step of the climb.
        gain: That change over the change of the load's input.
        settling_s: Time that the load took to come to rest.
        noise: Standard deviation of the noise of one sample.
        began_s: Time from which the samples count.
    """

    low_V: float
    high_V: float
    rest: float
    moved: float
    gain: float
    settling_s: float
    noise: float
    began_s: float
