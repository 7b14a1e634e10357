"""The run in virtual time: deterministic, and with the daemon's own order of calls."""

import dataclasses

import numpy as np
import pytest

from adaptdrive_sim.experiments.case import run_case
from adaptdrive_sim.experiments.experiment import MOTOR, Experiment, LoadChange
from adaptdrive_sim.world import NoiseParameters
from tests.unit.simulators.experiments.cases import make_case

SHORT: Experiment = dataclasses.replace(
    MOTOR, duration_s=30.0, changes=(LoadChange(20.0, 2.0),), noise=0.01
)


def test_the_same_seed_gives_the_same_record_and_another_one_does_not() -> None:
    first, again, other = (run_case(make_case(SHORT, "adaptive", seed=seed)) for seed in (5, 5, 6))
    assert first.trace.tobytes() == again.trace.tobytes()
    assert repr(first.decisions) == repr(again.decisions)
    assert repr(first.decisions) != repr(other.decisions)


def test_all_controllers_of_one_seed_see_the_same_noise() -> None:
    fixed, direct = (run_case(make_case(SHORT, name)) for name in ("fixed", "direct_rls"))
    assert np.array_equal(fixed["measured"], direct["measured"])


def test_every_slow_period_is_recorded_once_from_its_first_tick_on() -> None:
    record = run_case(make_case(SHORT, "adaptive"), keep_ticks=True)
    assert record["time_s"].tolist() == [float(k) for k in range(30)]
    assert len(record.fast_output) == len(record.fast_voltage_V) == 3600
    assert record["output"].tolist() == list(record.fast_output[::120])
    assert record["size"].tolist() == [1.0] * 20 + [2.0] * 10


@pytest.mark.parametrize("latency", [1, 2, 5])
def test_a_decision_takes_effect_after_the_latency(latency: int) -> None:
    """The loop's sum leaves out the present sample, the drive latches, the half cycle runs: 3."""
    tables = SHORT.tables()
    tables["load"]["latency_ticks"] = latency
    late = dataclasses.replace(SHORT, tables=lambda: tables)
    record = run_case(make_case(late, "fixed", disturbance=NoiseParameters(0.0)), keep_ticks=True)
    rest_V = record.fast_voltage_V[0]
    moved = [abs(voltage - rest_V) > 0.1 for voltage in record.fast_voltage_V[:20]]
    assert moved.index(True) == latency + 3
