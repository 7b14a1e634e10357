"""A frozen output is noticed, and an honest one that rests or is coarse is not."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from adaptdrive.app.loads import stillness_limits
from adaptdrive.config import load_configuration
from adaptdrive.safety.plausibility import Stillness, StillnessLimits, StillnessWatch
from adaptdrive.util.quantity import Display
from tests.unit.devices.bench import EXAMPLES
from tests.unit.runtime.bench import CALM

TICK_s = 1.0 / 120.0
GAIN, LAGS_s = 0.011, (11.7, 10.0)
LIMITS = StillnessLimits(Display("V"), GAIN, 1.0, 1, LAGS_s, distance=0.225, longest_s=math.inf)


def first_complaint(
    limits: StillnessLimits, outputs: np.ndarray, voltages: np.ndarray
) -> tuple[float, str]:
    """When something was said, and what; infinity for never."""
    watch = Stillness(limits, "output stands", limits.display)
    for number, (output, voltage) in enumerate(zip(outputs, voltages, strict=True)):
        said = watch.advance(float(output), float(voltage), number * TICK_s)
        if said:
            return number * TICK_s, said.text
    return math.inf, ""


def response(voltages: np.ndarray, inertia: float = 1.0) -> np.ndarray:
    """What the motor really does, by scipy; `inertia` in multiples of that of the model."""
    plant = signal.TransferFunction([GAIN], np.polymul([inertia * 11.7, 1.0], [10.0, 1.0]))
    times = np.arange(len(voltages)) * TICK_s
    start = voltages[0]
    moved: np.ndarray = signal.lsim(plant, voltages - start, times)[1]
    total: np.ndarray = np.asarray(moved, dtype=float) + GAIN * start
    return total


def test_a_frozen_output_is_noticed_when_scipy_has_it_moved_that_far() -> None:
    voltages = np.full(3600, 300.0)
    voltages[120:] = 380.0
    moved = response(voltages) - response(voltages)[0]
    due_s = float(np.argmax(moved > LIMITS.distance)) * TICK_s
    when_s, said = first_complaint(LIMITS, np.full(3600, 3.3), voltages)
    assert when_s == pytest.approx(due_s, abs=0.02)
    assert said.startswith("stuck: output stands at exactly 3.3 V for ")
    assert "should have moved by 0.22" in said


@settings(max_examples=20)
@given(
    st.sampled_from([0.0, 1e-6, 0.001, 0.02]),
    st.floats(1.0, 3.0),
    st.lists(st.floats(200.0, 400.0), min_size=1, max_size=4),
)
def test_an_honest_output_is_believed_whatever_the_voltage_does(
    count: float, inertia: float, levels: list[float]
) -> None:
    voltages = np.repeat([300.0, *levels], 1200)
    outputs = response(voltages, inertia)
    if count:
        outputs = np.round(outputs / count) * count
    assert first_complaint(LIMITS, outputs, voltages) == (math.inf, "")


def test_a_coarse_output_at_rest_is_believed_for_a_night_though_the_model_is_wrong() -> None:
    """At rest far from where the model would have it, with a voltage that is never quite still."""
    generator = np.random.default_rng(1)
    voltages = 300.0 + generator.normal(0.0, 1.0, 30_000)
    assert first_complaint(LIMITS, np.full(30_000, 2.0), voltages) == (math.inf, "")


@pytest.mark.parametrize("levels", [[300.0, 200.0], [300.0, 400.0, 200.0]])
def test_a_sensor_of_few_digits_is_believed_where_its_digit_is_known(levels: list[float]) -> None:
    """With a digit of 4 % of the range, and a motor of three times the inertia of its model."""
    voltages = np.repeat(levels, 2400)
    outputs = np.round(response(voltages, 3.0) / 0.2) * 0.2
    assert first_complaint(LIMITS, outputs, voltages)[0] < 60.0
    assert first_complaint(replace(LIMITS, resolution=0.2), outputs, voltages) == (math.inf, "")


def test_a_frozen_sensor_is_noticed_after_twenty_digits_where_its_digit_is_known() -> None:
    voltages = np.repeat([300.0, 380.0], [120, 3480])
    moved = response(voltages) - response(voltages)[0]
    due_s = float(np.argmax(moved > 20.0 * 0.02)) * TICK_s
    when_s, _ = first_complaint(replace(LIMITS, resolution=0.02), np.full(3600, 3.3), voltages)
    assert when_s == pytest.approx(due_s, abs=0.02)


def test_a_change_of_one_digit_begins_anew() -> None:
    watch = Stillness(LIMITS, "output stands", Display("V"))
    for number in range(12_000):
        output = 3.3 + 1e-6 * (number // 600)
        assert watch.advance(output, 300.0 + 0.02 * number, number * TICK_s) is None


def test_after_a_pause_it_begins_anew() -> None:
    watch = Stillness(LIMITS, "output stands", Display("V"))
    assert watch.advance(3.3, 200.0, 0.0) is None
    watch.forget()
    assert watch.advance(3.3, 400.0, 600.0) is None
    assert watch.advance(3.3, 400.0, 1200.0) is None


def test_the_same_reading_again_is_no_news() -> None:
    watch = Stillness(LIMITS, "output stands", Display("V"))
    watch.advance(3.3, 300.0, 0.0)
    said = {watch.advance(3.3, 400.0, 1.0) for _ in range(10_000)}
    assert said == {None}


def test_a_noisy_sensor_may_not_stand_still_for_long() -> None:
    limits = replace(LIMITS, distance=math.inf, longest_s=2.0)
    when_s, said = first_complaint(limits, np.full(600, 3.3), np.full(600, 300.0))
    assert when_s == pytest.approx(2.0, abs=2 * TICK_s)
    assert said.endswith("s")


def derived_complaint(hot: np.ndarray, cold: np.ndarray, voltages: np.ndarray) -> tuple[float, str]:
    """When a watch over hot - cold, of which the load moves hot, says something, and what."""
    named = replace(LIMITS, output_name="temperature", display=Display("K"))
    watch = StillnessWatch(replace(named, inputs=("hot",)))
    for number, (warm, cool, voltage) in enumerate(zip(hot, cold, voltages, strict=True)):
        values = {"hot": float(warm), "cold": float(cool)}
        reading = replace(
            CALM,
            arrival_s=number * TICK_s,
            boost_voltage_V=float(voltage),
            output=float(warm - cool),
            other=values,
        )
        said = watch.find_cause(reading)
        if said:
            return number * TICK_s, said.text
    return math.inf, ""


@pytest.mark.parametrize("seed", range(3))
def test_a_frozen_input_of_a_difference_is_noticed_as_soon(seed: int) -> None:
    """The other input is noisy, so that the difference never stands still."""
    generator = np.random.default_rng(seed)
    voltages = np.full(3600, 300.0)
    voltages[120:] = 380.0
    alone_s, _ = first_complaint(LIMITS, np.full(3600, 3.3), voltages)
    cold = 290.0 + generator.normal(0.0, 0.05, 3600)
    when_s, said = derived_complaint(np.full(3600, 293.3), cold, voltages)
    assert when_s == alone_s < 12.0
    assert said.startswith("stuck: hot, from which temperature is derived, stands at exactly 293.3")


def test_an_input_that_the_load_does_not_move_may_stand_still() -> None:
    voltages = np.full(3600, 300.0)
    voltages[120:] = 380.0
    hot = 290.0 + response(voltages)
    assert derived_complaint(hot, np.full(3600, 290.0), voltages) == (math.inf, "")


@pytest.mark.parametrize("example", ["motor", "bath", "battery", "bath-thermocouples"])
def test_the_limits_come_from_the_configuration(example: str) -> None:
    configuration = load_configuration(EXAMPLES / f"{example}.toml")
    load = configuration.load.model_copy(update={"resolution": 0.02})
    limits = stillness_limits(configuration.model_copy(update={"load": load}))
    assert limits is not None
    share = math.inf if example == "battery" else 0.05
    assert limits.distance == pytest.approx(share * (load.reference_max - load.reference_min))
    assert limits.resolution == 0.02
    assert limits.inputs == (("bath_temperature",) if "thermo" in example else ())
    if example == "motor":
        assert limits.gain == pytest.approx(GAIN)
        assert sum(limits.lags_s) == pytest.approx(sum(LAGS_s))
    interlocks = configuration.interlocks.model_copy(update={"stuck_distance": 0.0})
    assert stillness_limits(configuration.model_copy(update={"interlocks": interlocks})) is None
