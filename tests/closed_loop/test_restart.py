"""A drive that is enabled while its load still moves: what is learnt must not carry that along."""

from __future__ import annotations

from dataclasses import replace

import pytest

from adaptdrive.control.settings import ControllerSettings
from adaptdrive.control.signals import Mode, Stage
from adaptdrive_sim.noise import NoiseParameters
from tests.closed_loop.bench import STEP, Bench, order
from tests.closed_loop.test_overnight import DAEMON, TRUTH

LOW, HIGH, PERIOD_s, RUN_s = 2.9, 3.2, 60, 400


def largest_trusted_error(settings: ControllerSettings, off_s: float) -> float:
    """Largest relative error of an estimate that was accepted after a while without power."""
    bench = Bench(settings, noise=NoiseParameters(sigma=0.002 * STEP), seed=1)
    bench.run(2.0, order(LOW))
    bench.run(off_s, order(LOW, stage=Stage.OFF))
    bench.run(0.5, order(LOW, stage=Stage.PRECHARGE))
    bench.decisions.clear()
    for second in range(RUN_s):
        wave = HIGH if second % PERIOD_s < PERIOD_s / 2 else LOW
        bench.run(1.0, order(wave, Mode.ADAPTIVE))
    accepted = [one.estimates for one in bench.decisions if one.accepted]
    assert len(accepted) > RUN_s / 2
    return max(
        abs(one[name].value / true - 1.0) for one in accepted for name, true in TRUTH.items()
    )


@pytest.mark.parametrize("off_s", [5.0, 20.0, 60.0])
def test_a_load_that_still_moves_at_the_start_is_learnt_as_it_is(off_s: float) -> None:
    assert largest_trusted_error(DAEMON, off_s) < 0.02


def test_without_its_initial_state_the_load_is_mistaken_for_another() -> None:
    learning = replace(DAEMON.learning, initial_state=False)
    assert largest_trusted_error(replace(DAEMON, learning=learning), 5.0) > 0.1
