"""Values that cannot all be true are refused with the figures that show it."""

from __future__ import annotations

from pathlib import Path

import pytest

from adaptdrive.app.examine import implausible
from adaptdrive.config import load_configuration, parse_configuration
from adaptdrive.errors import Flaw

EXAMPLES = Path(__file__).parents[2] / "deploy" / "examples"


def found(name: str, old: str = "", new: str = "") -> list[Flaw]:
    text = (EXAMPLES / name).read_text(encoding="utf-8")
    assert old in text
    return list(implausible(parse_configuration(text.replace(old, new), EXAMPLES / name)))


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.toml")), ids=lambda path: path.stem)
def test_every_example_is_plausible(path: Path) -> None:
    assert list(implausible(load_configuration(path))) == []


@pytest.mark.parametrize(
    ("name", "old", "new", "place", "words"),
    [
        (
            "motor.toml",
            "gain = 0.011 ",
            "gain = 11.0 ",
            "load.model",
            "V_c = 200…400 V gives speed = 2200…4400 V, which misses every set-point of 0…4.5 V",
        ),
        ("motor.toml", "[mqtt]\n", "[mqtt]\ntelemetry_Hz = 0.9\n", "mqtt.telemetry_Hz", "as live"),
        ("bath.toml", "_per_W = 0.02104", "_per_W = 21.04", "load.model", "misses every set-point"),
        ("bath.toml", "tau_s = 200.0", "tau_s = 2e6", "load.model", "1e+05 slow periods"),
        ("motor.toml", "tau_motor_s = 11.7", "tau_motor_s = 1.17e5", "load.model", "1.17e+05 s"),
        (
            "battery.toml",
            "ratio = 0.25 ",
            "ratio = 25.0 ",
            "load.model.turns_ratio",
            "5000…1e+04 V",
        ),
        ("battery.toml", "ratio = 0.25 ", "ratio = 0.025 ", "load.model.turns_ratio", "5…10 V"),
        ("battery.toml", "unidirectional", "bidirectional", "drive.kind", "discharge the battery"),
        (
            "motor.toml",
            "capacitance_F = 1.0e-3",
            "capacitance_F = 1000.0",
            "drive.boost_capacitance_F",
            "1000 F takes 2.59e+03 s from the line's peak to 200 V with 2160 W",
        ),
        (
            "motor.toml",
            "capacitance_F = 1.0e-3",
            "capacitance_F = 1.0e-6",
            "drive.boost_capacitance_F",
            "1e-06 F holds 0.08 J at 400 V; a load of load_power_max_W takes 12.5 J a half cycle",
        ),
    ],
)
def test_a_value_that_cannot_be_true_is_a_flaw(
    name: str, old: str, new: str, place: str, words: str
) -> None:
    (flaw,) = found(name, old, new)
    assert flaw.place == place
    assert words in flaw.message
