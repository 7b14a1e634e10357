"""What the controller is built from, as the configuration says it."""

from __future__ import annotations

import math
import tomllib

import pytest

from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings
from adaptdrive.config.file import validate_configuration
from tests.config.documents import flaws, parse
from tests.hardware.bench import EXAMPLES

HELD = {
    "voltage_loop__where": '"drive"',
    "signals__command__boost_reference_V__signal": '"DriveCommand.BoostReference"',
}


def test_the_drives_own_lag_enters_the_design() -> None:
    rates = controller_settings(parse(**HELD, voltage_loop__lag_s="0.5")).rates
    assert rates.lag_ticks == pytest.approx(60.0)


def test_without_a_lag_nine_ticks_are_counted() -> None:
    assert controller_settings(parse()).rates.lag_ticks == 9.0
    assert controller_settings(parse(**HELD)).rates.lag_ticks == 9.0


@pytest.mark.parametrize(
    "changes", [{"voltage_loop__lag_s": "0.1"}, {**HELD, "voltage_loop__lag_s": "1.1"}]
)
def test_a_lag_that_cannot_be_counted_is_a_flaw(changes: dict[str, str]) -> None:
    assert set(flaws(**changes)) == {"voltage_loop.lag_s"}


@pytest.mark.parametrize(
    ("changes", "noise_V"),
    [({}, 8.0), ({"load__noise_V": "12.5"}, 12.5), ({"load__noise_V": "0.0"}, 0.0)],
)
def test_the_noise_of_the_input_is_limited_in_volts_of_a_motor(
    changes: dict[str, str], noise_V: float
) -> None:
    assert controller_settings(parse(**changes)).jacket.noise_max == pytest.approx(noise_V)


def test_in_watts_of_a_bath() -> None:
    path = EXAMPLES / "bath.toml"
    configuration = validate_configuration(tomllib.loads(path.read_text("utf-8")), path)
    load, limits = build_load(configuration), configuration.drive.limits
    low_V, high_V = limits.boost_reference_min_V, limits.boost_reference_max_V
    slope_W_per_V = load.input_gain * (low_V + high_V)
    assert load.input_exponent == 2
    expected_W = 0.04 * (high_V - low_V) * slope_W_per_V
    assert controller_settings(configuration).jacket.noise_max == pytest.approx(expected_W)


def test_a_step_of_the_sensor_is_a_noise_of_its_own() -> None:
    jacket = controller_settings(parse(load__resolution="0.012")).jacket
    assert jacket.noise_min == pytest.approx(0.012 / math.sqrt(12.0))
