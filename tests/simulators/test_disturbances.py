"""Disturbances: what is accepted, what is refused, and what they do."""

import json
import math
import re
from pathlib import Path
from typing import Any

import msgspec
import pytest
from jsonschema import Draft202012Validator

from adaptdrive.config import load_configuration
from adaptdrive.config.services import Mqtt
from adaptdrive.errors import RefusedError
from adaptdrive_sim import cli
from adaptdrive_sim.device_main import build_sensors
from adaptdrive_sim.device_settings import parse_address
from adaptdrive_sim.devices.drive import SimulatedDrive
from adaptdrive_sim.devices.remote import Remote
from adaptdrive_sim.disturbances import from_words, parse_request
from adaptdrive_sim.parameters import ParameterError
from adaptdrive_sim.plants.bath import Bath, BathParameters
from adaptdrive_sim.plants.battery import Battery, BatteryParameters
from adaptdrive_sim.plants.load import SimulatedLoad
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from adaptdrive_sim.world import World
from tools.pages.asyncapi import schema
from tools.pages.topic_table import simulator_topics

EXAMPLE = Path(__file__).parents[2] / "deploy" / "examples" / "motor.toml"


def ignore(*_: Any, **__: Any) -> None:
    """Report to nobody."""


@pytest.fixture
def remote() -> Remote:
    drive = SimulatedDrive(World(Motor(MotorParameters())), ignore)
    return Remote(Mqtt(host="localhost", port=1), "bench", drive, ignore)


def ask(remote: Remote, **request: Any) -> tuple[bool, str]:
    reply = remote.carry_out(msgspec.json.encode({"id": "7", **request}), retained=False)
    assert reply.id == "7"
    assert reply.accepted is (reply.reason == "")
    return reply.accepted, reply.reason


def test_disks_come_and_go(remote: Remote) -> None:
    assert ask(remote, disks=2) == (True, "")
    assert remote.truth()["tau_motor_s"] == pytest.approx(35.1)
    assert ask(remote, disks=-1) == (True, "")
    assert remote.truth()["disks"] == 2


def test_the_last_disk_cannot_be_taken(remote: Remote) -> None:
    accepted, reason = ask(remote, disks=-1)
    assert not accepted
    assert reason == "disks = 0 must lie in 1…10"
    assert remote.truth()["disks"] == 1


def test_torque_and_noise_stay_until_the_next_request(remote: Remote) -> None:
    assert ask(remote, torque_Nm=0.5) == (True, "")
    assert ask(remote, noise_V=0.01) == (True, "")
    assert remote.truth()["torque_Nm"] == 0.5
    assert remote.truth()["noise_V"] == 0.01


def test_a_sag_reaches_the_line(remote: Remote) -> None:
    assert ask(remote, sag=0.25, duration_s=1.0) == (True, "")
    remote._drive.tick(0.0)
    assert remote.truth()["line_voltage_V"] == 90.0


def of(load: SimulatedLoad) -> Remote:
    return Remote(
        Mqtt(host="localhost", port=1), "bench", SimulatedDrive(World(load), ignore), ignore
    )


def test_a_bath_is_filled_and_its_inflow_changed() -> None:
    remote = of(Bath(BathParameters()))
    assert ask(remote, volume_gal=1.5, duration_s=0.0) == (True, "")
    assert remote.truth()["volume_gal"] == pytest.approx(1.5)
    before_s = float(remote.truth()["tau_s"])
    assert ask(remote, inflow_L_per_min=2 * 0.681) == (True, "")
    assert remote.truth()["tau_s"] == pytest.approx(before_s / 2)
    assert ask(remote, inflow_L_per_min=0.0) == (
        False,
        "inflow_L_per_min = 0.0 must lie in 0.01…100 L/min",
    )
    assert ask(remote, charge=0.5) == (False, "this load is no battery")


def test_a_battery_ages_and_is_charged() -> None:
    remote = of(Battery(BatteryParameters()))
    assert ask(remote, series_Ohm=0.8) == (True, "")
    assert remote.truth()["direct_S"] == pytest.approx(0.25 / 1.8)
    assert ask(remote, charge=0.9) == (True, "")
    assert remote.truth()["charge"] == 0.9
    assert ask(remote, charge=1.1) == (False, "charge = 1.1 must lie in 0…1")
    assert ask(remote, inflow_L_per_min=1.0) == (False, "this load holds no water")


def test_only_sensors_that_are_there_fail() -> None:
    remote, example = of(Bath(BathParameters())), EXAMPLE.with_name("bath-thermocouples.toml")
    assert ask(remote, sensor_fault=1) == (False, "this drive has no sensor modules")
    build_sensors(load_configuration(example), remote._drive, example)
    assert ask(remote, sensor_fault=1) == (True, "")
    assert remote._drive.world.sensor_fault == 1


def test_a_fault_reaches_the_drive(remote: Remote) -> None:
    assert ask(remote, fault=16) == (True, "")
    remote._drive.tick(0.0)
    assert remote.truth()["fault"] == 16


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
    "payload", [b"", b"{", b"[]", b"7", b'{"disks": 1}', b"\xff", b'{"id": 7}']
)
def test_what_cannot_be_read_is_refused_without_an_id(remote: Remote, payload: bytes) -> None:
    reply = remote.carry_out(payload, retained=False)
    assert reply.id is None
    assert not reply.accepted
    assert reply.reason


def test_not_a_number_is_refused() -> None:
    with pytest.raises(RefusedError):
        parse_request(b'{"id": "1", "torque_Nm": NaN}')


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


def test_words_that_do_not_fit_are_refused() -> None:
    with pytest.raises(RefusedError, match="sag takes sag duration_s, not 1 values"):
        from_words("sag", (0.2,))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_number_that_is_not_finite_is_refused(value: float) -> None:
    with pytest.raises(RefusedError, match=f"sag: duration_s = {value} is not finite"):
        from_words("sag", (0.2, value))


@pytest.mark.parametrize("port", ["0", "-1", "99999"])
def test_a_port_that_does_not_exist_is_refused(port: str) -> None:
    words = ["device", str(EXAMPLE), "--interface", "udp_multicast", "--port", port]
    with pytest.raises(ParameterError, match=f"^--port = {port} must lie in 1…65535"):
        cli.app(words)


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("broker:1884", Mqtt(host="broker", port=1884)),
        ("10.0.0.1", Mqtt(host="10.0.0.1", port=1883)),
        ("[::1]:1885", Mqtt(host="::1", port=1885)),
    ],
)
def test_broker_addresses(text: str, address: Mqtt) -> None:
    assert parse_address(text) == address


@pytest.mark.parametrize(
    "text", ["", ":1883", "broker:", "broker:x", "a:0", "a:70000", "::1", "a/b"]
)
def test_no_broker_addresses(text: str) -> None:
    with pytest.raises(RefusedError, match="broker"):
        parse_address(text)


@pytest.mark.parametrize(
    "load",
    [Motor(MotorParameters()), Bath(BathParameters()), Battery(BatteryParameters())],
    ids=["motor", "bath", "battery"],
)
def test_what_a_device_offers_is_carried_out(load: SimulatedLoad) -> None:
    device = SimulatedDrive(World(load), ignore)
    remote = Remote(Mqtt(host="localhost", port=1), "bench", device, ignore)
    features = json.loads(msgspec.json.encode(remote.state()))["features"]
    assert len(features) >= 3
    for feature in features:
        assert ask(remote, **feature["request"]) == (True, ""), feature


def test_the_state_of_a_device_fits_its_schema(remote: Remote) -> None:
    state = json.loads(msgspec.json.encode(remote.state()))
    topic = next(one for one in simulator_topics() if one.name == "simulator/truth")
    Draft202012Validator(schema(topic)).validate(state)
    assert {"text": "add a disk", "request": {"disks": 1}} in state["features"]
    assert not Draft202012Validator(schema(topic)).is_valid({"features": [{"text": 5}]})
