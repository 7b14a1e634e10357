"""A controller that starts from what an earlier run has learnt."""

from dataclasses import replace

import pytest

from adaptdrive.control.controller import Controller
from adaptdrive.control.methods import METHODS
from adaptdrive.control.settings import ControllerSettings
from adaptdrive.control.signals import Mode, Stage
from adaptdrive_sim.noise import NoiseParameters
from tests.closed_loop.bench import EXACT, MOTOR, STEP, Bench, order, square_wave

THREE_DISKS = (0.011, 45.1, 351.0)
JACKET = replace(
    EXACT.jacket,
    spread_max=0.05,
    confidence=2.0,
    residual_margin=1.5,
    dwell_periods=3,
)
CAREFUL = replace(EXACT, jacket=JACKET, learning=replace(EXACT.learning, bias=True))


def first_adaptive(
    prior: tuple[float, ...] | None, disks: int, settings: ControllerSettings = CAREFUL
) -> tuple[int, Bench]:
    """The slow period in which adaptive takes over, within two minutes of a square wave."""
    bench = Bench(settings, noise=NoiseParameters(sigma=0.002 * STEP), seed=1)
    bench.motor.disks = disks
    bench.controller = Controller(settings, MOTOR, prior)
    for second in range(120):
        bench.run(1.0, order(square_wave(second), Mode.ADAPTIVE))
    modes = [decision.controller for decision in bench.decisions]
    return (modes.index(Mode.ADAPTIVE) if Mode.ADAPTIVE in modes else 120), bench


def test_the_gains_of_what_an_earlier_run_has_learnt_act_at_once_and_stay() -> None:
    start, bench = first_adaptive(THREE_DISKS, 3)
    assert start == 0
    values = [bench.decisions[0].estimates[name].value for name in MOTOR.names]
    assert values == pytest.approx(THREE_DISKS, rel=1e-3)
    assert all(decision.controller is Mode.ADAPTIVE for decision in bench.decisions)
    assert first_adaptive(None, 3)[0] >= 90


def test_while_nothing_is_learnt_the_gains_fit_the_noise_as_it_becomes_known() -> None:
    limited = replace(CAREFUL, jacket=replace(JACKET, noise_max=8.0))
    slow = replace(limited, learning=replace(limited.learning, settle_periods=30))
    bench = Bench(slow, noise=NoiseParameters(sigma=0.05 * STEP), seed=1)
    bench.motor.disks = 3
    bench.controller = Controller(slow, MOTOR, THREE_DISKS)
    bench.run(30.0, order(3.0, Mode.ADAPTIVE))
    first, last = bench.decisions[0].gains, bench.decisions[28].gains
    assert bench.decisions[28].controller is Mode.ADAPTIVE
    assert max(map(abs, last)) < 0.7 * max(map(abs, first))


def test_the_trusted_values_are_those_of_the_last_accepted_estimate() -> None:
    assert Controller(CAREFUL, MOTOR, THREE_DISKS).trusted is None
    _, bench = first_adaptive(THREE_DISKS, 3)
    assert bench.controller.trusted == pytest.approx(THREE_DISKS, rel=0.01)
    accepted = [d for d in bench.decisions if d.accepted][-1]
    assert bench.controller.trusted == tuple(accepted.estimates[name].value for name in MOTOR.names)
    assert all(0.0 < accepted.estimates[name].std < 0.1 * value
               for name, value in zip(MOTOR.names, THREE_DISKS, strict=True))  # fmt: skip


def test_gains_for_a_load_that_is_another_one_by_now_do_not_stay() -> None:
    """Three disks became one while the drive was off: the first edges show it."""
    bench, outputs = Bench(CAREFUL), []
    bench.controller = Controller(CAREFUL, MOTOR, THREE_DISKS)
    for second in range(120):
        bench.run(1.0, order(square_wave(second), Mode.ADAPTIVE))
        outputs.append(bench.world.true_output)
    modes = [decision.controller for decision in bench.decisions]
    assert modes[0] is Mode.ADAPTIVE
    assert modes.index(Mode.FIXED) < 40
    assert 2.99 < min(outputs) < max(outputs) < 3.21


def test_a_prior_changes_nothing_of_direct_least_squares() -> None:
    direct = replace(EXACT, learning=replace(EXACT.learning, method=METHODS["rls"]))
    found = [first_adaptive(prior, 3, direct)[1].commands for prior in (None, THREE_DISKS)]
    assert found[0] == found[1]


def test_trusted_estimates_survive_a_trip_and_act_at_once() -> None:
    settled = replace(CAREFUL, learning=replace(CAREFUL.learning, initial_state=True))
    start, bench = first_adaptive(None, 3, settled)
    trusted = bench.controller.trusted
    assert trusted is not None
    assert start >= 90
    before = len(bench.decisions)
    bench.run(5.0, order(square_wave(120), Mode.ADAPTIVE, Stage.OFF))
    bench.run(0.5, order(square_wave(120), Mode.ADAPTIVE, Stage.PRECHARGE))
    for second in range(125, 185):
        bench.run(1.0, order(square_wave(second), Mode.ADAPTIVE))
    after = bench.decisions[before:]
    values = [after[0].estimates[name].value for name in MOTOR.names]
    assert values == pytest.approx(trusted, rel=0.02)
    modes = [decision.controller for decision in after]
    assert set(modes) == {Mode.ADAPTIVE}
