"""A drive that is enabled while its load still moves: what is learnt must not carry that along."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from adaptdrive.control.controller import Controller
from adaptdrive.control.settings import ControllerSettings
from adaptdrive.control.signals import Mode, Stage
from adaptdrive.runtime.requests import SetSetpoint
from adaptdrive_sim.plants.bath import Bath, BathParameters
from adaptdrive_sim.world import NoiseParameters
from tests.integration.closed_loop.bench import MOTOR, STEP, Bench, order
from tests.integration.closed_loop.life import load_world, started, wait
from tests.integration.closed_loop.test_overnight import DAEMON
from tests.support import sample

LOW, HIGH, RUN_s = 2.9, 3.2, 240


@dataclass(frozen=True)
class Restart:
    """A motor that was off for a while, and the square wave that it is then given.

    Attributes:
        off_s: How long it was off.
        disks: On its shaft.
        period_s: Of the wave.
        noise: Of each fast sample, over the step.
        seed: Of the noise.
    """

    off_s: float
    disks: int = 1
    period_s: float = 60.0
    noise: float = 0.002
    seed: int = 1

    @property
    def truth(self) -> dict[str, float]:
        motor_s, filter_s = 11.7 * self.disks, 10.0
        product_s2 = motor_s * filter_s
        return {"gain": 0.011, "tau_sum_s": motor_s + filter_s, "tau_product_s2": product_s2}


def drawn(seed: int) -> Restart:
    random = np.random.default_rng(seed)
    return Restart(
        off_s=random.uniform(1.0, 60.0),
        disks=int(random.integers(1, 4)),
        period_s=random.uniform(20.0, 240.0),
        noise=random.uniform(0.0, 0.02),
        seed=seed,
    )


def largest_trusted_error(settings: ControllerSettings, restart: Restart) -> float:
    """Largest relative error of an estimate that was accepted after the restart."""
    noise = NoiseParameters(sigma=restart.noise * STEP)
    bench = Bench(settings, noise=noise, seed=restart.seed)
    bench.motor.disks = restart.disks
    bench.run(60.0, order(LOW))
    bench.run(restart.off_s, order(LOW, stage=Stage.OFF))
    bench.run(0.5, order(LOW, stage=Stage.PRECHARGE))
    bench.decisions.clear()
    for second in range(RUN_s):
        wave = HIGH if second % restart.period_s < restart.period_s / 2 else LOW
        bench.run(1.0, order(wave, Mode.ADAPTIVE))
    accepted = [one.estimates for one in bench.decisions if one.accepted]
    assert len(accepted) > RUN_s / 4
    return max(
        abs(one[name].value / true - 1.0)
        for one in accepted
        for name, true in restart.truth.items()
    )


@pytest.mark.parametrize("off_s", sample([60.0, 5.0, 20.0], 1))
def test_a_load_that_still_moves_at_the_start_is_learnt_as_it_is(off_s: float) -> None:
    assert largest_trusted_error(DAEMON, Restart(off_s)) < 0.02


@pytest.mark.proof
def test_so_is_whatever_motor_after_whatever_break() -> None:
    errors = [largest_trusted_error(DAEMON, drawn(seed)) for seed in range(12)]
    assert np.median(errors) < 0.05
    assert max(errors) < 0.5


def test_without_its_initial_state_the_load_is_mistaken_for_another() -> None:
    """Nor with a second filter, which finds its error at the next alarm."""
    learning = replace(DAEMON.learning, initial_state=False, alert=False)
    assert largest_trusted_error(replace(DAEMON, learning=learning), Restart(20.0)) > 0.1


@pytest.mark.parametrize("shift_K", sample([4.0, 8.0], 1))
def test_a_bath_that_rests_beyond_a_set_point_trips_nothing(shift_K: float) -> None:
    """Its inflow is warmer than where the sensor reads zero, and V_c is at its lowest."""
    bath = Bath(BathParameters())
    world = load_world(bath, noise=0.02)
    world.settle(200.0)
    bath.output += shift_K
    bath.inflow_shift_K = shift_K
    drive = started("bath", world)
    drive.carry_out(SetSetpoint(5.5))
    wait(drive, 900.0)
    assert drive.machine.trip is None


def test_a_load_that_is_lighter_by_now_swings_no_longer_than_until_it_is_learnt() -> None:
    """At a constant set-point only the loop itself shows that five disks became one."""
    bench = Bench(DAEMON, noise=NoiseParameters(sigma=0.002 * STEP), seed=1)
    bench.controller = Controller(DAEMON, MOTOR, (0.011, 68.5, 585.0))
    bench.run(200.0, order(HIGH, Mode.ADAPTIVE))
    late = bench.decisions[100:]
    assert np.std([one.boost_reference_V for one in late]) < 4.0
    assert late[-1].estimates["tau_sum_s"].value == pytest.approx(21.7, rel=0.2)
