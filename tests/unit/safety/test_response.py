"""The lowest output of any load of the kind, against loads that scipy integrates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adaptdrive.app.loads import response_limits
from adaptdrive.config import load_configuration
from adaptdrive.safety.plausibility import Response, ResponseLimits
from tests.unit.devices.bench import EXAMPLES
from tests.unit.runtime.bench import CALM

TICK_s = 1.0 / 120.0
FACTORS = st.floats(0.3, 3.0)


def limits(example: str) -> ResponseLimits:
    found = response_limits(load_configuration(EXAMPLES / f"{example}.toml"))
    assert found is not None
    return found


MOTOR, BATTERY = limits("motor"), limits("battery")


def first_complaint(
    given: ResponseLimits,
    outputs: Sequence[float],
    voltages_V: Sequence[float],
    powers_W: Sequence[float] | None = None,
    period_s: float = TICK_s,
) -> tuple[float, str]:
    """When something was said, and what; infinity for never."""
    watch = Response(given)
    powers_W = powers_W if powers_W is not None else [300.0] * len(outputs)
    for number, (output, voltage_V, power_W) in enumerate(
        zip(outputs, voltages_V, powers_W, strict=True)
    ):
        reading = replace(
            CALM,
            arrival_s=number * period_s,
            output=float(output),
            boost_voltage_V=float(voltage_V),
            load_power_W=float(power_W),
        )
        said = watch.find_cause(reading)
        if said:
            return number * period_s, said.text
    return math.inf, ""


def motor(
    voltages_V: Sequence[float], torques_V: Sequence[float], pieces: Sequence[tuple[float, ...]]
) -> list[float]:
    """A motor whose gain and lags jump from piece to piece, by small steps of Euler's method."""
    speed = output = 0.0
    outputs, length = [], len(voltages_V) // len(pieces) + 1
    for number, (voltage_V, torque_V) in enumerate(zip(voltages_V, torques_V, strict=True)):
        gain, first, second = pieces[number // length]
        target = max(0.0, gain * 0.011 * (voltage_V - torque_V))
        speed += (target - speed) * 0.05 / (first * 11.7)
        output += (speed - output) * 0.05 / (second * 10.0)
        outputs.append(output)
    return outputs


@settings(max_examples=30)
@given(
    pieces=st.lists(st.tuples(FACTORS, FACTORS, FACTORS), min_size=1, max_size=5),
    levels=st.lists(st.floats(200.0, 400.0), min_size=1, max_size=6),
    torques=st.lists(st.floats(0.0, 20.0), min_size=1, max_size=6),
)
def test_no_load_of_the_kind_is_suspected(
    pieces: list[tuple[float, ...]], levels: list[float], torques: list[float]
) -> None:
    """Gain and both lags wrong by up to 3 and jumping, torques, any boost voltage."""
    voltages = np.resize(np.repeat(levels, 700), 4000)
    torque = np.resize(np.repeat(torques, 900), 4000)
    outputs = motor(voltages.tolist(), torque.tolist(), pieces)
    noise = np.random.default_rng(1).normal(0.0, 0.01, 4000)
    assert first_complaint(MOTOR, (outputs + noise).tolist(), voltages.tolist(), period_s=0.05) == (
        math.inf,
        "",
    )


def test_a_sensor_of_the_wrong_sign_is_noticed_before_a_tenth_of_the_range() -> None:
    voltages = [400.0] * 1200
    outputs = motor(voltages, [0.0] * 1200, [(1.0, 1.0, 1.0)])
    when_s, said = first_complaint(MOTOR, [-one for one in outputs], voltages, period_s=0.05)
    assert outputs[round(when_s / 0.05)] < 0.45
    assert said.startswith("no response: speed = -0.")


@pytest.mark.parametrize("tau_s", [3.0, 10.0, 30.0])
def test_a_tachometer_that_decays_at_full_voltage_is_noticed(tau_s: float) -> None:
    """Behind an RC filter, after a minute at 3 V; the controller answers with 400 V."""
    before, after = [273.0] * 7200, [400.0] * 14_400
    decay = [3.0 * math.exp(-number * TICK_s / tau_s) for number in range(14_400)]
    when_s, said = first_complaint(MOTOR, [3.0] * 7200 + decay, before + after)
    assert when_s - 60.0 < 3.0 * tau_s + 5.0
    assert said.startswith("no response: speed ")


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_a_fall_that_no_load_makes_is_noticed_at_once(share: float) -> None:
    outputs = [3.0] * 240 + [share * 3.0] * 240
    when_s, said = first_complaint(MOTOR, outputs, [273.0] * 480)
    assert 2.0 < when_s < 2.5
    assert said.startswith("no response: speed fell to ")


def test_a_current_is_compared_with_the_power_over_the_voltage() -> None:
    """10 A behind a ratio of 0.25 at 320 V are 800 W."""
    powers, voltages = [800.0] * 1200, [320.0] * 1200
    assert first_complaint(BATTERY, [10.0] * 1200, voltages, powers) == (math.inf, "")
    for wrong in (0.0, -10.0):
        when_s, said = first_complaint(BATTERY, [wrong] * 1200, voltages, powers)
        assert when_s < 8.0
        assert said.startswith("no response: current = ")


def test_a_bath_that_is_colder_than_its_inflow_is_believed() -> None:
    outputs = [-4.0] * 600
    assert first_complaint(limits("bath"), outputs, [200.0] * 600) == (math.inf, "")


def test_the_same_reading_again_is_no_news() -> None:
    watch = Response(MOTOR)
    assert watch.find_cause(replace(CALM, arrival_s=1.0, output=3.0)) is None
    again = replace(CALM, arrival_s=1.0, output=-3.0)
    assert {watch.find_cause(again) for _ in range(1000)} == {None}


def test_after_a_pause_it_begins_anew() -> None:
    watch = Response(MOTOR)
    watch.find_cause(replace(CALM, arrival_s=1.0, output=4.0))
    watch.forget()
    assert watch.find_cause(replace(CALM, arrival_s=60.0, output=0.1)) is None
    assert watch.find_cause(replace(CALM, arrival_s=60.1, output=0.1)) is None


def test_a_current_that_ends_with_its_power_is_believed() -> None:
    powers, outputs = [800.0] * 1200 + [0.0] * 600, [10.0] * 1200 + [0.0] * 600
    assert first_complaint(BATTERY, outputs, [320.0] * 1800, powers) == (math.inf, "")
