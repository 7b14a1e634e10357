"""A controller from start to trip: what it measures and names, and a start with a prior."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from adaptdrive.control.controller import Controller
from adaptdrive.control.fast import LAG_TICKS
from adaptdrive.control.loads.battery import battery_load
from adaptdrive.control.loads.load import Charging
from adaptdrive.control.settings import ControllerSettings, Rates
from adaptdrive.control.signals import Measurement, Mode, Order, Snapshot, Stage
from adaptdrive.safety.trips import TripKind
from adaptdrive_sim.world import NoiseParameters
from tests.integration.closed_loop.bench import (
    EXACT,
    MOTOR,
    REST_V,
    STEP,
    TICKS,
    Bench,
    TICK_s,
    order,
    square_wave,
)


def measured(
    tick: int, output: float = 3.0, *, boost_V: float = REST_V, period_s: float = TICK_s,
    fresh: bool = True,
) -> Measurement:  # fmt: skip
    return Measurement(tick, period_s, boost_V, 120.0, 430.0, output, fresh)


def snapshot_of(controller: Controller) -> Snapshot:
    snapshot = controller.take_snapshot()
    assert snapshot is not None
    return snapshot


@pytest.mark.parametrize(("output", "resting_V"), [(3.3, 300.0), (0.0, 0.0), (-0.1, 0.0)])
def test_after_a_precharge_the_filters_have_seen_the_voltage_that_the_output_rests_at(
    output: float, resting_V: float
) -> None:
    """λ²u hardly moves within 1 s: by 1 - 1.1 exp(-0.1) of the way."""
    controller = Controller(EXACT, MOTOR)
    controller.tick(measured(0, output, boost_V=215.0), order(stage=Stage.PRECHARGE))
    for tick in range(1, TICKS + 1):
        controller.tick(measured(tick, output, boost_V=215.0), order())
    seen_V = snapshot_of(controller).input_filtered[2]
    assert seen_V == pytest.approx(resting_V, abs=0.0047 * abs(215.0 - resting_V) + 1e-9)


BATTERY = replace(
    battery_load(0.25, 1.2, 0.4, 30.0),
    charging=Charging(
        turns_ratio=0.25,
        droop_Ohm=1.2,
        internal_Ohm=0.2,
        voltage_max_V=80.0,
        end_current_A=1.0,
    ),
)


@pytest.mark.parametrize(("stage", "first_V"), [(Stage.PRECHARGE, 200.0), (Stage.RUN, 320.0)])
def test_a_charge_begins_at_the_lowest_V_c_unless_it_goes_on(stage: Stage, first_V: float) -> None:
    """A capacitor that is still charged would otherwise charge the battery at any current."""
    controller = Controller(EXACT, BATTERY)
    controller.tick(measured(0, 0.0, boost_V=320.0), order(stage=stage))
    commands = [
        controller.tick(measured(tick, 0.0, boost_V=320.0), order()) for tick in range(1, TICKS + 1)
    ]
    assert commands[0].boost_reference_V == first_V
    seen_V = snapshot_of(controller).input_filtered
    assert seen_V == pytest.approx([320.0] * len(seen_V))  # a battery rests at its own EMF


@pytest.mark.parametrize(("asked_V", "held_V"), [(399.0, 330.0), (310.0, 310.0)])
def test_by_hand_the_terminals_of_a_battery_stay_at_their_voltage_limit(
    asked_V: float, held_V: float
) -> None:
    """At 2 A they are at 80 V where V_c is (80 V + 1.2 Ohm · 2 A) over 0.25, 329.6 V."""
    controller = Controller(EXACT, BATTERY)
    controller.tick(measured(0, 2.0, boost_V=300.0), order(stage=Stage.PRECHARGE))
    by_hand = Order(Stage.RUN, 3.0, Mode.MANUAL, 0.7, asked_V)
    commands = [controller.tick(measured(tick, 2.0, boost_V=300.0), by_hand) for tick in (1, 2)]
    assert commands[-1].boost_reference_V == pytest.approx(held_V, abs=0.5)


def test_a_law_cannot_raise_the_terminals_of_a_battery_far_above_their_limit() -> None:
    """By 2 %, in the tick of the measurement: 1.02 · 329.6 V at 2 A."""
    controller = Controller(EXACT, BATTERY)
    for tick in range(TICKS + 1):
        controller.tick(measured(tick, 2.0, boost_V=300.0), order())
    decision = controller.decide(snapshot_of(controller))
    controller.apply(replace(decision, boost_reference_V=390.0))
    command = controller.tick(measured(TICKS + 1, 2.0, boost_V=300.0), order())
    assert command.boost_reference_V == pytest.approx(1.02 * 329.6, rel=0.003)


@pytest.mark.parametrize("mode", [Mode.FIXED, Mode.MANUAL])
def test_a_voltage_by_hand_and_a_law_do_not_overwrite_each_other(mode: Mode) -> None:
    """A decision of the law that comes after the hand is older, and so is one of the hand."""
    controller = Controller(EXACT, MOTOR)
    for tick in range(TICKS + 1):
        controller.tick(measured(tick), order())
    decision = controller.decide(snapshot_of(controller))
    by_hand = Order(Stage.RUN, 3.0, Mode.MANUAL, 0.7, 310.0)
    now = by_hand if mode is Mode.FIXED else order()
    before_V = controller.tick(measured(TICKS + 1), now).boost_reference_V
    controller.apply(replace(decision, boost_reference_V=350.0, controller=mode))
    assert controller.tick(measured(TICKS + 2), now).boost_reference_V == before_V


@pytest.mark.parametrize("after_A", [0.0, 8.0])
def test_a_battery_whose_current_leaves_in_one_step_is_a_fault(after_A: float) -> None:
    """From 8 A to nothing, at the voltage limit: 80 V are V_c of (80 + 1.2 · y) over 0.25."""
    controller, faults = Controller(replace(EXACT, rates=SMALL), BATTERY), []
    for tick in range(1, 160):
        output = 8.0 if tick < 40 else after_A
        at_limit = measured(tick, output, boost_V=4.0 * (80.5 + 1.2 * output), period_s=1.0)
        controller.tick(at_limit, order(8.0))
        if (snapshot := controller.take_snapshot()) is not None:
            faults.append(controller.decide(snapshot).fault)
    text = "no current: the current has left in one step: is the battery disconnected?"
    assert set(faults) == ({"", text} if after_A == 0.0 else {""})
    assert faults == sorted(faults)


@pytest.mark.parametrize("mode", [Mode.FIXED, Mode.ADAPTIVE, Mode.MANUAL])
def test_a_charge_that_lasts_too_long_is_a_fault_in_every_mode(mode: Mode) -> None:
    """With a slow period of 2 s and a longest charge of 36 s."""
    charging = replace(BATTERY.charging, longest_s=36.0)  # type: ignore[type-var]
    controller = Controller(replace(EXACT, rates=SMALL), replace(BATTERY, charging=charging))
    faults, kinds = [], set()
    for tick in range(1, 160):
        controller.tick(measured(tick, 2.0, period_s=1.0), replace(order(2.0), mode=mode))
        if (snapshot := controller.take_snapshot()) is not None:
            decision = controller.decide(snapshot)
            faults.append((tick, decision.fault))
            kinds.add((decision.fault_kind, bool(decision.fault)))
    text = (
        "charge time: the charge has not ended within load.charge.longest_h = 0.01 h: does the "
        "current sensor read too high?"
    )
    assert {fault for _, fault in faults} == {"", text}
    assert kinds == {("", False), (TripKind.CHARGE_TOO_LONG, True)}
    assert 36 < min(tick for tick, fault in faults if fault) <= 36 + 2 * SMALL.ticks_per_period
    assert [fault for _, fault in faults] == sorted(fault for _, fault in faults)


def test_the_filters_follow_the_measured_line_frequency() -> None:
    """λy of a step of 0.3 V, the mean over the second half of a period on a line of 50 Hz."""
    controller = Controller(EXACT, MOTOR)
    controller.tick(measured(0), order())
    for tick in range(1, TICKS + 1):
        controller.tick(measured(tick, period_s=0.01), order())
    controller.take_snapshot()
    for tick in range(TICKS + 1, 2 * TICKS + 1):
        controller.tick(measured(tick, 3.3, period_s=0.01), order())
    snapshot = snapshot_of(controller)
    ways = [1.0 - math.exp(-(n - 0.5) * 0.01 / 10.0) for n in range(TICKS // 2 + 1, TICKS + 1)]
    assert snapshot.output_filtered[0] == pytest.approx(3.0 + 0.3 * sum(ways) / len(ways), abs=1e-4)
    assert snapshot.period_s == pytest.approx(1.2)


SMALL = Rates(
    ticks_per_period=2, latency_ticks=1, samples=1, lag_ticks=LAG_TICKS, nominal_tick_s=1.0
)
RESPONDING = replace(
    EXACT,
    rates=SMALL,
    supervision=replace(
        EXACT.supervision, ratio_min=0.5, ratio_max=1.0, response_periods=5, response_distance=0.05
    ),
)


@pytest.mark.parametrize("reference", [1.7, 4.3])
def test_a_load_that_does_not_answer_is_a_fault_and_named(reference: float) -> None:
    controller, faults = Controller(RESPONDING, MOTOR), []
    for tick in range(1, 61):
        boost_V = 280.0 if tick == 1 else 400.0
        controller.tick(measured(tick, boost_V=boost_V, period_s=1.0), order(reference))
        if (snapshot := controller.take_snapshot()) is not None:
            decision = controller.decide(snapshot)
            faults.append(decision.fault)
            controller.apply(decision)
    text = "no response: input at its limit for long, and the output has not moved"
    assert set(faults) == {"", text}
    assert faults == sorted(faults)
    assert faults[:6] == [""] * 6


THREE_DISKS = (0.011, 45.1, 351.0)
JACKET = replace(
    EXACT.supervision,
    spread_max=0.05,
    confidence=2.0,
    residual_margin=1.5,
    dwell_periods=3,
)
CAREFUL = replace(EXACT, supervision=JACKET, learning=replace(EXACT.learning, bias=True))


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


def test_gains_for_a_load_that_is_another_one_by_now_do_not_stay() -> None:
    """Three disks became one while the drive was off: the first edge shows it."""
    bench, outputs = Bench(CAREFUL), []
    bench.controller = Controller(CAREFUL, MOTOR, THREE_DISKS)
    for second in range(120):
        bench.run(1.0, order(square_wave(second), Mode.ADAPTIVE))
        outputs.append(bench.world.true_output)
    assert bench.decisions[0].controller is Mode.ADAPTIVE
    values = [bench.decisions[40].estimates[name].value for name in MOTOR.names]
    assert values == pytest.approx((0.011, 21.7, 117.0), rel=0.1)
    assert 2.99 < min(outputs) < max(outputs) < 3.21


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
