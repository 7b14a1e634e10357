"""Disturbances: what is accepted, what is refused, and what they do."""

import json
import re
from pathlib import Path
from typing import Any

import msgspec
import pytest
from jsonschema import Draft202012Validator

from adaptdrive.config import load_configuration
from adaptdrive.mqtt.connection import Broker
from adaptdrive_sim.device import build_sensors
from adaptdrive_sim.devices.disturbances import Remote, from_words, parse_request
from adaptdrive_sim.devices.drive import SimulatedDrive
from adaptdrive_sim.plants.bath import Bath, BathParameters
from adaptdrive_sim.plants.battery import Battery, BatteryParameters
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from adaptdrive_sim.world import SimulatedLoad, World
from tools.pages.asyncapi import schema
from tools.pages.topic_table import simulator_topics

EXAMPLE = Path(__file__).parents[3] / "deploy" / "examples" / "motor.toml"


def ignore(*_: Any, **__: Any) -> None:
    """Report to nobody."""


@pytest.fixture
def remote() -> Remote:
    return of(Motor(MotorParameters()))


def ask(remote: Remote, **request: Any) -> tuple[bool, str]:
    reply = remote.carry_out(msgspec.json.encode({"id": "7", **request}), retained=False)
    assert reply.id == "7"
    assert reply.accepted is (reply.reason == "")
    return reply.accepted, reply.reason


def of(load: SimulatedLoad) -> Remote:
    return Remote(Broker(host="localhost", port=1), "bench", SimulatedDrive(World(load), ignore))


@pytest.mark.parametrize(
    ("load", "request_", "told"),
    [
        (Motor(MotorParameters()), {"torque_Nm": 0.5}, {"torque_Nm": 0.5}),
        (Motor(MotorParameters()), {"noise_V": 0.01}, {"noise_V": 0.01}),
        (Motor(MotorParameters()), {"sag": 0.25, "duration_s": 1.0}, {"line_voltage_V": 90.0}),
        (Motor(MotorParameters()), {"fault": 16}, {"fault": 16}),
        (Bath(BathParameters()), {"volume_gal": 1.5, "duration_s": 0.0}, {"volume_gal": 1.5}),
        (Bath(BathParameters()), {"inflow_L_per_min": 2 * 0.681}, {"tau_s": 100.2}),
        (Battery(BatteryParameters()), {"series_Ohm": 0.8}, {"direct_S": 0.25 / 1.8}),
        (Battery(BatteryParameters()), {"charge": 0.9}, {"charge": 0.9}),
    ],
)
def test_a_disturbance_reaches_what_it_disturbs(
    load: SimulatedLoad, request_: dict[str, float], told: dict[str, float]
) -> None:
    remote = of(load)
    assert ask(remote, **request_) == (True, "")
    remote._drive.tick(0.0)
    found = {name: remote.truth()[name] for name in told}
    assert found == pytest.approx(told, rel=2e-3)


def test_only_sensors_that_are_there_fail() -> None:
    remote, example = of(Bath(BathParameters())), EXAMPLE.with_name("bath-thermocouples.toml")
    assert ask(remote, sensor_fault=1) == (False, "this drive has no sensor modules")
    assert ask(remote, charge=0.5) == (False, "this load is no battery")
    build_sensors(load_configuration(example), remote._drive, example)
    assert ask(remote, sensor_fault=1) == (True, "")
    assert remote._drive.world.sensor_fault == 1


@pytest.mark.parametrize(
    ("request_", "reason"),
    [
        ({}, "exactly one of"),
        ({"disks": 1, "fault": 1}, "exactly one of .* not 2"),
        ({"sag": 0.2}, "which need it"),
        ({"disks": 1, "duration_s": 1.0}, "duration_s belongs to sag"),
        ({"disks": 1.5}, "Expected `int"),
        ({"disks": "1"}, "Expected `int"),
        ({"wheels": 1}, "unknown field `wheels`"),
        ({"torque_Nm": -1.0}, r"torque_Nm = -1\.0 must lie in"),
        ({"torque_Nm": 1e9}, "torque_Nm = 1000000000.0 must lie in"),
        ({"noise_V": -0.1}, r"NoiseParameters\.sigma = -0\.1"),
        ({"sag": 1.5, "duration_s": 1.0}, r"sag = 1\.5 must lie in"),
        ({"fault": 128}, "fault = 128 must lie in 0…127"),
    ],
)
def test_a_wrong_request_is_refused_with_its_reason_and_changes_nothing(
    remote: Remote, request_: dict[str, Any], reason: str
) -> None:
    before = {**remote.truth(), "time": ""}
    accepted, given = ask(remote, **request_)
    assert not accepted
    assert re.search(reason, given)
    assert {**remote.truth(), "time": ""} == before


@pytest.mark.parametrize(
    "payload",
    [b"", b"{", b"[]", b'{"disks": 1}', b"\xff", b'{"id": 7}', b'{"id": "1", "fault": NaN}'],
)
def test_what_cannot_be_read_is_refused_without_an_id(remote: Remote, payload: bytes) -> None:
    reply = remote.carry_out(payload, retained=False)
    assert reply.id is None
    assert not reply.accepted
    assert reply.reason


def test_a_retained_request_is_refused(remote: Remote) -> None:
    reply = remote.carry_out(b'{"id": "1", "disks": 1}', retained=True)
    assert not reply.accepted
    assert "retained" in reply.reason
    assert remote.truth()["disks"] == 1


@pytest.mark.parametrize(
    ("action", "values", "request_"),
    [
        ("add-disk", (), {"disks": 1}),
        ("remove-disk", (), {"disks": -1}),
        ("torque", (0.5,), {"torque_Nm": 0.5}),
        ("sag", (0.2, 1.0), {"sag": 0.2, "duration_s": 1.0}),
        ("noise", (0.001,), {"noise_V": 0.001}),
        ("fault", (3.0,), {"fault": 3}),
    ],
)
def test_words_become_requests(
    action: str, values: tuple[float, ...], request_: dict[str, float]
) -> None:
    made = from_words(action, values)
    assert made == request_
    parse_request(msgspec.json.encode({"id": "1", **made}))


@pytest.mark.parametrize(
    "load", [Motor(MotorParameters()), Bath(BathParameters()), Battery(BatteryParameters())]
)
def test_what_a_device_offers_is_carried_out(load: SimulatedLoad) -> None:
    remote = of(load)
    features = json.loads(msgspec.json.encode(remote.truth()))["features"]
    assert len(features) >= 3
    for feature in features:
        assert ask(remote, **feature["request"]) == (True, ""), feature


def test_the_state_of_a_device_fits_its_schema(remote: Remote) -> None:
    state = json.loads(msgspec.json.encode(remote.truth()))
    topic = next(one for one in simulator_topics() if one.name == "simulator/truth")
    Draft202012Validator(schema(topic)).validate(state)
    assert {"text": "add a disk", "request": {"disks": 1}} in state["features"]
    assert not Draft202012Validator(schema(topic)).is_valid({"features": [{"text": 5}]})
