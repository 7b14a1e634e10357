"""Identification against loads that scipy simulates, in open and in closed loop."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from adaptdrive.control.loads.battery import battery_load
from adaptdrive.control.loads.motor import motor_load
from adaptdrive.identification import identify
from adaptdrive.identification.excerpt import Excerpt
from adaptdrive.identification.result import IdentifiedLoad
from adaptdrive.util.errors import IdentificationError
from tests.support import sample
from tests.unit.identification.plants import (
    KINDS,
    Plant,
    charging,
    closed_loop,
    open_loop,
    random_voltage,
)

PERIOD_s = 0.5
COUNT = 800


def scores(identified: IdentifiedLoad, plant: Plant) -> list[float]:
    """Errors of the parameters in their claimed deviations."""
    found = identified.parameters.values()
    return [(one.value - true) / one.std for one, true in zip(found, plant.parameters, strict=True)]


def recorded(plant: Plant, seed: int, noise: float, delay: int = 0) -> Excerpt:
    random = np.random.default_rng(seed)
    volts = random_voltage(random, COUNT)
    output = open_loop(plant.truth, volts, PERIOD_s, delay)
    noise_std = noise * float(output.std())
    return Excerpt(volts, output + noise_std * random.normal(size=COUNT), PERIOD_s)


@pytest.mark.parametrize("kind", KINDS)
def test_a_load_is_found_within_its_interval(kind: str) -> None:
    plant = KINDS[kind](np.random.default_rng(0))
    excerpt = recorded(plant, 1000, noise=0.05, delay=2)
    assert np.abs(scores(identify([excerpt], plant.structure), plant)).max() < 3.0


@pytest.mark.proof
@pytest.mark.parametrize("kind", KINDS)
def test_intervals_hold_what_they_claim(kind: str) -> None:
    errors = []
    for seed in range(60):
        plant = KINDS[kind](np.random.default_rng(seed))
        excerpt = recorded(plant, seed + 1000, noise=0.05, delay=seed % 4)
        errors += scores(identify([excerpt], plant.structure), plant)
    inside = np.mean(np.abs(errors) < 1.96)
    assert 0.90 <= inside <= 0.99


def looped(plant: Plant, seed: int, colour: float) -> Excerpt:
    """A motor under feedback, whose noise is white or drifts."""
    random = np.random.default_rng(seed)
    gain, *_ = plant.parameters
    steps = 300.0 * gain + 40.0 * gain * np.repeat(random.choice([-1.0, 1.0], size=40), 30)
    shocks = 2.0 * gain * random.normal(size=len(steps))
    noise = lfilter([1.0], [1.0, -colour], shocks)
    return closed_loop(plant.truth, steps, noise, PERIOD_s, (2.0 / gain, 0.1 / gain))


@pytest.mark.proof
@pytest.mark.parametrize("colour", [0.0, 0.8])
def test_feedback_of_the_noise_leaves_no_bias(colour: float) -> None:
    errors = []
    for seed in range(80):
        plant = KINDS["motor"](np.random.default_rng(seed))
        excerpt = looped(plant, seed + 2000, colour)
        errors.append(scores(identify([excerpt], plant.structure, longest_delay=0), plant))
    assert 0.90 <= np.mean(np.abs(errors) < 1.96) <= 0.99
    assert np.abs(np.mean(errors, axis=0)).max() < 3.0 / np.sqrt(80)


def test_a_direct_difference_of_samples_would_be_biased_in_that_loop() -> None:
    """Least squares on the same record miss the load by far more than they claim."""
    plant = KINDS["motor"](np.random.default_rng(1))
    excerpt = looped(plant, 2001, 0.0)
    y, u = excerpt.output - excerpt.output.mean(), excerpt.boost_voltage_V - 300.0
    rows = np.column_stack((y[1:-1], y[:-2], u[2:], u[1:-1], u[:-2]))
    theta = np.linalg.lstsq(rows, y[2:])[0]
    gain = theta[2:].sum() / (1.0 - theta[0] - theta[1])
    true = plant.parameters[0]
    found = identify([excerpt], plant.structure, longest_delay=0).parameters["gain"]
    assert abs(found.value - true) < 3.0 * found.std
    assert abs(gain - true) > 10.0 * found.std


@pytest.mark.parametrize("delay", sample([0, 3, 1, 2], 2))
def test_the_dead_time_is_found(delay: int) -> None:
    plant = KINDS["battery"](np.random.default_rng(3))
    found = identify([recorded(plant, 4, 0.01, delay)], plant.structure)
    assert found.delay_s == pytest.approx(delay * PERIOD_s, abs=3.5 * found.delay_std_s)
    assert found.delay_std_s < 0.02 * PERIOD_s
    assert found.fit > 0.95
    assert found.cross_fit > 0.95
    assert found.whiteness > 0.01


@pytest.mark.parametrize("tau_s", sample([2.5, 5.0, 10.0], 1))
def test_a_simulation_begins_as_the_output_where_the_noise_is_as_slow_as_the_load(
    tau_s: float,
) -> None:
    random = np.random.default_rng(0)
    volts = np.repeat(random.choice([400.0, 520.0], size=15), 100)
    output = open_loop(motor_load(0.28, tau_s, 0.2), volts, 0.1)
    slow = [1.0, -np.exp(-0.1 / tau_s)]
    output = output + lfilter([1.0], slow, 0.07 * random.normal(size=len(volts)))
    found = identify([Excerpt(volts, output, 0.1)], motor_load(1.0, 1.0, 1.0), longest_delay=0)
    assert found.fit > 0.95
    assert found.simulated[0][0] == pytest.approx(output[0], abs=2.0)


def test_blocks_give_the_same_load() -> None:
    plant = KINDS["motor"](np.random.default_rng(5))
    excerpt = recorded(plant, 6, 0.02)
    fine, coarse = (identify([excerpt], plant.structure, block=n) for n in (1, 4))
    for name, one in fine.parameters.items():
        other = coarse.parameters[name]
        assert other.value == pytest.approx(one.value, abs=3.0 * np.hypot(one.std, other.std))
    assert coarse.block_s == 4 * PERIOD_s


def test_parts_of_a_record_are_fitted_together() -> None:
    plant = KINDS["bath"](np.random.default_rng(7))
    whole = recorded(plant, 8, 0.02)
    rows = [slice(0, 300), slice(400, 800)]
    parts = [Excerpt(whole.boost_voltage_V[at], whole.output[at], PERIOD_s) for at in rows]
    found = identify(parts, plant.structure)
    assert np.abs(scores(found, plant)).max() < 3.5
    assert [len(part) for part in found.residuals] == [289, 389]


def test_an_input_that_nobody_measures_is_an_offset() -> None:
    load = motor_load(0.011, 11.7, 10.0)
    random = np.random.default_rng(9)
    volts = random_voltage(random, COUNT)
    output = open_loop(load, volts, PERIOD_s, offset=-25.0) + 0.01 * random.normal(size=COUNT)
    found = identify([Excerpt(volts, output, PERIOD_s)], motor_load(1.0, 1.0, 1.0))
    assert found.input_offset.value == pytest.approx(-25.0, abs=3.0 * found.input_offset.std)
    assert found.input_offset.std < 5.0


@pytest.mark.parametrize("bent", sample([0.1, 0.0], 1))
def test_the_rising_voltage_of_a_battery_is_no_dynamics(bent: float) -> None:
    """The curve of charge to voltage is straight, or bent in its middle."""
    truth = battery_load(0.25, 1.2, 0.4, 30.0)
    random = np.random.default_rng(10)
    volts = 300.0 + 0.2 * (random_voltage(random, 1200) - 300.0)
    output = np.zeros(1200)
    for _ in range(25):  # the charge depends on the current, which depends on the charge
        charge = np.cumsum(output) * PERIOD_s + 1e-9
        rise_V = 2e-3 * (charge + bent * charge[-1] * np.sin(np.pi * charge / charge[-1]))
        output = open_loop(truth, volts + 60.0 - rise_V / 0.25, PERIOD_s, offset=-300.0)
    noisy = output + 0.01 * random.normal(size=1200)
    structure = battery_load(0.25, 9.0, 9.0, 9.0, charging())
    found = identify([Excerpt(volts, noisy, PERIOD_s)], structure, longest_delay=0)
    assert np.abs(scores(found, Plant(structure, truth))).max() < 3.5
    assert found.whiteness > 0.01


def test_what_the_noise_hides_has_a_wide_interval() -> None:
    plant = KINDS["motor"](np.random.default_rng(11))
    clear, hidden = (
        identify([recorded(plant, 12, noise)], plant.structure) for noise in (0.01, 0.3)
    )
    for name, one in clear.parameters.items():
        assert hidden.parameters[name].std > 10.0 * one.std


@pytest.mark.parametrize(
    ("volts", "output", "problem"),
    [
        (np.full(200, 300.0), np.full(200, 3.0), "moves too little"),
        (np.full(200, 300.0), np.full(199, 3.0), "199 outputs, but 200"),
        (np.full(20, 300.0), np.full(20, 3.0), "30 are needed"),
        (np.array([300.0, np.nan]), np.zeros(2), r"boost_voltage_V\[1\]"),
    ],
)
def test_data_that_show_nothing_are_refused(
    volts: np.ndarray, output: np.ndarray, problem: str
) -> None:
    with pytest.raises(IdentificationError, match=problem):
        identify([Excerpt(volts, output, 1.0)], motor_load(1.0, 1.0, 1.0))
