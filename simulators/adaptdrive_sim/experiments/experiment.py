"""An experiment as data: a load that changes, a reference, and the paper's settings for it."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from adaptdrive.control.loads.load import Load
from adaptdrive.control.signals import Waveform
from adaptdrive_sim.course import Array, moving


@dataclass(frozen=True, slots=True)
class LoadChange:
    """The load becomes larger.

    Attributes:
        time_s: When it starts.
        size: Multiple of the nominal inertia or volume in the end.
        over_s: How long it takes; 0 for at once.
    """

    time_s: float
    size: float
    over_s: float = 0.0


@dataclass(frozen=True, slots=True)
class PaperSettings:
    """The paper's choices for one load.

    Attributes:
        method: What is learnt, and from which signals.
        forgetting: ρ.
        tau_lambda_s: τ_λ.
        covariance: p0.
        warm_up_s: Time under the fixed controller before the adaptive one takes over.
    """

    method: Literal["lm-rls", "rls"]
    forgetting: float
    tau_lambda_s: float
    covariance: float
    warm_up_s: float


@dataclass(frozen=True, slots=True)
class SweepSettings:
    """Settings of the estimator to compare with the paper's.

    Attributes:
        forgetting: Values of ρ.
        tau_lambda_s: Values of τ_λ.
        methods: Estimators to compare over ρ.
    """

    forgetting: tuple[float, ...]
    tau_lambda_s: tuple[float, ...]
    methods: tuple[Literal["lm-rls", "rls"], ...]


@dataclass(frozen=True, slots=True)
class ExperimentFile:
    """The file of an experiment.

    Attributes:
        duration_s: Length.
        reference: Square wave, high half first.
        period_s: Slow period T_k.
        pole: Closed-loop pole, per slow period.
        changes: What happens to the load, in order.
        noise: Standard deviation of each fast sample by default, as a fraction of the step.
        paper: The paper's settings.
        sweep: Further settings of the estimator to compare with them.
    """

    duration_s: float
    reference: Waveform
    period_s: float
    pole: float
    changes: tuple[LoadChange, ...]
    noise: float
    paper: PaperSettings
    sweep: SweepSettings


@dataclass(frozen=True, slots=True)
class Experiment(ExperimentFile):
    """One experiment, in either design.

    Attributes:
        name: Its name on the command line.
        tables: Configuration of the daemon for the exact design, as TOML would give it.
        nominal: The load that the fixed controller is designed for.
        plant: Makes the simulated load at its nominal size.
        true_load: The load's model at a size, by formula.
        dropped: Whether what is added to the load is at rest, so that its speed drops.
    """

    name: str
    tables: Callable[[], dict[str, Any]] = field(repr=False)
    nominal: Callable[[], Load] = field(repr=False)
    plant: Callable[[], Any] = field(repr=False)
    true_load: Callable[[float], Load] = field(repr=False)
    dropped: bool = False

    @property
    def step(self) -> float:
        """Height of the reference step."""
        return self.reference.high - self.reference.low

    def times_s(self) -> list[float]:
        """Return the slow instants."""
        return [k * self.period_s for k in range(round(self.duration_s / self.period_s))]

    def sizes_at(self, times_s: Sequence[float], *, wanted: bool = False) -> Array:
        """Size of the load at each time, or the present or next one that is wanted."""
        starts_s = [one.time_s for one in self.changes]
        over_s = 0.0 if wanted else [one.over_s for one in self.changes]
        levels = [1.0, *(one.size for one in self.changes)]
        return moving(np.array(times_s), starts_s, levels, over_s)

    def size_at(self, time_s: float) -> float:
        """Size of the load at a time."""
        return float(self.sizes_at([time_s])[0])

    def truth_at(self, time_s: float) -> list[float]:
        """Physical parameters of the load at a time, in the order of its names."""
        load = self.true_load(self.size_at(time_s))
        return load.physical(list(load.numerator), list(load.denominator))

    def cycle_starts(self) -> list[float]:
        """Starts of the reference cycles, the last one perhaps cut short."""
        count = math.ceil(self.duration_s / self.reference.period_s - 1e-9)
        return [i * self.reference.period_s for i in range(count)]

    @property
    def ends_s(self) -> list[float]:
        """Ends of the parts with one load: the changes of it, and the end of the experiment."""
        return [*(one.time_s for one in self.changes), self.duration_s]


def read_experiment(name: str, **parts: Any) -> Experiment:  # noqa: ANN401 - functions
    """Read the file of an experiment.

    Args:
        name: Its name.
        parts: The functions that make its loads and its configuration.
    """
    text = Path(__file__).with_name(f"{name}.toml").read_text(encoding="utf-8")
    data = msgspec.convert(tomllib.loads(text), ExperimentFile)
    parts |= {one.name: getattr(data, one.name) for one in fields(data)}
    return Experiment(name=name, **parts)
