"""Disturbances that a simulated device offers to its operators, by the kind of its plant."""

from __future__ import annotations

from collections.abc import Callable

from adaptdrive.operation.simulator import Feature
from adaptdrive_sim.plants.bath import Bath
from adaptdrive_sim.plants.battery import Battery
from adaptdrive_sim.plants.load import SimulatedLoad
from adaptdrive_sim.plants.motor import Motor

FILLING_S = 60.0
_SAG = Feature("sag the line by 20 % for 1 s", {"sag": 0.2, "duration_s": 1.0})


def features_of(load: SimulatedLoad) -> tuple[Feature, ...]:
    """Return the disturbances that a plant offers; each still may be refused.

    Args:
        load: The plant.
    """
    offered = (make(load) for kind, make in _OFFERS.items() if isinstance(load, kind))
    return (*next(offered, ()), _SAG)


def _of_motor(_: SimulatedLoad) -> tuple[Feature, ...]:
    return (
        Feature("add a disk", {"disks": 1}),
        Feature("remove a disk", {"disks": -1}),
        Feature("load the shaft with 0.5 Nm", {"torque_Nm": 0.5}),
        Feature("unload the shaft", {"torque_Nm": 0.0}),
    )


def _of_bath(load: SimulatedLoad) -> tuple[Feature, ...]:
    assert isinstance(load, Bath)  # noqa: S101 - chosen by its type
    first_gal = load.parameters.volume_gal
    return tuple(
        Feature(
            f"{verb} {volume_gal:g} US gal within {FILLING_S:g} s",
            {"volume_gal": volume_gal, "duration_s": FILLING_S},
        )
        for verb, volume_gal in (("pour water in to", 2.0 * first_gal), ("drain to", first_gal))
    )


def _of_battery(_: SimulatedLoad) -> tuple[Feature, ...]:
    return (
        Feature("raise the series resistance to 0.4 Ω", {"series_Ohm": 0.4}),
        Feature("set the charge to 80 %", {"charge": 0.8}),
    )


_OFFERS: dict[type, Callable[[SimulatedLoad], tuple[Feature, ...]]] = {
    Motor: _of_motor,
    Bath: _of_bath,
    Battery: _of_battery,
}
