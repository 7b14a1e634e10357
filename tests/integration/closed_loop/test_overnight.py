"""Left alone: hours without excitation, and a load that is not in the model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from adaptdrive.app.settings import controller_settings
from adaptdrive.config import load_configuration
from adaptdrive.control.signals import Measurement, Mode
from adaptdrive_sim.world import NoiseParameters
from tests.integration.closed_loop.bench import HIGH, LOW, STEP, Bench, CYCLE_s, order, square_wave
from tests.support import sample
from tests.unit.control.learning import dense

DAEMON = controller_settings(
    load_configuration(Path(__file__).parents[3] / "deploy/examples/motor.toml")
)
NOISE = NoiseParameters(sigma=0.002 * STEP)
TRUTH = {"gain": 0.011, "tau_sum_s": 21.7, "tau_product_s2": 117.0}


def covariance_trace(bench: Bench) -> float:
    return float(np.trace(dense(bench.controller.state.estimator.estimate)))


class QuantisedBench(Bench):
    """The bench behind the bus of the reference drive, which carries steps of 10 mV of v_bst."""

    def measurement(self) -> Measurement:
        exact = super().measurement()
        return replace(
            exact,
            boost_voltage_V=round(exact.boost_voltage_V, 2),
            line_voltage_V=round(exact.line_voltage_V, 1),
            load_power_W=round(exact.load_power_W, 1),
            output=round(exact.output, 6),
        )


@pytest.mark.parametrize("bias", sample([True, False], 1))
def test_at_rest_without_noise_the_adaptive_controller_stays_trusted(bias: bool) -> None:
    bench = QuantisedBench(replace(DAEMON, learning=replace(DAEMON.learning, bias=bias)))
    for second in range(90):
        wave = LOW + 0.1 if second % 40 < 20 else LOW - 0.1
        bench.run(1.0, order(wave, Mode.ADAPTIVE))
    bench.run(300.0, order(LOW, Mode.ADAPTIVE))
    rest = bench.decisions[-200:]
    assert all(one.controller is Mode.ADAPTIVE for one in rest), rest[-1].reason
    assert max(abs(one.handover_step_V) for one in rest[-100:]) < 1.0


def excited_bench() -> Bench:
    """Two cycles of the square wave, so that the adaptive controller is in force."""
    bench = Bench(DAEMON, noise=NOISE)
    for second in range(2 * CYCLE_s):
        bench.run(1.0, order(square_wave(second), Mode.ADAPTIVE))
    assert bench.decisions[-1].controller is Mode.ADAPTIVE
    return bench


def response_to_a_disk(bench: Bench) -> tuple[float, float]:
    """One more disk, then two cycles of the wave: overshoot of the second one, largest hand-over
    step in the first ten seconds."""
    bench.motor.disks = 2
    outputs = []
    start = len(bench.decisions)
    for second in range(2 * CYCLE_s):
        bench.run(1.0, order(square_wave(second), Mode.ADAPTIVE))
        outputs.append(bench.world.true_output)
    step_V = max(abs(one.handover_step_V) for one in bench.decisions[start : start + 10])
    last = np.array(outputs[CYCLE_s:])
    half = CYCLE_s // 2
    return float(max(last[:half].max() - HIGH, LOW - last[half:].min()) / STEP), step_V


@pytest.mark.proof
def test_eight_hours_without_excitation_wind_nothing_up() -> None:
    rested = excited_bench()
    rested.run(600.0, order(LOW, Mode.ADAPTIVE))
    after_minutes = covariance_trace(rested)
    overshoot_minutes, step_minutes_V = response_to_a_disk(rested)

    lone = excited_bench()
    traces = []
    for _ in range(8):
        lone.run(3600.0, order(LOW, Mode.ADAPTIVE))
        traces.append(covariance_trace(lone))
    held = [abs(one.handover_step_V) for one in lone.decisions[-3600:]]
    overshoot_hours, step_hours_V = response_to_a_disk(lone)

    assert max(traces) < 10.0 * after_minutes
    assert max(held) < 5.0
    assert step_hours_V < 1.5 * step_minutes_V + 1.0
    assert overshoot_hours < 0.02
    assert overshoot_minutes < 0.02


def test_a_torque_that_is_not_in_the_model_does_not_bias_the_estimates() -> None:
    bench = Bench(
        replace(DAEMON, supervision=replace(DAEMON.supervision, warm_up_periods=60)), noise=NOISE
    )
    worth_20_V = 20.0 * 0.25 * 0.30 / 4.0
    bench.motor.torque_Nm = worth_20_V
    bench.world.settle(bench.world.boost_voltage_for(LOW))
    for second in range(3 * CYCLE_s):
        bench.run(1.0, order(square_wave(second), Mode.ADAPTIVE))
    found = bench.decisions[-1].estimates
    for name, true in TRUTH.items():
        assert found[name].value == pytest.approx(true, rel=0.02), name
    assert found["input_offset"].value == pytest.approx(-20.0, rel=0.05)
