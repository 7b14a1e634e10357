"""Disturbances of a running plant, and their requests.

A request is a JSON object with an `id` and exactly one disturbance:

    {"id": "1", "disks": 1}                     one disk more (-1: one less)
    {"id": "2", "torque_Nm": 0.5}               load torque from now on
    {"id": "3", "sag": 0.2, "duration_s": 1.0}  take 20 % off the line for a second
    {"id": "4", "noise_V": 0.0004}              noise of the output from now on
    {"id": "5", "fault": 1}                     fault word of the drive (0: clear)
    {"id": "6", "sensor_fault": 1}              separate sensors: 1 broken wire, 2 values
                                                that stand still, 3 unplugged (0: none)
    {"id": "7", "volume_gal": 1.5, "duration_s": 60.0}
                                                fill or drain the bath within a minute
    {"id": "8", "inflow_L_per_min": 0.9}        cold water flowing into the bath
    {"id": "9", "series_Ohm": 0.4}              series resistance of the battery
    {"id": "10", "charge": 0.8}                 state of charge of the battery, 0 to 1

The simulator's own topics on an MQTT broker.

    adaptdrive-sim/DRIVE/disturb   requests, as above; never retained
    adaptdrive-sim/DRIVE/reply     the answer to each: id, accepted, reason
    adaptdrive-sim/DRIVE/truth     retained, once a second: what an estimator is to find, and
                                   the disturbances that the device offers

The truth is removed when the simulated drive goes away, by its last will if need be.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeVar

import msgspec

from adaptdrive.mqtt.contract import DeviceReply, Feature
from adaptdrive.util.errors import NOT_JSON, RefusedError
from adaptdrive_sim.devices.sensor_values import SensorFault
from adaptdrive_sim.parameters import ParameterError, check_range
from adaptdrive_sim.plants import bath, battery, motor
from adaptdrive_sim.plants.load import SimulatedLoad
from adaptdrive_sim.world import World

Plant = TypeVar("Plant")


class Disturbed(Protocol):
    """Parts that can be disturbed: a plant, its drive, and its sensor modules."""

    @property
    def world(self) -> World:
        """The plant."""

    @property
    def has_sensors(self) -> bool:
        """True where there are sensor modules."""

    def inject(self, fault: int) -> None:
        """Set the fault word of the drive."""


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

    @property
    def asked(self) -> list[str]:
        """Names of all disturbances that it asks for."""
        return [name for name in _ACTIONS if getattr(self, name) is not None]


def parse_request(payload: bytes) -> DisturbanceRequest:
    """Read one request and make sure that it asks for one thing.

    Raises:
        RefusedError: What is wrong with it.
    """
    try:
        request = msgspec.json.decode(payload, type=DisturbanceRequest)
    except NOT_JSON as problem:
        raise RefusedError(str(problem)) from problem
    if len(request.asked) != 1:
        wanted = ", ".join(_ACTIONS)
        raise RefusedError(f"exactly one of {wanted} is needed, not {len(request.asked)}")
    if (request.duration_s is not None) != (request.asked[0] in _LASTING):
        raise RefusedError(f"duration_s belongs to {' and '.join(_LASTING)}, which need it")
    return request


def answer(payload: bytes, drive: Disturbed) -> DeviceReply:
    """Carry out a request, and return the reply to it; a refused one has changed nothing."""
    try:
        request = parse_request(payload)
        (name,) = request.asked
        _ACTIONS[name](drive, getattr(request, name), request.duration_s or 0.0)
    except (RefusedError, ParameterError) as problem:
        return refused(payload, str(problem))
    return DeviceReply(request.id, accepted=True, reason="")


def refused(payload: bytes, reason: str) -> DeviceReply:
    """Return the reply to a request that is not carried out; it may have no id."""
    try:
        found = msgspec.json.decode(payload)
    except NOT_JSON:
        found = None
    name = found.get("id") if isinstance(found, dict) else None
    return DeviceReply(name if isinstance(name, str) else None, accepted=False, reason=reason)


def _plant(drive: Disturbed, kind: type[Plant]) -> Plant:
    if not isinstance(drive.world.load, kind):
        raise RefusedError(_LACKING[kind])
    return drive.world.load


def _put(kind: type, name: str) -> Callable[[Disturbed, Any, float], None]:
    """Return the effect that sets an attribute of a plant of one kind."""
    return lambda drive, value, _: setattr(_plant(drive, kind), name, value)


def _change_disks(drive: Disturbed, disks: int, _: float) -> None:
    _plant(drive, motor.Motor).disks += disks


def _set_noise(drive: Disturbed, noise_V: float, _: float) -> None:
    drive.world.noise = dataclasses.replace(drive.world.noise, sigma=noise_V)


def _spoil_sensors(drive: Disturbed, sensor_fault: int, _: float) -> None:
    if not drive.has_sensors:
        raise RefusedError("this drive has no sensor modules")
    check_range("sensor_fault", sensor_fault, 0, max(SensorFault), "")
    drive.world.sensor_fault = sensor_fault


def _set_charge(drive: Disturbed, charge: float, _: float) -> None:
    check_range("charge", charge, 0.0, 1.0, "")
    _plant(drive, battery.Battery).charge = charge


_LACKING: dict[type, str] = {
    motor.Motor: "this load has no shaft",
    bath.Bath: "this load holds no water",
    battery.Battery: "this load is no battery",
}

_LASTING = ("sag", "volume_gal")

_ACTIONS: dict[str, Callable[[Disturbed, Any, float], None]] = {
    "disks": _change_disks,
    "torque_Nm": _put(motor.Motor, "torque_Nm"),
    "sag": lambda drive, sag, duration_s: drive.world.line.sag(sag, duration_s),
    "noise_V": _set_noise,
    "fault": lambda drive, fault, _: drive.inject(fault),
    "sensor_fault": _spoil_sensors,
    "volume_gal": lambda drive, gal, duration_s: _plant(drive, bath.Bath).fill(gal, duration_s),
    "inflow_L_per_min": _put(bath.Bath, "inflow_L_per_min"),
    "series_Ohm": _put(battery.Battery, "series_Ohm"),
    "charge": _set_charge,
}
"""Effect of each, with its value and with its duration."""


def from_words(action: str, values: Sequence[float]) -> dict[str, float]:
    """Turn the words of a command line into a request without its id.

    Raises:
        RefusedError: There is no such action, it does not take that many values, or one of them is
            not finite.
    """
    if action not in _WORDS:
        raise RefusedError(f"{action!r} is none of {', '.join(_WORDS)}")
    names, fixed = _WORDS[action]
    if len(values) != len(names):
        wanted = " ".join(names) or "no value"
        raise RefusedError(f"{action} takes {wanted}, not {len(values)} values")
    given = dict(zip(names, values, strict=True))
    for name, value in given.items():
        if not math.isfinite(value):
            raise RefusedError(f"{action}: {name} = {value:g} is not finite")
    return fixed | {name: _whole(value) for name, value in given.items()}


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


def features_of(load: SimulatedLoad) -> tuple[Feature, ...]:
    """Return the disturbances that a plant offers; each still may be refused.

    Args:
        load: The plant.
    """
    found = list(_OFFERS.get(type(load), ()))
    if isinstance(load, bath.Bath):
        first_gal = load.parameters.volume_gal
        for verb, gal in (("pour water in to", 2.0 * first_gal), ("drain to", first_gal)):
            text = f"{verb} {gal:g} US gal within {FILLING_S:g} s"
            found.append(Feature(text, {"volume_gal": gal, "duration_s": FILLING_S}))
    return (*found, Feature("sag the line by 20 % for 1 s", {"sag": 0.2, "duration_s": 1.0}))


FILLING_S = 60.0

_OFFERS: dict[type, tuple[Feature, ...]] = {
    motor.Motor: (
        Feature("add a disk", {"disks": 1}),
        Feature("remove a disk", {"disks": -1}),
        Feature("load the shaft with 0.5 Nm", {"torque_Nm": 0.5}),
        Feature("unload the shaft", {"torque_Nm": 0.0}),
    ),
    battery.Battery: (
        Feature("raise the series resistance to 0.4 Ω", {"series_Ohm": 0.4}),
        Feature("set the charge to 80 %", {"charge": 0.8}),
    ),
}
