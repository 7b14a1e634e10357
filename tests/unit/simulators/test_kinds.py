"""The simulated load is that of the configuration, and a wrong option is one clear line."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest

from adaptdrive.app.loads import build_load
from adaptdrive.cli import FAILED, carry_out
from adaptdrive.cli.options import parsed_command
from adaptdrive.config import Configuration
from adaptdrive.config.file import validate_configuration
from adaptdrive.util.errors import RefusedError
from adaptdrive_sim import cli
from adaptdrive_sim.device import DeviceSettings, build_world
from adaptdrive_sim.world import load_of
from tests.unit.devices.bench import EXAMPLES

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
    found = world.truth()
    if kind == "motor":
        found["tau_sum_s"] = found["tau_motor_s"] + found["tau_filter_s"]
        found["tau_product_s2"] = found["tau_motor_s"] * found["tau_filter_s"]
    expected = load.physical(list(load.numerator), list(load.denominator))
    assert [found[name] for name in load.names] == pytest.approx(expected)


def test_an_unknown_parameter_is_refused_with_the_nearest_one() -> None:
    configuration = changed("motor", ("simulation.parameters", {"friction_Nm": 0.03}))
    with pytest.raises(RefusedError, match=r"simulation\.parameters\.friction_Nm: .*friction_Nms"):
        load_of(configuration)


def status_of(words: str) -> int:
    """Carry out a command of the simulators; return its status."""
    return carry_out("adaptdrive-sim", parsed_command(cli.app, words.split()), (), FAILED)


MOTOR = EXAMPLES / "motor.toml"


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (f"device {MOTOR} --noise -1", "NoiseParameters.sigma = -1.0 must lie in"),
        (f"device {MOTOR} --initial-voltage 100", "boost_voltage_V = 100.0 must be at least"),
        (f"device {MOTOR} --broker a/b", "broker 'a/b' is not HOST:PORT"),
        (f"device {MOTOR} --interface udp_multicast --port 0", "--port = 0 must lie in 1…65535"),
        (f"device {EXAMPLES}/motor-cia402.toml --command-timeout 0.2", "watches a heartbeat"),
        ("device none.toml", "none.toml"),
        ("reproduce motor --output out --spikes often", "spikes 'often' is not RATE,SIGMA"),
        ("reproduce motor --output out --noise -1", "noise = -1.0 must lie in"),
        ("reproduce motor --output out --seed -4", "seed = -4 must lie in"),
        ("reproduce bath --output out --keep-speed", "--keep-speed: a bath has no disks"),
        ("reproduce bath --output occupied", "occupied: File exists"),
        ("campaign standard.toml --output out --runs=0", "--runs = 0 must lie in "),
        ("campaign standard.toml --output out --processes=0", "--processes = 0 must lie in "),
        ("campaign standard.toml --output out --only=-1", "--only = -1 must lie in "),
    ],
)
def test_what_cannot_be_asked_for_is_one_clear_line(
    words: str,
    complaint: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "occupied").touch()
    assert status_of(words) == 1
    said = capsys.readouterr().err
    assert said.startswith("adaptdrive-sim: ")
    assert complaint in said
    assert said.count("\n") == 1
