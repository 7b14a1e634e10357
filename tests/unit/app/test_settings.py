"""What the controller is built from, as the configuration says it."""

from __future__ import annotations

import math
import tomllib

import pytest

from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings, machine_limits
from adaptdrive.config.file import validate_configuration
from adaptdrive.control.settings import EstimatorSettings, SupervisionLimits
from tests.unit.config.documents import parse
from tests.unit.devices.bench import EXAMPLES

HELD = {
    "voltage_loop__where": '"drive"',
    "signals__command__boost_reference_V__signal": '"DriveCommand.BoostReference"',
}


def test_the_drives_own_lag_enters_the_design() -> None:
    rates = controller_settings(parse(**HELD, voltage_loop__lag_s="0.5")).rates
    assert rates.lag_ticks == pytest.approx(60.0)


def test_the_noise_of_the_input_is_limited_in_volts_of_a_motor() -> None:
    assert controller_settings(parse()).supervision.noise_max == pytest.approx(8.0)


def test_in_watts_of_a_bath() -> None:
    path = EXAMPLES / "bath.toml"
    configuration = validate_configuration(tomllib.loads(path.read_text("utf-8")), path)
    load, limits = build_load(configuration), configuration.drive.limits
    low_V, high_V = limits.boost_reference_min_V, limits.boost_reference_max_V
    slope_W_per_V = load.input_gain * (low_V + high_V)
    assert load.input_exponent == 2
    expected_W = 0.04 * (high_V - low_V) * slope_W_per_V
    assert controller_settings(configuration).supervision.noise_max == pytest.approx(expected_W)


STRICT = {
    "supervisor__ratio_min": "0.9",
    "supervisor__ratio_max": "1.1",
    "estimator__settle_s": "60.0",
    "load__resolution": "0.01",
    "load__samples": "60",
}


def test_the_papers_design_takes_nothing_from_the_keys_of_the_exact_one() -> None:
    plain = controller_settings(parse(load__design='"paper"'))
    assert controller_settings(parse(load__design='"paper"', **STRICT)) == plain


def test_the_papers_design_has_the_papers_numbers_and_no_limits() -> None:
    settings = controller_settings(parse(load__design='"paper"'))
    assert settings.exact is False
    assert settings.rates.samples == 1
    assert settings.learning == EstimatorSettings(
        method="lm-rls",
        forgetting=0.97,
        tau_lambda_s=10.0,
        initial_covariance=1.0e4,
        settle_periods=0,
        gate=0.0,
        output_scale=1.0,
        input_scale=1.0,
        start_at_nominal=False,
    )
    assert settings.supervision == SupervisionLimits(90, -math.inf, math.inf, revokes=False)


def test_a_refused_estimate_ends_the_trust_in_the_exact_design_alone() -> None:
    assert controller_settings(parse()).supervision.revokes
    assert not controller_settings(parse(load__design='"paper"')).supervision.revokes


def test_rho_left_out_is_that_of_the_design_and_of_the_load() -> None:
    def forgetting(name: str, **changes: str) -> float:
        path = EXAMPLES / name
        tables = tomllib.loads(path.read_text("utf-8"))
        tables["estimator"].pop("forgetting", None)
        tables["load"].update(changes)
        return controller_settings(validate_configuration(tables, path)).learning.forgetting

    assert forgetting("motor.toml") == 0.985
    assert forgetting("motor.toml", design="paper") == 0.97
    assert forgetting("bath.toml", design="paper") == 0.99


@pytest.mark.parametrize(
    ("clock_ticks", "timeout_s", "longest_s"),
    [("1", "5.0", 5.0), ("1", "0.1", 2.0), ("60", "5.0", 11.0)],
)
def test_a_start_waits_for_its_rate_as_long_as_a_steady_drive_may_take_to_show_it(
    clock_ticks: str, timeout_s: str, longest_s: float
) -> None:
    configuration = parse(
        **HELD,
        bus__clock_ticks=clock_ticks,
        load__latency_ticks=clock_ticks,
        interlocks__precharge_timeout_s=timeout_s,
        interlocks__stale_s="1.0",
    )
    assert machine_limits(configuration).rate_s == pytest.approx(longest_s)
