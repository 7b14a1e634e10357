"""A dc motor with friction on its shaft, and a filtered tachometer; for these tests alone."""

from __future__ import annotations

import math
from dataclasses import dataclass

TURNS = 0.25
"""Armature voltage per volt of the boost capacitor."""

RESISTANCE_Ohm = 6.75
CONSTANT_Vs = 0.3
VISCOUS_Nms = 0.006
COULOMB_Nm = 0.24
INERTIA_kgm2 = 0.226
TACHOMETER_Vs = 0.020533
FILTER_s = 10.0
STEPS = 8


@dataclass
class Motor:
    """Speed and filtered tachometer; integrated by Euler's method in small steps."""

    speed: float = 0.0
    tachometer_V: float = 0.0
    current_A: float = 0.0
    inertia_kgm2: float = INERTIA_kgm2
    filter_s: float = FILTER_s

    @classmethod
    def at(cls, tachometer_V: float) -> Motor:
        """Return a motor that has turned steadily for long.

        Args:
            tachometer_V: What its tachometer reads.
        """
        return cls(tachometer_V / TACHOMETER_Vs, tachometer_V)

    def turn(self, boost_V: float, seconds: float) -> float:
        """Turn for a while, at 0 V without current; return the mean power drawn in W."""
        step_s, energy_J = seconds / STEPS, 0.0
        for _ in range(STEPS):
            armature_V = TURNS * boost_V
            emf_V = CONSTANT_Vs * self.speed
            self.current_A = max(0.0, (armature_V - emf_V) / RESISTANCE_Ohm)  # a diode blocks
            friction_Nm = VISCOUS_Nms * self.speed + COULOMB_Nm * math.tanh(self.speed)
            torque_Nm = CONSTANT_Vs * self.current_A - friction_Nm
            self.speed = max(0.0, self.speed + step_s * torque_Nm / self.inertia_kgm2)
            error_V = TACHOMETER_Vs * self.speed - self.tachometer_V
            self.tachometer_V += step_s * error_V / self.filter_s
            energy_J += armature_V * self.current_A * step_s
        return energy_J / seconds
