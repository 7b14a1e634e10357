"""Disks that land on the turning shaft at rest share its momentum, as in the paper's experiment."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest

from adaptdrive_sim.course import Run
from adaptdrive_sim.experiments.case import convergence_cycles, estimate_moves, run_case
from adaptdrive_sim.experiments.experiment import DROPPED, MOTOR, Experiment, LoadChange
from adaptdrive_sim.experiments.reproduce import find_experiment
from tests.unit.simulators.experiments.cases import make_case

FILTER_S = 10.0


@cache
def adaptive(experiment: Experiment, seed: int = 81_100) -> Run:
    return run_case(make_case(experiment, "adaptive", seed=seed), keep_ticks=True)


def shaft_speed(record: Run, tick: int) -> float:
    """Speed in tachometer volts, from the filtered one: tau dy/dt + y."""
    y = record.fast_output
    return FILTER_S * (y[tick + 1] - y[tick]) * 120.0 + y[tick]


def test_it_is_what_reproduce_runs_unless_the_speed_is_to_stay() -> None:
    assert find_experiment("motor", keep_speed=False) is DROPPED
    assert find_experiment("motor", keep_speed=True) is MOTOR


@pytest.mark.parametrize(("experiment", "shares"), [(DROPPED, (1 / 2, 2 / 3)), (MOTOR, (1, 1))])
def test_the_speed_drops_as_the_angular_momentum_is_shared(
    experiment: Experiment, shares: tuple[float, float]
) -> None:
    changes = LoadChange(60.0, 2.0), LoadChange(100.0, 3.0)
    record = adaptive(replace(experiment, duration_s=120.0, changes=changes))
    for change, share in zip(changes, shares, strict=True):
        at = round(120 * change.time_s)
        before, after = (shaft_speed(record, at + tick) for tick in (-4, 1))
        assert after == pytest.approx(share * before, rel=0.01)


@pytest.mark.proof
def test_only_then_does_each_disk_disturb_the_estimate_of_the_gain() -> None:
    moves = estimate_moves(DROPPED, adaptive(DROPPED))
    assert min(moves.values()) > 0.10
    kept = estimate_moves(MOTOR, adaptive(MOTOR))
    assert kept["gain"] < 0.02
    assert min(kept["tau_sum_s"], kept["tau_product_s2"]) > 0.10


@pytest.mark.proof
def test_the_estimates_are_right_again_after_approximately_two_cycles() -> None:
    found = [convergence_cycles(DROPPED, adaptive(DROPPED), one) for one in DROPPED.changes]
    assert all(one is not None and 1.0 < one < 3.0 for one in found)
