"""A permanent-magnet motor that turns a stack of disks, and its filtered tachometer.

With the shaft speed ω, the source V behind R_d and the load torque T:

    J·dω/dt = K·i − f·ω − T − T_c − d·ω²,   i = (V − K·ω)/(R_d + R_f)
    τ_f·dy/dt = c·ω − y

Both are linear but for the drag d, so that one step is exact for a source that stays constant over
it; the drag is that of the speed at its start. Torque and dry friction T_c are brakes: they oppose
forward rotation and can stop the shaft but not turn it back.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from adaptdrive_sim.parameters import check_quantities, check_range, quantity

DISKS_MAX = 10


@dataclass(frozen=True, slots=True)
class MotorParameters:
    """Motor, disks and tachometer.

    Attributes:
        dropped_at_rest: A disk added to the turning shaft is at rest when it lands, so that the
            speed drops as angular momentum is shared: the published experiment. Otherwise the
            inertia alone changes and the speed stays. A disk taken away never changes the speed.
    """

    resistance_Ohm: float = quantity(3.0, "Ω", "armature resistance, R_f", 0.01, 1e3)
    constant_Vs: float = quantity(0.30, "V s/rad", "back-EMF and torque constant, K", 1e-3, 1e2)
    friction_Nms: float = quantity(0.0125, "N m s/rad", "viscous friction, f", 0.0, 10.0)
    disk_kgm2: float = quantity(
        0.4095, "kg m²", "inertia of one disk (the first includes the shaft), J", 1e-4, 1e3
    )
    tachometer_Vs: float = quantity(0.020533, "V s/rad", "tachometer constant, c", 1e-5, 10.0)
    filter_s: float = quantity(10.0, "s", "time constant of the tachometer filter, τ_f", 1e-2, 1e3)
    dropped_at_rest: bool = False
    coulomb_Nm: float = quantity(0.0, "N m", "dry friction, T_c", 0.0, 100.0)
    drag_Nms2: float = quantity(0.0, "N m s²/rad²", "quadratic drag, d", 0.0, 1.0)

    def __post_init__(self) -> None:
        check_quantities(self)


class Motor:
    """Shaft, disks and tachometer filter.

    Attributes:
        speed_rad_s: Shaft speed.
        inertia_kgm2: Inertia of the shaft with its disks, J.
        output: Filtered tachometer voltage.
        torque_Nm: Load torque without friction.
    """

    def __init__(self, parameters: MotorParameters, disks: int = 1) -> None:
        self.parameters = parameters
        self.resistance_Ohm = parameters.resistance_Ohm
        self.speed_rad_s = 0.0
        self.output = 0.0
        self.torque_Nm = 0.0
        self._disks = 1
        self.inertia_kgm2 = parameters.disk_kgm2
        self._driven = _Step()
        self._coasting = _Step()
        self.disks = disks

    @property
    def emf_V(self) -> float:
        """Back-EMF, K·ω."""
        return self.parameters.constant_Vs * self.speed_rad_s

    @property
    def disks(self) -> int:
        """Disks on the shaft."""
        return self._disks

    @disks.setter
    def disks(self, disks: int) -> None:
        check_range("disks", disks, 1, DISKS_MAX, "")
        self._disks = disks
        self.resize(float(disks), 0.0)

    def set_inertia(self, inertia_kgm2: float) -> None:
        """Turn any inertia in place of the disks; the speed stays."""
        self.inertia_kgm2 = inertia_kgm2
        self._driven.duration_s = self._coasting.duration_s = math.nan

    def resize(self, size: float, _over_s: float) -> None:
        """Turn a multiple of one disk's inertia from now on.

        What is added at rest shares the angular momentum of the shaft.
        """
        inertia_kgm2 = self.parameters.disk_kgm2 * size
        if self.parameters.dropped_at_rest and inertia_kgm2 > self.inertia_kgm2:
            self.speed_rad_s *= self.inertia_kgm2 / inertia_kgm2
        self.set_inertia(inertia_kgm2)

    def disturb(self, torque_Nm: float) -> None:
        """Load the shaft with a torque from now on."""
        self.torque_Nm = torque_Nm

    def drive(self, source_V: float, source_Ohm: float, duration_s: float) -> float:
        """Advance while a constant voltage behind a resistance feeds the armature."""
        step = self._driven
        if step.duration_s != duration_s or step.source_Ohm != source_Ohm:
            self._tune(step, self._damping(source_Ohm), source_Ohm, duration_s)
        constant = self.parameters.constant_Vs
        per_Ohm = 1.0 / (source_Ohm + self.resistance_Ohm)
        torque_Nm = constant * per_Ohm * source_V - self._brake_Nm(self.speed_rad_s)
        return (source_V - constant * self._advance(step, torque_Nm)) * per_Ohm

    def coast(self, duration_s: float) -> None:
        """Advance with the armature open: friction and load torque alone act."""
        step = self._coasting
        if step.duration_s != duration_s:
            self._tune(step, self.parameters.friction_Nms, math.inf, duration_s)
        self._advance(step, -self._brake_Nm(self.speed_rad_s))

    def settle(self, source_V: float, source_Ohm: float) -> None:
        """Put shaft and filter at rest under a constant source."""
        per_Ohm = 1.0 / (source_Ohm + self.resistance_Ohm)
        torque_Nm = self.parameters.constant_Vs * per_Ohm * source_V - self._brake_Nm(0.0)
        self.speed_rad_s = self._resting_speed(max(0.0, torque_Nm), self._damping(source_Ohm))
        self.output = self.parameters.tachometer_Vs * self.speed_rad_s

    def source_for(self, output: float, source_Ohm: float) -> float:
        """Find the source voltage that holds a tachometer voltage."""
        speed_rad_s = output / self.parameters.tachometer_Vs
        torque_Nm = self._damping(source_Ohm) * speed_rad_s + self._brake_Nm(speed_rad_s)
        return torque_Nm * (source_Ohm + self.resistance_Ohm) / self.parameters.constant_Vs

    def model(self, ratio: float, source_Ohm: float) -> dict[str, float]:
        """Gain and time constants from boost voltage to filtered tachometer voltage.

        They are those of small movements about the present speed.
        """
        own = self.parameters
        damping = self._damping(source_Ohm) + 2.0 * own.drag_Nms2 * self.speed_rad_s
        per_Ohm = 1.0 / (source_Ohm + self.resistance_Ohm)
        tau_motor_s = self.inertia_kgm2 / damping
        return {
            "gain": own.tachometer_Vs * ratio * own.constant_Vs * per_Ohm / damping,
            "tau_motor_s": tau_motor_s,
            "tau_filter_s": own.filter_s,
            "tau_sum_s": tau_motor_s + own.filter_s,
            "tau_product_s2": tau_motor_s * own.filter_s,
        }

    def state(self) -> dict[str, float]:
        """Disks, speed and load torque."""
        return {"disks": self._disks, "speed_rad_s": self.speed_rad_s, "torque_Nm": self.torque_Nm}

    def _brake_Nm(self, speed_rad_s: float) -> float:
        """Return the torque against the rotation besides viscous friction: T + T_c + d·ω²."""
        own = self.parameters
        return self.torque_Nm + (own.coulomb_Nm + own.drag_Nms2 * speed_rad_s * speed_rad_s)

    def _resting_speed(self, torque_Nm: float, damping: float) -> float:
        """Return the speed at which damping and drag take a torque."""
        drag = self.parameters.drag_Nms2
        if drag == 0.0:
            return torque_Nm / damping
        return 2.0 * torque_Nm / (damping + math.sqrt(damping * damping + 4.0 * drag * torque_Nm))

    def _damping(self, source_Ohm: float) -> float:
        """Torque per speed, electrical part included: f + K²/(R_d + R_f)."""
        constant, total_Ohm = self.parameters.constant_Vs, source_Ohm + self.resistance_Ohm
        return self.parameters.friction_Nms + constant * constant / total_Ohm

    def _tune(self, step: _Step, damping: float, source_Ohm: float, duration_s: float) -> None:
        """Work out the step of a shaft that is damped."""
        filter_s, angle = self.parameters.filter_s, damping / self.inertia_kgm2 * duration_s
        half_gap = 0.5 * (duration_s / filter_s - angle)
        middle = math.exp(-0.5 * (duration_s / filter_s + angle))
        step.duration_s, step.source_Ohm = duration_s, source_Ohm
        step.compliance = 1.0 / damping if damping > 0.0 else 0.0
        step.decay = math.exp(-angle)
        step.mean = -math.expm1(-angle) / angle if angle else 1.0
        step.filter_decay = math.exp(-duration_s / filter_s)
        step.filter_share = duration_s / filter_s * middle * _sinhc(half_gap)

    def _advance(self, step: _Step, torque_Nm: float) -> float:
        """Advance under a constant torque; the mean speed over the step is returned."""
        speed = self.speed_rad_s
        if step.compliance > 0.0:
            rest = torque_Nm * step.compliance
            excess = speed - rest
            mean = rest + excess * step.mean
            last = rest + excess * step.decay
        else:
            gained = torque_Nm / self.inertia_kgm2 * step.duration_s
            rest, excess = speed + 0.5 * gained, 0.0
            mean, last = rest, speed + gained
        if last < 0.0:
            last = rest = excess = mean = 0.0
        target = self.parameters.tachometer_Vs * rest
        self.output = (
            target
            + (self.output - target) * step.filter_decay
            + self.parameters.tachometer_Vs * excess * step.filter_share
        )
        self.speed_rad_s = last
        return mean


@dataclass(slots=True)
class _Step:
    """Effect of one step of given length on shaft and filter.

    Attributes:
        duration_s: Length of the step; NaN before it is known.
        source_Ohm: Source resistance it was made for.
        compliance: Speed per torque at rest; 0 without damping.
        decay: What is left of a speed excess at the end.
        mean: Mean of that excess over the step.
        filter_decay: What is left of an output excess at the end.
        filter_share: What a speed excess at the start adds to the output at the end.
    """

    duration_s: float = math.nan
    source_Ohm: float = math.nan
    compliance: float = 0.0
    decay: float = 0.0
    mean: float = 0.0
    filter_decay: float = 0.0
    filter_share: float = 0.0


def _sinhc(z: float) -> float:
    """sinh(z)/z, also at 0, where shaft and filter have the same time constant."""
    return math.sinh(z) / z if abs(z) > 1e-4 else 1.0 + z * z / 6.0
