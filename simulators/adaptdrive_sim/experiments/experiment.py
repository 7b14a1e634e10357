"""An experiment as data, and the paper's experiments.

A bath fills from 0.6 to 1.5 US gal (Fig. 4); a second and a third disk drop onto the shaft of a
motor (Fig. 9).
"""

import math
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, Literal, get_type_hints

import msgspec
import numpy as np

from adaptdrive.control.loads import motor
from adaptdrive.control.loads.bath import bath_load
from adaptdrive.control.loads.load import Load
from adaptdrive.control.signals import Waveform
from adaptdrive_sim.course import Array, moving
from adaptdrive_sim.parameters import example_tables
from adaptdrive_sim.plants import boost
from adaptdrive_sim.plants.bath import Bath, BathParameters
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from adaptdrive_sim.world import SimulatedLoad

# An experiment as data: a load that changes, a reference, and the paper's settings for it.


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
        warm_up_s: Time under the fixed controller before the adaptive one takes over.
    """

    method: Literal["lm-rls", "rls"]
    forgetting: float
    tau_lambda_s: float
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
class Experiment:
    """One experiment, in either design; its file has all that comes before the name.

    Attributes:
        duration_s: Length.
        reference: Square wave, high half first.
        period_s: Slow period T_k.
        pole: Closed-loop pole, per slow period.
        changes: What happens to the load, in order.
        noise: Standard deviation of each fast sample by default, as a fraction of the step.
        paper: The paper's settings.
        sweep: Further settings of the estimator to compare with them.
        name: Its name on the command line.
        tables: Configuration of the daemon for the exact design, as TOML would give it.
        nominal: The load that the fixed controller is designed for.
        plant: Makes the simulated load at its nominal size.
        true_load: The load's model at a size, by formula.
        dropped: Whether what is added to the load is at rest, so that its speed drops.
    """

    duration_s: float
    reference: Waveform
    period_s: float
    pole: float
    changes: tuple[LoadChange, ...]
    noise: float
    paper: PaperSettings
    sweep: SweepSettings
    name: str
    tables: Callable[[], dict[str, Any]] = field(repr=False)
    nominal: Callable[[], Load] = field(repr=False)
    plant: Callable[[], SimulatedLoad] = field(repr=False)
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
    types = get_type_hints(Experiment)
    for key, value in tomllib.loads(text).items():
        parts[key] = msgspec.convert(value, types[key])
    return Experiment(name=name, **parts)


# The paper's experiments.

NOMINAL_gal = 0.6


@cache
def true_bath(size: float) -> Load:
    """The bath's model at a multiple of its nominal volume."""
    stage, bath = boost.CouplingParameters(), Bath(BathParameters(volume_gal=size * NOMINAL_gal))
    model, ratio = bath.model(stage.ratio, stage.droop_Ohm), stage.ratio
    heat_K_per_W, heater_Ohm = model["resistance_K_per_W"], bath.resistance_Ohm
    return bath_load(heat_K_per_W, model["tau_s"], ratio, stage.droop_Ohm, heater_Ohm)


def _bath_tables() -> dict[str, Any]:
    """The example configuration of the daemon, with a bath in place of the motor."""
    found = example_tables("motor.toml")
    model = Bath(BathParameters(volume_gal=NOMINAL_gal)).model(0.25, 1.0)
    found["load"] = {
        "type": "bath",
        "output_name": "temperature",
        "output_unit": "K",
        "period_s": 20.0,
        "pole": 0.80,
        "reference_max": 20.0,
        "model": {name: model[name] for name in ("resistance_K_per_W", "tau_s")}
        | {"turns_ratio": 0.25, "droop_Ohm": 1.0, "heater_Ohm": 7.87},
    }
    found["estimator"] = {"method": "lm-rls", "forgetting": 0.99, "tau_lambda_s": 100.0}
    found["interlocks"]["output_max"] = 25.0
    return found


BATH = read_experiment(
    "bath",
    tables=_bath_tables,
    nominal=partial(true_bath, 1.0),
    plant=partial(Bath, BathParameters(volume_gal=NOMINAL_gal)),
    true_load=true_bath,
)


@cache
def true_motor(size: float) -> Load:
    """The motor's model with that many disks."""
    stage = boost.CouplingParameters()
    model = Motor(MotorParameters(), round(size)).model(stage.ratio, stage.droop_Ohm)
    return motor.motor_load(model["gain"], model["tau_motor_s"], model["tau_filter_s"])


MOTOR = read_experiment(
    "motor",
    tables=partial(example_tables, "motor.toml"),
    nominal=partial(motor.motor_load, gain=0.011, tau_motor_s=11.7, tau_filter_s=10.0),
    plant=partial(Motor, MotorParameters()),
    true_load=true_motor,
)
"""The experiment with a speed that stays: the change of the load is the only disturbance."""

DROPPED = replace(MOTOR, plant=partial(Motor, MotorParameters(dropped_at_rest=True)), dropped=True)
"""The published experiment: weights dropped onto the turning shaft share its momentum."""
