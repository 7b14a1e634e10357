"""Shown intervals hold what they claim, on runs that nothing was tuned to."""

from __future__ import annotations

import pytest

from tools.benchmarks.calibration import Samples, coverage, run_all

SEEDS = range(31_001, 31_041)
LEAST = {
    "before a change": 0.90,
    "20–40 s": 0.70,
    "40–60 s": 0.85,
    "60–120 s": 0.90,
    "later": 0.90,
    "all": 0.90,
}


@pytest.fixture(scope="module")
def samples() -> Samples:
    return run_all("standard.toml", SEEDS)


@pytest.mark.proof
@pytest.mark.parametrize("trusted", [False, True])
def test_shown_intervals_hold_the_truth_after_changes(samples: Samples, *, trusted: bool) -> None:
    found = coverage(samples.trusted() if trusted else samples)
    for phase, least in LEAST.items():
        *shares, count = found[phase]
        assert count > 500, phase
        assert min(shares) >= least, (phase, shares)
