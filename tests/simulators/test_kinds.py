"""The simulated load is that of the configuration."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from typing import Any

import pytest

from adaptdrive.app.loads import build_load
from adaptdrive.config import Configuration, load_configuration
from adaptdrive.config.file import validate_configuration
from adaptdrive.errors import RefusedError
from adaptdrive_sim.device_main import build_world
from adaptdrive_sim.device_settings import DeviceSettings
from adaptdrive_sim.plants.kinds import load_of
from adaptdrive_sim.plants.motor import Motor
from tests.hardware.bench import EXAMPLES

MODELS: dict[str, dict[str, float]] = {
    "motor": {"gain": 0.004, "tau_motor_s": 2.5, "tau_filter_s": 0.4},
    "bath": {
        "resistance_K_per_W": 0.08,
        "tau_s": 900.0,
        "turns_ratio": 0.5,
        "droop_Ohm": 0.3,
        "heater_Ohm": 20.0,
    },
    "battery": {
        "turns_ratio": 1.0,
        "droop_Ohm": 0.2,
        "internal_Ohm": 0.5,
        "relaxation_Ohm": 0.1,
        "relaxation_s": 12.0,
    },
}


def changed(example: str, *changes: tuple[str, dict[str, Any]]) -> Configuration:
    tables = tomllib.loads((EXAMPLES / f"{example}.toml").read_text(encoding="utf-8"))
    for place, values in changes:
        table: dict[str, Any] = tables
        for name in place.split("."):
            table = table.setdefault(name, {})
        table.update(values)
    return validate_configuration(tables, EXAMPLES / f"{example}.toml")


@pytest.mark.parametrize("kind", MODELS)
def test_its_linear_model_is_the_configured_one(kind: str) -> None:
    configuration = changed(kind, ("load.model", MODELS[kind]))
    world = build_world(configuration, DeviceSettings())
    load = build_load(configuration)
    found = world.true_model
    if kind == "motor":
        found["tau_sum_s"] = found["tau_motor_s"] + found["tau_filter_s"]
        found["tau_product_s2"] = found["tau_motor_s"] * found["tau_filter_s"]
    expected = load.physical(list(load.numerator), list(load.denominator))
    assert [found[name] for name in load.names] == pytest.approx(expected)


@pytest.mark.parametrize("kind", MODELS)
def test_the_examples_give_the_reference_loads(kind: str) -> None:
    configuration = load_configuration(EXAMPLES / f"{kind}.toml")
    reference = {"motor": 0.4095, "bath": 0.6, "battery": 20}
    load: Any = load_of(configuration)
    own = {"motor": "disk_kgm2", "bath": "volume_gal", "battery": "cells"}
    assert getattr(load.parameters, own[kind]) == pytest.approx(reference[kind], rel=1e-3)


def test_what_the_model_leaves_open_can_be_named() -> None:
    given = {"resistance_Ohm": 1.5, "friction_Nms": 0.03}
    configuration = changed("motor", ("simulation.parameters", given))
    world = build_world(configuration, DeviceSettings())
    load: Any = world.load
    assert load.parameters.friction_Nms == 0.03
    assert world.true_model["gain"] == pytest.approx(0.011)
    assert world.true_model["tau_motor_s"] == pytest.approx(11.7)


def test_an_unknown_parameter_is_refused_with_the_nearest_one() -> None:
    configuration = changed("motor", ("simulation.parameters", {"friction_Nm": 0.03}))
    with pytest.raises(RefusedError, match=r"simulation\.parameters\.friction_Nm: .*friction_Nms"):
        load_of(configuration)


def simulator(*words: str, hidden: str = "pass") -> subprocess.CompletedProcess[str]:
    code = f"import sys; {hidden}; from adaptdrive_sim.cli import main; main()"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", code, *words]
    return subprocess.run(command, capture_output=True, text=True, env=environment, check=False)


@pytest.mark.parametrize(
    ("example", "words", "problem"),
    [
        ("bath", ("--disks", "3"), "--disks 3: a bath has no shaft"),
        ("motor-cia402", ("--command-timeout", "0.2"), "canopen watches a heartbeat"),
    ],
)
def test_an_option_that_does_not_apply_is_refused(
    example: str, words: tuple[str, ...], problem: str
) -> None:
    answer = simulator("device", str(EXAMPLES / f"{example}.toml"), *words)
    assert answer.returncode == 1
    assert problem in answer.stderr
    assert answer.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "option"),
    [
        ("campaign no-file.toml --output out", "--runs"),
        ("campaign no-file.toml --output out", "--processes"),
        ("campaign no-file.toml --output out", "--only"),
        ("reproduce bath --output out --spikes none", "--seed"),
        ("demo bath --duration 0.1", "--seed"),
        ("device no-file.toml", "--seed"),
        ("device no-file.toml", "--disks"),
        ("device no-file.toml", "--port"),
    ],
)
def test_an_integer_is_not_rounded(words: str, option: str) -> None:
    answer = simulator(*words.split(), option, "1.9")
    assert answer.returncode == 2
    assert f'Invalid value for {option}: unable to convert "1.9" into int.' in answer.stderr


def test_without_its_extra_it_names_the_command_to_install_it() -> None:
    hidden = "sys.modules['numpy'] = None"
    answer = simulator("device", str(EXAMPLES / "motor.toml"), hidden=hidden)
    assert answer.returncode == 1
    assert answer.stderr == ("adaptdrive-sim: numpy is missing: pip install 'adaptdrive[sim]'\n")


@pytest.mark.parametrize(("given", "speed"), [({}, 100.0), ({"dropped_at_rest": 1.0}, 50.0)])
def test_a_disk_may_land_on_the_shaft_at_rest(given: dict[str, float], speed: float) -> None:
    motor = load_of(changed("motor", ("simulation.parameters", given)))
    assert isinstance(motor, Motor)
    motor.speed_rad_s = 100.0
    motor.disks = 2
    assert motor.speed_rad_s == pytest.approx(speed)
