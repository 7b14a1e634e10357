"""Disturbances of a running plant, and their requests.

A request is a JSON object with an `id` and exactly one disturbance:

    {"id": "1", "disks": 1}                     one disk more (-1: one less)
    {"id": "2", "torque_Nm": 0.5}               load torque from now on
    {"id": "3", "sag": 0.2, "duration_s": 1.0}  take 20 % off the line for a second
    {"id": "4", "noise_V": 0.0004}              noise of the output from now on
    {"id": "5", "fault": 1}                     fault word of the drive (0: clear)
    {"id": "6", "sensor_fault": 1}              sensors beside the drive: 1 broken wire, 2 values
                                                that stand still, 3 unplugged (0: none)
    {"id": "7", "volume_gal": 1.5, "duration_s": 60.0}
                                                fill or drain the bath within a minute
    {"id": "8", "inflow_L_per_min": 0.9}        cold water flowing into the bath
    {"id": "9", "series_Ohm": 0.4}              series resistance of the battery
    {"id": "10", "charge": 0.8}                 state of charge of the battery, 0 to 1
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import msgspec

from adaptdrive.errors import NOT_JSON, RefusedError
from adaptdrive_sim.devices.drive import SimulatedDrive
from adaptdrive_sim.devices.sensor_values import SensorFault
from adaptdrive_sim.parameters import ParameterError, check_range
from adaptdrive_sim.plants.bath import Bath
from adaptdrive_sim.plants.battery import Battery
from adaptdrive_sim.plants.motor import Motor


class DisturbanceRequest(
    msgspec.Struct, forbid_unknown_fields=True, frozen=True, omit_defaults=True
):
    """One request as it comes over the wire."""

    id: str
    disks: int | None = None
    torque_Nm: float | None = None
    sag: float | None = None
    duration_s: float | None = None
    noise_V: float | None = None
    fault: int | None = None
    sensor_fault: int | None = None
    volume_gal: float | None = None
    inflow_L_per_min: float | None = None
    series_Ohm: float | None = None
    charge: float | None = None


def parse_request(payload: bytes) -> DisturbanceRequest:
    """Read one request and make sure that it asks for one thing.

    Raises:
        RefusedError: What is wrong with it.
    """
    try:
        request = msgspec.json.decode(payload, type=DisturbanceRequest)
    except NOT_JSON as problem:
        raise RefusedError(str(problem)) from problem
    asked = [name for name in _ACTIONS if getattr(request, name) is not None]
    if len(asked) != 1:
        wanted = ", ".join(_ACTIONS)
        raise RefusedError(f"exactly one of {wanted} is needed, not {len(asked)}")
    if (request.duration_s is not None) != (asked[0] in _LASTING):
        raise RefusedError(f"duration_s belongs to {' and '.join(_LASTING)}, which need it")
    return request


def read_id(payload: bytes) -> str | None:
    """The id of a request that may be wrong otherwise, None where there is none."""
    try:
        found = msgspec.json.decode(payload)
    except NOT_JSON:
        return None
    name = found.get("id") if isinstance(found, dict) else None
    return name if isinstance(name, str) else None


def apply_request(request: DisturbanceRequest, drive: SimulatedDrive) -> None:
    """Do to the plant what a request asks for.

    Raises:
        RefusedError: It cannot be done; nothing was changed.
    """
    name = next(name for name in _ACTIONS if getattr(request, name) is not None)
    try:
        _ACTIONS[name](request, drive)
    except ParameterError as problem:
        raise RefusedError(str(problem)) from problem


def _motor(drive: SimulatedDrive) -> Motor:
    if not isinstance(drive.world.load, Motor):
        raise RefusedError("this load has no shaft")
    return drive.world.load


def _change_disks(request: DisturbanceRequest, drive: SimulatedDrive) -> None:
    _motor(drive).disks += request.disks or 0


def _load_shaft(request: DisturbanceRequest, drive: SimulatedDrive) -> None:
    _motor(drive).torque_Nm = request.torque_Nm or 0.0


def _sag_line(request: DisturbanceRequest, drive: SimulatedDrive) -> None:
    drive.world.line.sag(request.sag or 0.0, request.duration_s or 0.0)


def _set_noise(request: DisturbanceRequest, drive: SimulatedDrive) -> None:
    world = drive.world
    world.noise = dataclasses.replace(world.noise, sigma=request.noise_V or 0.0)


def _inject_fault(request: DisturbanceRequest, drive: SimulatedDrive) -> None:
    drive.inject(request.fault or 0)


def _spoil_sensors(request: DisturbanceRequest, drive: SimulatedDrive) -> None:
    if not drive.has_sensors:
        raise RefusedError("no sensor module is beside this drive")
    check_range("sensor_fault", request.sensor_fault or 0, 0, max(SensorFault), "")
    drive.world.sensor_fault = request.sensor_fault or 0


def _bath(drive: SimulatedDrive) -> Bath:
    if not isinstance(drive.world.load, Bath):
        raise RefusedError("this load holds no water")
    return drive.world.load


def _fill_bath(request: DisturbanceRequest, drive: SimulatedDrive) -> None:
    _bath(drive).fill(request.volume_gal or 0.0, request.duration_s or 0.0)


def _set_inflow(request: DisturbanceRequest, drive: SimulatedDrive) -> None:
    _bath(drive).inflow_L_per_min = request.inflow_L_per_min or 0.0


def _battery(drive: SimulatedDrive) -> Battery:
    if not isinstance(drive.world.load, Battery):
        raise RefusedError("this load is no battery")
    return drive.world.load


def _set_series(request: DisturbanceRequest, drive: SimulatedDrive) -> None:
    _battery(drive).series_Ohm = request.series_Ohm or 0.0


def _set_charge(request: DisturbanceRequest, drive: SimulatedDrive) -> None:
    check_range("charge", request.charge or 0.0, 0.0, 1.0, "")
    _battery(drive).charge = request.charge or 0.0


_LASTING = ("sag", "volume_gal")

_ACTIONS = {
    "disks": _change_disks,
    "torque_Nm": _load_shaft,
    "sag": _sag_line,
    "noise_V": _set_noise,
    "fault": _inject_fault,
    "sensor_fault": _spoil_sensors,
    "volume_gal": _fill_bath,
    "inflow_L_per_min": _set_inflow,
    "series_Ohm": _set_series,
    "charge": _set_charge,
}


def from_words(action: str, values: Sequence[float]) -> dict[str, float]:
    """Turn the words of a command line into a request without its id.

    Raises:
        RefusedError: The action does not take that many values, or one of them is not finite.
    """
    names, fixed = _WORDS[action]
    if len(values) != len(names):
        wanted = " ".join(names) or "no value"
        raise RefusedError(f"{action} takes {wanted}, not {len(values)} values")
    for name, value in zip(names, values, strict=True):
        if not math.isfinite(value):
            raise RefusedError(f"{action}: {name} = {value:g} is not finite")
    given = {name: _whole(value) for name, value in zip(names, values, strict=True)}
    return {**fixed, **given}


def _whole(value: float) -> float:
    """Return an integer where the value is one: fault words are integers on the wire."""
    return int(value) if value.is_integer() else value


_WORDS: dict[str, tuple[tuple[str, ...], dict[str, float]]] = {
    "add-disk": ((), {"disks": 1}),
    "remove-disk": ((), {"disks": -1}),
    "torque": (("torque_Nm",), {}),
    "sag": (("sag", "duration_s"), {}),
    "noise": (("noise_V",), {}),
    "fault": (("fault",), {}),
    "sensor-fault": (("sensor_fault",), {}),
    "volume": (("volume_gal", "duration_s"), {}),
    "inflow": (("inflow_L_per_min",), {}),
    "series-resistance": (("series_Ohm",), {}),
    "charge": (("charge",), {}),
}
