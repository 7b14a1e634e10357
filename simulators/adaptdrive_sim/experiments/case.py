"""One run of an experiment: which controller, which design, which noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from adaptdrive.control.settings import ControllerSettings
from adaptdrive.control.signals import Mode
from adaptdrive.errors import RefusedError
from adaptdrive_sim.experiments.experiment import Experiment
from adaptdrive_sim.noise import NoiseParameters
from adaptdrive_sim.parameters import check_range

Design = Literal["paper", "exact"]
Variant = Literal["fixed", "adaptive", "direct_rls", "lm_rls"]


@dataclass(frozen=True, slots=True)
class Disturbance:
    """Measurement noise of every fast sample; deviations are fractions of the reference step.

    Attributes:
        noise: Standard deviation of every sample.
        spike_share: Share of samples that carry a spike.
        spike_noise: Standard deviation of the spikes.
    """

    noise: float
    spike_share: float = 0.0
    spike_noise: float = 0.0

    def __post_init__(self) -> None:
        check_range("noise", self.noise, 0.0, 10.0, "of the step")
        check_range("share of spikes", self.spike_share, 0.0, 1.0, "")
        check_range("noise of spikes", self.spike_noise, 0.0, 10.0, "of the step")

    def scaled(self, step: float) -> NoiseParameters:
        """The same in the unit of the output."""
        return NoiseParameters(self.noise * step, self.spike_share, self.spike_noise * step)


def disturbance_of(noise: float, spikes: str) -> Disturbance:
    """Return the disturbance that a command line requests.

    Args:
        noise: Standard deviation of every sample, as a fraction of the step.
        spikes: RATE,SIGMA.

    Raises:
        RefusedError: The spikes cannot be read.
        ParameterError: A value lies outside its range.
    """
    try:
        share, sigma = (float(part) for part in spikes.split(","))
    except ValueError as problem:
        raise RefusedError(f"spikes {spikes!r} is not RATE,SIGMA") from problem
    return Disturbance(noise, share, sigma)


@dataclass(frozen=True, slots=True)
class Case:
    """Everything that one run depends on.

    Attributes:
        experiment: What is done.
        variant: Which controller runs; `direct_rls` and `lm_rls` are adaptive ones with the
            estimator named, whatever the design's own is.
        settings: Settings of the controller.
        disturbance: Measurement noise.
        seed: Of the noise; runs with the same seed see the same noise.
    """

    experiment: Experiment
    variant: Variant
    settings: ControllerSettings
    disturbance: Disturbance
    seed: int

    @property
    def mode(self) -> Mode:
        """Controller that the operator selects."""
        return Mode.FIXED if self.variant == "fixed" else Mode.ADAPTIVE
