"""Draw the life of a motor in one run of a campaign.

All of it comes from a separate stream of random numbers, so that a campaign without it draws what
it always drew.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptdrive_sim.campaign.drawn import Numbers, times, uniform, whole
from adaptdrive_sim.campaign.settings import LifeRanges
from adaptdrive_sim.course import Array, moving
from adaptdrive_sim.plants.coupling import CouplingParameters
from adaptdrive_sim.plants.motor import MotorParameters

_STREAM = 3


@dataclass(frozen=True, slots=True)
class Life:
    """Drawn values; torques and friction are in volts of V_c that the motor needs for them.

    Attributes:
        torque_times_s: When the load torque begins to move.
        torques_V: Where it moves to.
        torque_ramps_s: How long each movement takes.
        inertia_ramps_s: How long each change of the inertia takes.
        idle_times_s: When the reference stops where it is.
        idle_s: How long each time.
        stop_times_s: When the drive is disabled.
        off_s: For how long.
        coulomb_V: Dry friction.
        drag_V: Drag in the middle of the range.
        offset: What the tachometer shows at a standstill.
    """

    torque_times_s: Numbers = ()
    torques_V: Numbers = ()
    torque_ramps_s: Numbers = ()
    inertia_ramps_s: Numbers = ()
    idle_times_s: Numbers = ()
    idle_s: Numbers = ()
    stop_times_s: Numbers = ()
    off_s: Numbers = ()
    coulomb_V: float = 0.0
    drag_V: float = 0.0
    offset: float = 0.0

    @property
    def largest_torque_V(self) -> float:
        """Largest load torque of the run."""
        return max(self.torques_V, default=0.0)

    def torques_at(self, times_s: Array) -> Array:
        """Load torque in N m at each time; empty where there is none in the whole run."""
        if not self.torques_V:
            return np.empty(0)
        levels_V = (0.0, *self.torques_V)
        return volt_Nm() * moving(times_s, self.torque_times_s, levels_V, self.torque_ramps_s)

    def stops(self, period_s: float) -> tuple[range, ...]:
        """Return the slow periods in which the drive is off."""
        starts = [round(time_s / period_s) for time_s in self.stop_times_s]
        lengths = [max(2, round(length_s / period_s)) for length_s in self.off_s]
        return tuple(range(k, k + n) for k, n in zip(starts, lengths, strict=True))

    def held_at(self, times_s: Array) -> Array:
        """Return the times at which the reference is read: they stand still in idle phases."""
        found = times_s.copy()
        for start_s, length_s in zip(self.idle_times_s, self.idle_s, strict=True):
            found[(times_s >= start_s) & (times_s < start_s + length_s)] = start_s
        return found


def volt_Nm() -> float:
    """Torque at the shaft that takes a volt of V_c."""
    stage, motor = CouplingParameters(), MotorParameters()
    return stage.ratio * motor.constant_Vs / (stage.droop_Ohm + motor.resistance_Ohm)


def draw_life(ranges: LifeRanges, seed: int, duration_s: float, changes: int) -> Life:
    """Draw what happens in the run of a seed.

    Args:
        ranges: What to draw from.
        seed: Of the run.
        duration_s: Its length.
        changes: How often its inertia changes.
    """
    generator = np.random.default_rng([seed, _STREAM])
    torques, phases = whole(generator, ranges.torque_changes), whole(generator, ranges.idle)
    restarts = int(generator.random() < ranges.restarted)
    constant = generator.random() < ranges.constant
    return Life(
        torque_times_s=times(generator, torques, 0.0, duration_s),
        torques_V=_several(generator, torques, ranges.torque_V),
        torque_ramps_s=_ramps_s(generator, torques, ranges.torque_ramp_s, ranges.sudden),
        inertia_ramps_s=_ramps_s(generator, changes, ranges.inertia_ramp_s, ranges.sudden),
        idle_times_s=(0.0,) if constant else times(generator, phases, 0.0, duration_s),
        idle_s=(np.inf,) if constant else _several(generator, phases, ranges.idle_s),
        stop_times_s=_several(generator, restarts, (0.2 * duration_s, 0.8 * duration_s)),
        off_s=_several(generator, restarts, ranges.off_s),
        coulomb_V=uniform(generator, ranges.coulomb_V),
        drag_V=uniform(generator, ranges.drag_V),
        offset=uniform(generator, ranges.offset),
    )


def _ramps_s(
    generator: np.random.Generator, count: int, ends: tuple[float, float], sudden: float
) -> Numbers:
    ramps_s, jumps = generator.uniform(*ends, count), generator.random(count) < sudden
    return tuple(np.where(jumps, 0.0, ramps_s).tolist())


def _several(generator: np.random.Generator, count: int, ends: tuple[float, float]) -> Numbers:
    return tuple(generator.uniform(*ends, count).tolist())
