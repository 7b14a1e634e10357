"""State of the output's sensor while the drive is off."""

from __future__ import annotations

from dataclasses import dataclass

from adaptdrive.commission.samples import Samples
from adaptdrive.config.root import Configuration
from adaptdrive.util.errors import CommissionError

_NOISE_SHARE = 1.0
"""Noise of one sample over the movement, above which the movement is hidden."""


@dataclass(frozen=True, slots=True)
class SensorState:
    """A sensor at rest.

    Attributes:
        mean: Mean output.
        noise: Standard deviation of one sample.
        resolution: Smallest difference of two samples; 0 where all were the same.
        count: Samples.
    """

    mean: float
    noise: float
    resolution: float
    count: int


def judge_sensor(samples: Samples, configuration: Configuration, move: float) -> SensorState:
    """Return the state of the sensor.

    Args:
        samples: Samples while the drive was off.
        configuration: Limits of the output.
        move: Movement that the experiment aims at.

    Raises:
        CommissionError: The experiment would not see the load.
    """
    first, last = samples.times_s[0] - 1.0, samples.times_s[-1]
    state = SensorState(
        mean=samples.mean(first, last),
        noise=samples.noise(first, last),
        resolution=samples.resolution(),
        count=len(samples.outputs),
    )
    section = configuration.load
    about = f"{section.output_name} = {state.mean:.4g} {section.output_unit}"
    if state.mean > section.reference_max:
        raise CommissionError(
            f"{about} while the drive is off is above load.reference_max = "
            f"{section.reference_max:g} {section.output_unit}: compare its scale and offset"
        )
    if max(state.noise, state.resolution) > _NOISE_SHARE * move:
        raise CommissionError(
            f"noise {state.noise:.3g} and resolution {state.resolution:.3g} of the sensor hide a "
            f"movement of {move:.3g} {section.output_unit}: ask for a larger one with --move"
        )
    return state
