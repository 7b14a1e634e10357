"""The simulated load for each kind that a configuration can name."""

from __future__ import annotations

from adaptdrive_sim.plants.bath import Bath, BathParameters
from adaptdrive_sim.plants.battery import Battery, BatteryParameters
from adaptdrive_sim.plants.load import SimulatedLoad
from adaptdrive_sim.plants.motor import Motor, MotorParameters


def new_load(kind: str, disks: int = 1) -> SimulatedLoad:
    """The reference load of a kind.

    Args:
        kind: `motor`, `bath` or `battery`, as in the configuration.
        disks: Disks on the shaft of a motor.
    """
    if kind == "bath":
        return Bath(BathParameters())
    if kind == "battery":
        return Battery(BatteryParameters())
    return Motor(MotorParameters(), disks)
