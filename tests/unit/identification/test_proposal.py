"""`[load.model]` from an identified load: values against closed forms, deviations against draws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from adaptdrive.config import load_configuration
from adaptdrive.control.signals import Estimate
from adaptdrive.identification import identify, proposed_model
from adaptdrive.identification.result import IdentifiedLoad
from tests.unit.devices.bench import EXAMPLES
from tests.unit.identification.plants import KINDS
from tests.unit.identification.test_identify import recorded


def with_parameters(kind: str, values: list[float], covariance: np.ndarray) -> IdentifiedLoad:
    plant = KINDS[kind](np.random.default_rng(1))
    found = identify([recorded(plant, 1, 0.05)], plant.structure, longest_delay=0)
    deviations = np.sqrt(np.diag(covariance)).tolist()
    parameters = {
        name: Estimate(value, std)
        for name, value, std in zip(plant.structure.names, values, deviations, strict=True)
    }
    return replace(found, parameters=parameters, covariance=covariance)


def test_a_motor_has_the_two_time_constants_of_its_sum_and_product() -> None:
    section = load_configuration(EXAMPLES / "motor.toml").load
    covariance = np.diag([1e-8, 0.04, 9.0])
    model = proposed_model(with_parameters("motor", [0.01, 45.1, 351.0], covariance), section)
    assert model["tau_motor_s"].value == pytest.approx(35.1)
    assert model["tau_filter_s"].value == pytest.approx(10.0)
    draws = np.random.default_rng(2).multivariate_normal([45.1, 351.0], covariance[1:, 1:], 4000)
    gaps = np.sqrt(0.25 * draws[:, 0] ** 2 - draws[:, 1])
    spread = (0.5 * draws[:, 0] + gaps).std()
    assert model["tau_motor_s"].std == pytest.approx(spread, rel=0.5)


def test_a_complex_pair_becomes_two_equal_time_constants_with_a_wide_interval() -> None:
    section = load_configuration(EXAMPLES / "motor.toml").load
    covariance = np.diag([1e-8, 0.04, 4.0])
    model = proposed_model(with_parameters("motor", [0.01, 20.0, 101.0], covariance), section)
    assert model["tau_motor_s"].value == model["tau_filter_s"].value == 10.0
    assert 1.0 < model["tau_motor_s"].std < 3.0  # the root of its uncertainty of 2 s²


def test_a_battery_has_the_resistances_behind_its_admittances() -> None:
    section = load_configuration(EXAMPLES / "battery.toml").load
    covariance = np.diag([1e-8, 1e-8, 0.01])
    values = [0.25 / 1.2, 0.25 / 1.6, 22.5]
    model = proposed_model(with_parameters("battery", values, covariance), section)
    assert model["internal_Ohm"].value == pytest.approx(0.2)
    assert model["relaxation_Ohm"].value == pytest.approx(0.4)
    assert model["relaxation_s"].value == pytest.approx(30.0)
    draws = np.random.default_rng(3).multivariate_normal(values, covariance, 4000)
    assert model["internal_Ohm"].std == pytest.approx((0.25 / draws[:, 0]).std(), rel=0.1)
