"""A plant that answers at its own step, between the readings of a drive."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from adaptdrive.errors import IdentificationError

if TYPE_CHECKING:
    from adaptdrive.analysis.closed_loop import Plant


class OwnStep:
    """Steps a plant at its own rate; between two of its steps its output is held.

    A plant states the rate in an attribute `step_s`, the seconds of one step.
    """

    def __init__(self, plant: Plant, step_s: float) -> None:
        """Take a plant.

        Args:
            plant: The plant.
            step_s: Length of each of its steps.

        Raises:
            IdentificationError: That is no length of time.
        """
        if not 0.0 < step_s < math.inf:
            raise IdentificationError(f"step_s of the plant is {step_s}, and must be above 0 s")
        self._plant, self._step_s = plant, step_s
        self._elapsed_s = self._fed_Vs = self._due_s = 0.0
        self._answer: tuple[float, float] | None = None

    def step(self, boost_voltage_V: float, duration_s: float) -> tuple[float, float]:
        """Advance by as many steps as end until then, under the mean voltage since the last one.

        Args:
            boost_voltage_V: Mean boost voltage over the time.
            duration_s: The time.

        Returns:
            The output at the end of the last step, and the mean power since the one before, in W.
        """
        self._elapsed_s += duration_s
        self._fed_Vs += boost_voltage_V * duration_s
        self._due_s += duration_s
        count = math.floor(self._due_s / self._step_s + 1e-9)
        if self._answer is not None and count <= 0:
            return self._answer
        count = max(1, count)  # a slow plant too has an output from the start on
        mean_V = self._fed_Vs / self._elapsed_s
        answers = [self._plant.step(mean_V, self._step_s) for _ in range(count)]
        self._elapsed_s = self._fed_Vs = 0.0
        self._due_s -= count * self._step_s
        self._answer = answers[-1][0], sum(power_W for _, power_W in answers) / count
        return self._answer


def at_own_step(plant: Plant) -> Plant:
    """Return a plant that takes any step: itself where it has no `step_s`."""
    step_s = getattr(plant, "step_s", None)
    return plant if step_s is None else OwnStep(plant, float(step_s))
