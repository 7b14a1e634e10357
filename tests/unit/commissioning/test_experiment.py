"""The experiment on loads that it knows nothing about, in virtual time."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from adaptdrive.commissioning.course import ExperimentCourse, Phase, Target
from adaptdrive.commissioning.experiment import load_experiment
from adaptdrive.util.errors import CommissionError
from tests.support import sample
from tests.unit.commissioning.draws import KINDS, Rig, encoder_motor, finish
from tests.unit.commissioning.trials import BAND, trial, trial_of

SAMPLE_S = 0.1
TARGET = Target(
    low_V=200.0,
    high_V=400.0,
    output_max=4.5,
    move=0.2,
    first_gain=0.02,
    input_gain=1.0,
    input_exponent=1,
    patience_s=10.0,
    name="speed",
    unit="V",
)


Follow = Callable[[float], float]
"""A load: from V_c to the output of the next sample."""


def lag(gain: float, tau_s: float, noise: float = 0.0) -> Follow:
    """A load of first order that rests at 200 V: from V_c to the output of the next sample."""
    random, state = np.random.default_rng(0), [gain * 200.0]

    def follow(voltage_V: float) -> float:
        state[0] += (gain * voltage_V - state[0]) * -math.expm1(-SAMPLE_S / tau_s)
        return state[0] + noise * float(random.standard_normal())

    return follow


def run(load: Follow, target: Target = TARGET) -> tuple[ExperimentCourse, list[float]]:
    """Run an experiment on a drive that follows V_c at once."""
    experiment, voltages, time_s = load_experiment(target), [target.low_V], 0.0
    while not experiment.done:
        time_s += SAMPLE_S
        voltages.append(experiment.take(time_s, voltages[-1], load(voltages[-1])))
    return experiment, voltages


@pytest.mark.parametrize(
    ("kind", "seeds"),
    sample(
        [("motor", range(1)), ("bath", range(1)), *((kind, range(6)) for kind in KINDS)],
        1,
    ),
)
def test_unknown_loads_are_identified_within_the_stated_band(kind: str, seeds: range) -> None:
    trials = [trial(kind, seed) for seed in seeds]
    assert [one.refusal for one in trials if one.refusal] == []
    assert sum(one.right for one in trials) >= max(1, len(seeds) - 1)
    assert max(one.peak for one in trials) <= BAND[1]
    loops = [one.loop for one in trials if one.loop is not None]
    assert max(one.pole for one in loops) < 1.0
    assert max(one.error for one in loops) <= 0.1


@pytest.mark.proof
@pytest.mark.parametrize("seed", [0, 1, 3, 4, 5, 8])
def test_a_motor_without_a_filter_is_identified(seed: int) -> None:
    """Its second lag is below any noise: only that it is short can be known, and suffices."""
    random = np.random.default_rng([seed, 15])
    one = trial_of(encoder_motor(random), random)
    assert one.refusal == ""
    assert one.right
    assert one.loop is not None
    assert one.loop.pole < 1.0
    assert one.loop.error <= 0.1


@pytest.mark.parametrize(("gain", "tau_s"), [(0.002, 0.5), (0.01, 5.0), (0.05, 20.0)])
def test_the_output_moves_as_far_as_was_asked_for(gain: float, tau_s: float) -> None:
    target = replace(TARGET, output_max=100.0)
    experiment, voltages = run(lag(gain, tau_s, noise=0.005), target)
    outcome = experiment.outcome
    assert outcome is not None
    assert outcome.gain == pytest.approx(gain, rel=0.1)
    assert outcome.high_V - outcome.low_V == pytest.approx(min(0.2 / outcome.gain, 200.0), rel=1e-9)
    outputs = np.array(experiment.record.outputs) - gain * 200.0
    assert outputs.min() > BAND[0] * target.move
    assert outputs.max() < BAND[1] * target.move
    assert min(voltages) >= target.low_V
    assert max(voltages) <= target.high_V


@pytest.mark.parametrize("gain", sample([0.005, 0.08], 1))
def test_an_output_with_hidden_lags_stays_within_the_band(gain: float) -> None:
    """The lags are many times the wait: the output goes on rising when V_c is taken back."""
    hidden, seen, outputs = lag(1.0, 200.0), lag(gain, 40.0), list[float]()
    random = np.random.default_rng(1)

    def load(voltage_V: float) -> float:
        outputs.append(seen(hidden(voltage_V)))
        return outputs[-1] + 0.05 * float(random.standard_normal())

    target = replace(TARGET, output_max=100.0)
    with suppress(CommissionError):
        run(load, target)
    moved = (np.array(outputs) - gain * 200.0) / target.move
    assert BAND[0] < moved.min()
    assert moved.max() < BAND[1]


def test_the_levels_are_those_of_a_maximum_length_sequence() -> None:
    experiment, voltages = run(lag(0.01, 2.0))
    outcome = experiment.outcome
    assert outcome is not None
    levels = [voltage_V == outcome.high_V for voltage_V in voltages[-400:]]
    assert 0.3 < np.mean(levels) < 0.7
    assert experiment.phase is Phase.DONE


def reversed_sensor() -> Follow:
    forward = lag(0.01, 5.0, noise=0.002)
    return lambda voltage_V: 4.0 - forward(voltage_V)


def drifting() -> Follow:
    time_s, load = iter(range(10**6)), lag(0.01, 5.0)
    return lambda voltage_V: load(voltage_V) - 2.0 + 0.01 * SAMPLE_S * next(time_s)


def changing() -> Follow:
    load, samples = lag(0.01, 2.0), iter(range(10**6))
    return lambda voltage_V: load(voltage_V) + (0.5 if next(samples) > 900 else 0.0)


@pytest.mark.parametrize(
    ("load", "output_max", "reason"),
    [
        (reversed_sensor(), 4.5, "is its sensor reversed?"),
        (lag(1e-5, 5.0, noise=0.002), 4.5, r"^no response: speed moved by .*to 400 V"),
        (lag(0.03, 5.0), 4.5, r"is above load.reference_max = 4.5 V"),
        (drifting(), 100.0, "^speed does not come to rest within "),
        (changing(), 4.5, "left the band"),
    ],
    ids=["reversed", "dead", "out of range", "drifting", "changing"],
)
def test_a_load_that_cannot_be_identified_is_refused(
    load: Follow, output_max: float, reason: str
) -> None:
    with pytest.raises(CommissionError, match=reason):
        run(load, replace(TARGET, output_max=output_max))


def test_a_value_that_is_not_finite_is_refused() -> None:
    with pytest.raises(CommissionError, match="is not finite"):
        load_experiment(TARGET).take(0.1, 200.0, math.nan)


def test_a_full_battery_is_refused() -> None:
    random = np.random.default_rng(0)
    draw = KINDS["battery"](random)
    battery = draw.target.battery
    assert battery is not None
    lower_V = {"voltage_max_V": 0.8 * battery.charge.voltage_max_V}
    full = battery.model_copy(update={"charge": battery.charge.model_copy(update=lower_V)})
    rig, experiment = Rig(draw, random), load_experiment(replace(draw.target, battery=full))
    with pytest.raises(CommissionError, match=r"is too full for the experiment"):
        finish(experiment, rig)


@pytest.mark.parametrize("seed", sample([2, 5, 6], 1))
def test_a_drive_that_follows_late_moves_a_battery_no_further(seed: int) -> None:
    """Each voltage is in force half a second after it was asked for; the wait is short."""
    random = np.random.default_rng([seed, 15])
    draw = KINDS["battery"](random)
    experiment = load_experiment(replace(draw.target, patience_s=4.0))
    rig = Rig(draw, random, noise_share=0.001)
    asked = deque([draw.target.low_V] * 5)
    while not experiment.done:
        asked.append(experiment.voltage_V)
        experiment.take(*rig.sample(asked.popleft()))
        if math.isnan(rig.rest) and experiment.phase is Phase.CLIMB:
            rig.begin()
    assert rig.movement[1] < 1.05
