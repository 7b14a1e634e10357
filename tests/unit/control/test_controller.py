"""The controller as a whole: rates, stages, limits, bumpless change, and what it never does."""

import math
from collections.abc import Iterator
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adaptdrive.control.controller import Controller
from adaptdrive.control.design.pole_placement import Plant, discrete_model
from adaptdrive.control.fast import LAG_TICKS
from adaptdrive.control.settings import ControllerSettings, Rates, SupervisionLimits
from adaptdrive.control.signals import (
    SAFE_COMMAND,
    Command,
    Decision,
    Measurement,
    Mode,
    Order,
    Snapshot,
    Stage,
)
from adaptdrive_sim.world import NoiseParameters
from tests.integration.closed_loop.bench import (
    EXACT,
    MOTOR,
    PAPER,
    PLAIN_LEARNING,
    REST_V,
    STAGE,
    TICKS,
    Bench,
    TICK_s,
    order,
    square_wave,
)


def measurement(
    tick: int,
    *,
    boost: float = REST_V,
    line: float = 120.0,
    power: float = 430.0,
    output: float = 3.0,
    fresh: bool = True,
) -> Measurement:
    return Measurement(tick, TICK_s, boost, line, power, output, fresh)


def snapshots(controller: Controller, ticks: Iterator[int] | range) -> list[Snapshot]:
    found = []
    for tick in ticks:
        controller.tick(measurement(tick), order())
        if (snapshot := controller.take_snapshot()) is not None:
            found.append(snapshot)
    return found


# two rates


def test_a_snapshot_is_left_every_slow_period_and_only_once() -> None:
    controller = Controller(EXACT, MOTOR)
    found = snapshots(controller, range(1, 1000))
    assert [s.k for s in found] == list(range(1, 9))
    assert [s.tick for s in found] == [k * TICKS for k in range(1, 9)]
    assert controller.take_snapshot() is None
    jumping = snapshots(Controller(EXACT, MOTOR), iter([*range(1, 130), *range(500, 620)]))
    assert [s.k for s in jumping] == [1, 4, 5]


@pytest.mark.parametrize("missed", [(240,), (239, 240, 241), tuple(range(200, 260)), (241,)])
def test_missed_ticks_advance_the_slow_index_and_never_repeat_it(missed: tuple[int, ...]) -> None:
    ticks = [tick for tick in range(1, 700) if tick not in missed]
    found = snapshots(Controller(EXACT, MOTOR), iter(ticks))
    assert [s.k for s in found] == [1, 2, 3, 4, 5]
    late = 240 in missed
    assert found[1].tick == (max(missed) + 1 if late else 240)
    assert [s.tick for s in found if s.k != 2] == [120, 360, 480, 600]


def test_a_snapshot_holds_what_its_period_has_shown() -> None:
    """On a line of 59.9 Hz, with every tenth tick stood in for."""
    controller = Controller(EXACT, MOTOR)
    for tick in range(1, 121):
        seen = measurement(tick, boost=280.0 + tick % 2, output=3.0 + tick, fresh=tick % 10 != 0)
        controller.tick(replace(seen, tick_period_s=1.0 / 119.8), order())
    snapshot = controller.take_snapshot()
    assert snapshot is not None
    assert snapshot.period_s == pytest.approx(120.0 / 119.8)
    assert snapshot.output == pytest.approx(3.0 + sum(range(61, 121)) / 60.0)
    assert snapshot.held_ticks == 12
    assert snapshot.applied_V == pytest.approx(280.5)


# stages


def test_precharge_holds_the_lowest_voltage_with_the_bridge_off() -> None:
    controller = Controller(EXACT, MOTOR)
    command = controller.tick(measurement(0, boost=170.0), order(stage=Stage.PRECHARGE))
    assert not command.bridge
    assert command.boost_reference_V == STAGE.boost_reference_min_V
    assert 0.0 <= command.current_scale_S <= STAGE.current_scale_max_S


@pytest.mark.parametrize("boost", [0.0, 170.0, 215.0, 333.0, 450.0])
@pytest.mark.parametrize("output", [2.0, 3.2, 4.5])
def test_entering_run_starts_from_the_present_voltage_but_moves_no_load(
    boost: float, output: float
) -> None:
    controller = Controller(EXACT, MOTOR)
    controller.tick(measurement(0, boost=boost), order(stage=Stage.PRECHARGE))
    command = controller.tick(measurement(1, boost=boost, output=output), order())
    assert command.bridge
    at_rest_V = max(REST_V * output / 3.0, 200.0)
    assert command.boost_reference_V == pytest.approx(min(max(boost, 200.0), at_rest_V, 400.0))


def test_a_decision_takes_effect_at_the_next_tick_of_its_run() -> None:
    controller = Controller(EXACT, MOTOR)
    found = snapshots(controller, range(1, 121))
    decision = replace(controller.decide(found[0]), boost_reference_V=311.0)
    assert controller.tick(measurement(121), order()).boost_reference_V == REST_V
    controller.apply(decision)
    assert controller.tick(measurement(122), order()).boost_reference_V == 311.0
    controller.tick(measurement(123), order(stage=Stage.PRECHARGE))
    controller.apply(decision)
    command = controller.tick(measurement(124), order(stage=Stage.PRECHARGE))
    assert command.boost_reference_V == 200.0


def test_the_next_run_starts_from_estimates_that_took_effect() -> None:
    controller = Controller(EXACT, MOTOR)
    found = snapshots(controller, range(1, 121))
    decision = replace(controller.decide(found[0]), trusted=(0.011, 20.0, 110.0))
    assert controller.trusted is None
    controller.apply(decision)
    assert controller.trusted == decision.trusted
    for tick, stage in ((122, Stage.OFF), (123, Stage.PRECHARGE), (124, Stage.RUN)):
        controller.tick(measurement(tick), order(stage=stage))
        assert controller.state.recalled is (stage is Stage.RUN)


def test_the_bridge_is_on_in_precharge_where_the_boost_needs_it() -> None:
    needing = replace(EXACT, stage=replace(STAGE, boost_needs_bridge=True))
    for settings_, expected in ((needing, True), (EXACT, False)):
        controller = Controller(settings_, MOTOR)
        assert controller.tick(measurement(0), order(stage=Stage.OFF)) == SAFE_COMMAND
        assert controller.tick(measurement(1), order(stage=Stage.PRECHARGE)).bridge is expected


# determinism


def recorded(settings_: ControllerSettings, seconds: int) -> tuple[list[Command], list[Decision]]:
    bench = Bench(settings_, noise=NoiseParameters(sigma=0.01, spike_share=0.02, spike_sigma=0.1))
    for second in range(seconds):
        mode = Mode.ADAPTIVE if second % 50 > 20 else Mode.FIXED
        bench.run(1.0, order(square_wave(second), mode))
    return bench.commands, bench.decisions


def test_the_same_calls_give_the_same_commands_bit_for_bit() -> None:
    # as text: decisions hold NaN, which equals nothing
    assert repr(recorded(EXACT, 150)) == repr(recorded(EXACT, 150))


def test_an_accepted_estimate_says_how_far_the_response_may_be_off() -> None:
    """A share of the step: the more of the noise it has seen, the less."""
    noise, supervision = (
        NoiseParameters(sigma=0.01),
        replace(EXACT.supervision, spread_max=0.05, confidence=2.0),
    )
    bench = Bench(replace(EXACT, supervision=supervision), noise=noise)
    for second in range(300):
        bench.run(1.0, order(square_wave(second), Mode.ADAPTIVE))
    spreads = [one.response_spread for one in bench.decisions if one.accepted]
    assert 0.0 < spreads[-1] < max(spreads) <= 0.05
    assert all(math.isnan(one.response_spread) for one in bench.decisions if not one.accepted)


# bumpless change


NOMINAL = list(MOTOR.numerator), list(MOTOR.denominator)


@pytest.fixture(scope="module")
def learnt() -> Bench:
    """A motor whose true load differs from the nominal one, learnt, and back at rest."""
    bench = Bench(replace(EXACT, supervision=replace(EXACT.supervision, warm_up_periods=60)))
    bench.motor.disks = 2
    for second in range(240):
        bench.run(1.0, order(square_wave(second), Mode.FIXED))
    bench.run(200.0, order(3.0, Mode.FIXED))
    return bench


def test_at_rest_the_change_of_mode_is_bumpless(learnt: Bench) -> None:
    before = learnt.decisions[-1]
    assert before.controller is Mode.FIXED
    assert before.accepted or before.reason
    assert abs(before.handover_step_V) < 1.0
    reference = learnt.commands[-1].boost_reference_V
    for mode in (Mode.ADAPTIVE, Mode.FIXED):
        learnt.run(3.0, order(3.0, mode))
        assert learnt.decisions[-1].controller is mode
        assert learnt.commands[-1].boost_reference_V == pytest.approx(reference, abs=1.0)


def test_the_gains_shown_are_those_of_the_law_in_force(learnt: Bench) -> None:
    """R and S, then their sum S(1), which multiplies the reference."""
    shown = []
    for mode in (Mode.ADAPTIVE, Mode.FIXED):
        learnt.run(3.0, order(3.0, mode))
        *gains, forward = learnt.decisions[-1].gains
        assert forward == pytest.approx(sum(gains[-MOTOR.order - 1 :]))
        shown.append(gains)
    plant = Plant(*discrete_model(EXACT, MOTOR, *NOMINAL, 1.0))
    nominal = plant.gains(plant.asked(0.7))
    assert shown[1] == pytest.approx(nominal, rel=1e-3)
    assert shown[0] != pytest.approx(nominal, rel=0.1)


# what it never does

SMALL = Rates(
    ticks_per_period=4, latency_ticks=1, samples=2, lag_ticks=LAG_TICKS, nominal_tick_s=TICK_s
)
EAGER = SupervisionLimits(warm_up_periods=1, ratio_min=1e-3, ratio_max=1e3, revokes=True)
KINDS = [
    replace(EXACT, rates=SMALL, supervision=EAGER),
    replace(EXACT, rates=SMALL, supervision=EAGER, learning=PLAIN_LEARNING),
    replace(PAPER, rates=replace(SMALL, samples=1), supervision=EAGER),
    replace(
        PAPER,
        rates=replace(SMALL, samples=1),
        supervision=EAGER,
        learning=replace(PLAIN_LEARNING, method="rls"),
    ),
]
anything = st.floats(allow_nan=False, allow_infinity=False)
voltages = st.floats(0.0, 500.0) | anything
outputs = st.floats(-5.0, 5.0) | anything
frames = st.tuples(st.sampled_from([1, 1, 1, 2, 5, 9]), voltages, voltages, outputs, outputs)
orders = st.builds(
    Order,
    st.sampled_from([Stage.RUN, Stage.RUN, Stage.RUN, Stage.PRECHARGE, Stage.OFF]),
    st.floats(-5.0, 5.0) | anything,
    st.sampled_from(Mode),
    st.floats(0.3, 0.95),
    voltages,
)


def drive(
    settings_: ControllerSettings,
    frames_: list[tuple[tuple[int, float, float, float, float], Order]],
) -> Iterator[Command]:
    controller, tick = Controller(settings_, MOTOR), 0
    for (steps, boost, line, power, output), wanted in frames_:
        tick += steps
        yield controller.tick(Measurement(tick, TICK_s, boost, line, power, output), wanted)
        if (snapshot := controller.take_snapshot()) is not None:
            controller.apply(controller.decide(snapshot))


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=150)
@given(st.lists(st.tuples(frames, orders), min_size=1, max_size=60))
def test_from_finite_measurements_every_command_is_finite_and_within_limits(
    kind: ControllerSettings,
    frames_: list[tuple[tuple[int, float, float, float, float], Order]],
) -> None:
    for command, (_, wanted) in zip(drive(kind, frames_), frames_, strict=True):
        assert math.isfinite(command.current_scale_S)
        assert math.isfinite(command.boost_reference_V)
        assert STAGE.current_scale_min_S <= command.current_scale_S <= STAGE.current_scale_max_S
        if wanted.stage is Stage.OFF:
            assert command == SAFE_COMMAND
        else:
            low, high = STAGE.boost_reference_min_V, STAGE.boost_reference_max_V
            assert low <= command.boost_reference_V <= high
            assert command.bridge == (wanted.stage is Stage.RUN)


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=40)
@given(st.lists(st.tuples(frames, orders), min_size=1, max_size=40))
def test_whatever_was_measured_nothing_of_it_outlives_off(
    kind: ControllerSettings,
    frames_: list[tuple[tuple[int, float, float, float, float], Order]],
) -> None:
    off = ((1, 0.0, 0.0, 0.0, 0.0), order(stage=Stage.OFF))
    plain = [((1, REST_V + n % 3, 120.0, 430.0, 3.0), order()) for n in range(40)]
    ticks = sum(steps for (steps, *_), _ in frames_)
    fresh = [((ticks + 1, *off[0][1:]), off[1]), *plain]
    experienced = list(drive(kind, [*frames_, off, *plain]))
    assert experienced[-40:] == list(drive(kind, fresh))[-40:]
