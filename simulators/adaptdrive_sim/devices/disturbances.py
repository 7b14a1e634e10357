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

The truth is removed when the simulated drive goes away, by its last will if need be. The drive's
node never waits for any of this: when the broker is away the node runs on, and a new client is
tried at growing intervals.
"""

import asyncio
import contextlib
import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, TypeVar

import aiomqtt
import msgspec

from adaptdrive.mqtt.connection import Broker
from adaptdrive.mqtt.contract import DeviceReply, Feature, simulator_topic
from adaptdrive.mqtt.steady import SteadyClient
from adaptdrive.util.errors import NOT_JSON, RefusedError
from adaptdrive_sim.devices.drive import SimulatedDrive
from adaptdrive_sim.devices.sensors import SensorFault
from adaptdrive_sim.parameters import ParameterError, check_range
from adaptdrive_sim.plants import bath, battery, motor
from adaptdrive_sim.world import SimulatedLoad, World

Plant = TypeVar("Plant")
Drive = SimulatedDrive | None
Action = Callable[[World, Drive, Any, float], None]


def parse_request(payload: bytes) -> tuple[str, str, float, float]:
    """Return the id of a request, the one disturbance that it asks for, its value and duration.

    Raises:
        RefusedError: What is wrong with it.
    """
    try:
        given = msgspec.structs.asdict(msgspec.json.decode(payload, type=_REQUEST))
    except NOT_JSON as problem:
        raise RefusedError(str(problem)) from problem
    asked = [name for name in _ACTIONS if given[name] is not None]
    if len(asked) != 1:
        wanted = ", ".join(_ACTIONS)
        raise RefusedError(f"exactly one of {wanted} is needed, not {len(asked)}")
    if (given["duration_s"] is not None) != (asked[0] in _LASTING):
        raise RefusedError(f"duration_s belongs to {' and '.join(_LASTING)}, which need it")
    return given["id"], asked[0], given[asked[0]], given["duration_s"] or 0.0


def answer(payload: bytes, world: World, drive: Drive = None) -> DeviceReply:
    """Carry out a request, and return the reply to it; a refused one has changed nothing.

    Args:
        payload: The request.
        world: The plant.
        drive: Its drive, None for a story in virtual time, which has none.
    """
    try:
        name, action, value, duration_s = parse_request(payload)
        _ACTIONS[action](world, drive, value, duration_s)
    except (RefusedError, ParameterError) as problem:
        return refused(payload, str(problem))
    return DeviceReply(name, accepted=True, reason="")


def refused(payload: bytes, reason: str) -> DeviceReply:
    """Return the reply to a request that is not carried out; it may have no id."""
    try:
        found = msgspec.json.decode(payload)
    except NOT_JSON:
        found = None
    name = found.get("id") if isinstance(found, dict) else None
    return DeviceReply(name if isinstance(name, str) else None, accepted=False, reason=reason)


def _plant(world: World, kind: type[Plant]) -> Plant:
    if not isinstance(world.load, kind):
        raise RefusedError(_LACKING[kind])
    return world.load


def _put(
    kind: type, name: str, ends: tuple[float, float], unit: str, attribute: str = ""
) -> Action:
    """Return the effect that sets an attribute of a plant of one kind, within a range."""

    def put(world: World, _drive: Drive, value: float, _: float) -> None:
        plant: object = _plant(world, kind)
        check_range(name, value, *ends, unit)
        setattr(plant, attribute or name, value)

    return put


def _change_disks(world: World, _drive: Drive, disks: int, _: float) -> None:
    _plant(world, motor.Motor).disks += disks


def _set_noise(world: World, _drive: Drive, noise_V: float, _: float) -> None:
    world.set_noise(dataclasses.replace(world.noise, sigma=noise_V))


def _inject(_world: World, drive: Drive, fault: int, _: float) -> None:
    if drive is None:
        raise RefusedError(f"fault {fault}: this story has no drive process")
    drive.inject(fault)


def _disturb_sensors(world: World, drive: Drive, sensor_fault: int, _: float) -> None:
    if drive is None or not drive.has_sensors:
        raise RefusedError("this drive has no sensor modules")
    check_range("sensor_fault", sensor_fault, 0, max(SensorFault), "")
    world.sensor_fault = sensor_fault


_LACKING: dict[type, str] = {
    motor.Motor: "this load has no shaft",
    bath.Bath: "this load holds no water",
    battery.Battery: "this load is no battery",
}

_LASTING = ("sag", "volume_gal")

_ACTIONS: dict[str, Action] = {
    "disks": _change_disks,
    "torque_Nm": _put(motor.Motor, "torque_Nm", (0.0, 100.0), "N m"),
    "sag": lambda world, _, sag, duration_s: world.line.sag(sag, duration_s),
    "noise_V": _set_noise,
    "fault": _inject,
    "sensor_fault": _disturb_sensors,
    "volume_gal": lambda world, _, gal, duration_s: _plant(world, bath.Bath).fill(gal, duration_s),
    "inflow_L_per_min": _put(bath.Bath, "inflow_L_per_min", (0.01, 100.0), "L/min"),
    "series_Ohm": _put(battery.Battery, "series_Ohm", (1e-4, 1e2), "Ω", "resistance_Ohm"),
    "charge": _put(battery.Battery, "charge", (0.0, 1.0), ""),
}
"""Effect of each, with its value and with its duration."""

_WHOLE = ("disks", "fault", "sensor_fault")

_REQUEST = msgspec.defstruct(
    "DisturbanceRequest",
    [
        ("id", str),
        *((name, int | None if name in _WHOLE else float | None, None) for name in _ACTIONS),
        ("duration_s", float | None, None),
    ],
    forbid_unknown_fields=True,
)
"""One request as it comes over the wire."""


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
    # fault words are integers on the wire
    return fixed | {name: int(v) if v.is_integer() else v for name, v in given.items()}


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


# Disturbances over MQTT, and the true parameters for comparison with estimates.

TRUTH_PERIOD_s = 1.0
RETRY_FIRST_s = 0.5
RETRY_LAST_s = 10.0
CLOSING_s = 1.0


class Remote:
    """Serves one simulated drive on one broker."""

    def __init__(self, broker: Broker, name: str, drive: SimulatedDrive) -> None:
        self._broker = broker
        self._name = name
        self._drive = drive
        self._retry_s = RETRY_FIRST_s

    async def run(self) -> None:
        """Serve until cancelled; reconnect whenever the broker is lost."""
        while True:
            try:
                await self._serve()
            except* aiomqtt.MqttError as problems:
                reason = str(problems.exceptions[0])
                self._drive.report("broker away", reason=reason, retry_s=self._retry_s)
            await asyncio.sleep(self._retry_s)
            self._retry_s = min(2.0 * self._retry_s, RETRY_LAST_s)

    async def _serve(self) -> None:
        """Serve one connection until it is lost."""
        truth = simulator_topic(self._name, "truth")
        will = aiomqtt.Will(truth, payload=b"", qos=1, retain=True)
        address = self._broker
        async with SteadyClient(address.host, address.port, will=will) as client:
            self._drive.report("broker found", broker=f"{address.host}:{address.port}")
            self._retry_s = RETRY_FIRST_s
            try:
                async with asyncio.TaskGroup() as tasks:
                    tasks.create_task(self._publish_truth(client, truth))
                    tasks.create_task(self._answer(client))
            finally:
                with contextlib.suppress(aiomqtt.MqttError, TimeoutError):
                    async with asyncio.timeout(CLOSING_s):
                        await client.publish(truth, b"", qos=1, retain=True)

    async def _publish_truth(self, client: SteadyClient, truth: str) -> None:
        while True:
            payload = msgspec.json.encode(self.truth())
            await client.publish(truth, payload, qos=0, retain=True)
            await asyncio.sleep(TRUTH_PERIOD_s)

    async def _answer(self, client: SteadyClient) -> None:
        await client.subscribe(simulator_topic(self._name, "disturb"), qos=1)
        async for message in client.messages:
            reply = self.carry_out(message.payload, retained=bool(message.retain))
            encoded = msgspec.json.encode(reply)
            await client.publish(simulator_topic(self._name, "reply"), encoded, qos=1)

    def carry_out(self, payload: bytes, *, retained: bool) -> DeviceReply:
        """Carry out one request, or return the reason of a refusal."""
        if retained:
            return refused(payload, "a retained request is old and is not carried out")
        reply = answer(payload, self._drive.world, self._drive)
        if reply.accepted:
            self._drive.report("disturbed", **msgspec.json.decode(payload))
        return reply

    def truth(self) -> Mapping[str, Any]:
        """Return the true state and parameters, and the disturbances that the device offers."""
        world, now = self._drive.world, datetime.now(UTC).isoformat(timespec="milliseconds")
        own = {"fault": self._drive.fault, "features": features_of(world.load)}
        return {"time": now.replace("+00:00", "Z"), **world.truth(), **own}
