"""A drive that sends at a wrong rate is noticed, and one that is only disturbed is not."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adaptdrive.control.signals import SAFE_COMMAND, Mode, Stage
from adaptdrive.errors import RefusedError
from adaptdrive.runtime.frame_rate import verdict_ticks
from adaptdrive.runtime.half_cycles import HalfCycles
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import Enable, Reset, SetMode, SetSetpoint, SetVoltage
from tests.runtime.bench import FAST, TICK_S, FastBench, fast_bench, running_bench

Frame = tuple[int | None, float]
"""Counter and arrival."""


def first_complaint(frames: Iterator[Frame], modulus: int | None) -> tuple[float, str] | None:
    """Time since the first frame, and cause; as the fast loop does, with stand-in ticks."""
    base, latest, start_s, last_s = HalfCycles(modulus, TICK_S), -1, 0.0, 0.0
    for number, (counter, arrival_s) in enumerate(frames):
        start_s = arrival_s if number == 0 else start_s
        if number:  # a stand-in runs at 1.5, 2.5 … half cycles after the frame before
            latest += max(0, int((arrival_s - last_s) / TICK_S - 0.5))
        latest = max(latest, base.place(counter, arrival_s, latest))
        last_s = arrival_s
        if base.rate.cause is not None:
            return arrival_s - start_s, base.rate.cause
    return None


def steady(rate_Hz: float, count: int, modulus: int | None, per_frame: int = 1) -> Iterator[Frame]:
    for number in range(count):
        counter = None if modulus is None else number * per_frame % modulus
        yield counter, 100.0 + number / rate_Hz


@pytest.mark.parametrize("modulus", [None, 16, 256, 65536])
@pytest.mark.parametrize("rate_Hz", [20.0, 50.0, 60.0, 100.0, 150.0, 240.0, 400.0, 1000.0])
def test_a_wrong_rate_is_named(rate_Hz: float, modulus: int | None) -> None:
    found = first_complaint(steady(rate_Hz, round(100 + 1.1 * rate_Hz), modulus), modulus)
    assert found is not None
    when_s, cause = found
    assert when_s <= 1.0 + 91.0 / rate_Hz
    measured = cause.partition("sends ")[2].partition(" readings/s")[0]
    assert float(measured) == pytest.approx(rate_Hz, rel=0.02)
    assert "expected 120/s" in cause


def test_a_counter_that_runs_at_twice_the_rate_is_named() -> None:
    found = first_complaint(steady(120.0, 400, 256, per_frame=2), 256)
    assert found is not None
    assert "the drive counts 240 half cycles/s, expected 120/s" in found[1]


def test_every_second_half_cycle_is_too_seldom() -> None:
    """The counter is right, but half of the ticks run on held values."""
    found = first_complaint(steady(60.0, 400, 256, per_frame=2), 256)
    assert found is not None
    assert "the drive sends 60 readings/s" in found[1]


@st.composite
def honest_drives(draw: st.DrawFn, jitter_ticks: float) -> list[tuple[int, float]]:
    """Half cycle and arrival of each frame: a line off by 2 %, jitter, bursts lost, outages."""
    generator = np.random.default_rng(draw(st.integers(0, 2**32)))
    tick_s = TICK_S / draw(st.floats(0.98, 1.02))
    jitter_s = draw(st.floats(0.0, jitter_ticks)) * TICK_S
    lost_share, longest = draw(st.floats(0.0, 0.1)), draw(st.integers(1, 30))
    outage_at, outage = draw(st.integers(0, 2000)), draw(st.integers(0, 3000))
    frames, half_cycle, last_s = [], draw(st.integers(0, 70_000)), 0.0
    for number in range(1500):
        half_cycle += 1
        if number == outage_at:
            half_cycle += outage
        if generator.random() < lost_share / longest:
            half_cycle += int(generator.integers(1, longest + 1))
        last_s = max(last_s, half_cycle * tick_s + generator.uniform(0.0, jitter_s))
        frames.append((half_cycle, last_s))
    return frames


@settings(max_examples=30)
@given(frames=honest_drives(jitter_ticks=2.5), modulus=st.sampled_from([16, 256, 65536]))
def test_a_disturbed_drive_of_the_right_rate_is_believed(
    frames: list[tuple[int, float]], modulus: int
) -> None:
    sent = ((count % modulus, time_s) for count, time_s in frames)
    assert first_complaint(sent, modulus) is None


@settings(max_examples=30)
@given(frames=honest_drives(jitter_ticks=0.7))
def test_without_a_counter_jitter_below_a_tick_is_believed(
    frames: list[tuple[int, float]],
) -> None:
    assert first_complaint(((None, time_s) for _, time_s in frames), None) is None


@given(modulus=st.sampled_from([16, 256, 65536]), restarts=st.lists(st.integers(0, 65535)))
def test_a_drive_that_restarts_again_and_again_is_believed(
    modulus: int, restarts: list[int]
) -> None:
    def frames() -> Iterator[Frame]:
        time_s = 1.0
        for first in (0, *restarts):
            time_s += 1.0
            for number in range(90):
                time_s += TICK_S
                yield (first + number) % modulus, time_s

    assert first_complaint(frames(), modulus) is None


@given(modulus=st.sampled_from([16, 256, 65536]), seed=st.integers(0, 2**32))
def test_too_many_frames_are_noticed_though_the_counter_jumps(modulus: int, seed: int) -> None:
    counts = np.random.default_rng(seed).integers(0, modulus, 1500)
    found = first_complaint(
        ((int(c), 1.0 + 0.2 * TICK_S * i) for i, c in enumerate(counts)), modulus
    )
    assert found is not None
    assert "readings/s, expected 120/s" in found[1]


@given(stalls=st.lists(st.tuples(st.integers(1, 60), st.integers(1, 12)), max_size=60))
def test_a_daemon_that_takes_only_the_newest_frame_believes_it(
    stalls: list[tuple[int, int]],
) -> None:
    """After each stall it takes the newest frame; no stand-in could run meanwhile."""
    base, half_cycle, latest = HalfCycles(256, TICK_S), 0, -1
    for prompt, stalled in stalls * 3:
        for step in (*[1] * prompt, stalled):
            half_cycle += step
            latest = max(latest, base.place(half_cycle % 256, half_cycle * TICK_S, latest))
            assert base.rate.cause is None


@pytest.mark.parametrize("rate_Hz", [50.0, 60.0, 100.0, 400.0, 1000.0])
async def test_a_wrong_rate_refuses_enable(rate_Hz: float) -> None:
    async with fast_bench(modulus=None) as bench:
        bench.frames(round(150 + rate_Hz), 1.0 / rate_Hz)
        expected = (
            rf"sends {rate_Hz:g}\S* readings/s, expected 120/s: look at drive\.line_frequency_Hz"
        )
        with pytest.raises(RefusedError, match=expected):
            bench.ask(Enable())


@pytest.mark.parametrize("rate_Hz", [50.0, 60.0, 100.0, 400.0, 1000.0])
@pytest.mark.parametrize("earlier", [1, 30, 60, 75])
async def test_a_drive_enabled_early_is_never_energised_wrongly(
    rate_Hz: float, earlier: int
) -> None:
    async with fast_bench(modulus=None) as bench:
        bench.frames(earlier, 1.0 / rate_Hz)
        bench.ask(Enable())
        bench.frames(round(150 + rate_Hz), 1.0 / rate_Hz)
        assert bench.state() is State.TRIPPED
        assert bench.trip.startswith("frame rate: the drive ")
        assert set(bench.sent) == {SAFE_COMMAND}


async def test_enabled_at_the_first_frame_it_runs_by_itself() -> None:
    async with fast_bench() as bench:
        bench.frame()
        bench.ask(Enable())
        bench.frames(59)
        assert bench.state() is State.STARTING
        assert set(bench.sent) == {SAFE_COMMAND}
        bench.frames(4)
        assert bench.state() is State.RUNNING


async def test_a_rate_that_goes_wrong_later_trips() -> None:
    async with running_bench(frames=300) as bench:
        assert bench.state() is State.RUNNING
        bench.frames(300, 0.01)
        assert bench.state() is State.TRIPPED
        assert bench.trip.startswith("frame rate: the drive sends ")


async def test_a_drive_that_is_polled_sets_no_rate() -> None:
    async with fast_bench(replace(FAST, drive_clocks=False), modulus=None) as bench:
        bench.frames(150, 0.01)
        assert bench.loop.cause is None


def run_by_hand(bench: FastBench, hold_s: float | None) -> None:
    """Run the drive in mode manual, where nothing moves."""
    bench.frames(70)
    bench.ask(SetMode(Mode.MANUAL))
    bench.ask(Enable())
    bench.frames(3)
    bench.ask(SetVoltage(250.0, hold_s))
    bench.frames(5)
    assert bench.state() is State.RUNNING


def stutter(bench: FastBench, frames: int, every: int, **changes: bool) -> None:
    """Frames of a drive whose gateway repeats one frame in place of the next, now and then."""
    for number in range(frames):
        bench.frame(steps={0: 0, 1: 2}.get(number % every, 1), **changes)


async def test_a_last_frame_that_is_repeated_for_ever_trips_in_the_time_of_a_stale_one() -> None:
    async with fast_bench() as bench:
        run_by_hand(bench, None)
        for _ in range(5):  # 42 ms
            bench.frame(steps=0)
        assert bench.state() is State.RUNNING
        for _ in range(2):  # 58 ms
            bench.frame(steps=0)
        assert bench.state() is State.TRIPPED
        assert bench.trip.startswith("half-cycle counter: the drive's count has ")
        assert bench.sent[-1] == SAFE_COMMAND
        with pytest.raises(RefusedError, match="half-cycle counter: "):
            bench.ask(Reset())
        bench.frame()
        bench.ask(Reset())


@pytest.mark.parametrize("held", [2, 3, 7, 100])
async def test_last_frames_that_are_repeated_in_turn_trip_as_one_does(held: int) -> None:
    """Buffers of a drive whose control hangs, or of a gateway: their values differ by the noise."""
    async with fast_bench() as bench:
        run_by_hand(bench, None)
        bench.frames(held)
        for number in range(7):  # 58 ms
            assert bench.state() is State.RUNNING
            bench.frame(steps=1 if number % held else 1 - held)
        assert bench.state() is State.TRIPPED
        assert bench.trip.startswith("half-cycle counter: the drive's count has ")


@pytest.mark.parametrize("stale_s", [0.1, 0.45])
@pytest.mark.parametrize("held", [9, 10, 16, 40, 100])
async def test_many_frames_that_are_repeated_in_turn_trip_at_the_longest_age(
    held: int, stale_s: float
) -> None:
    settings = replace(FAST, timing=replace(FAST.timing, stale_s=stale_s))
    async with fast_bench(settings) as bench:
        run_by_hand(bench, None)
        bench.frames(held)
        for number in range(math.ceil(1.1 * stale_s / TICK_S)):
            bench.frame(steps=1 if number % held else 1 - held)
        assert bench.trip.startswith("half-cycle counter: the drive's count has ")


@pytest.mark.parametrize("leap", [-3, -20_000, 5000])
async def test_a_count_that_is_wrong_once_is_no_repeated_frame(leap: int) -> None:
    async with running_bench(frames=5) as bench:
        bench.frame(steps=leap)
        bench.frame(steps=2 - leap)
        bench.frames(60)
        assert bench.state() is State.RUNNING


async def test_a_frame_repeated_in_place_of_a_lost_one_trips_nothing() -> None:
    async with running_bench() as bench:
        stutter(bench, frames=1000, every=3)
        assert bench.state() is State.RUNNING


@pytest.mark.parametrize("every", [3, 20])
async def test_the_operator_is_watched_though_the_rate_is_not_known(every: int) -> None:
    async with fast_bench() as bench:
        run_by_hand(bench, 2.0)
        stutter(bench, frames=150, every=every)
        assert bench.state() is State.RUNNING
        stutter(bench, frames=100, every=every)
        assert bench.trip.startswith("manual: no new voltage within the 2 s")


async def test_a_voltage_holds_for_its_time_though_frames_come_in_pairs() -> None:
    async with fast_bench(modulus=None) as bench:
        run_by_hand(bench, 2.0)
        began_s = bench.around.now
        while bench.state() is State.RUNNING:
            bench.frame(2 * TICK_S)
            bench.frame(0.0)
        assert bench.around.now - began_s == pytest.approx(2.0, abs=10 * TICK_S)
        assert bench.trip.startswith("manual: no new voltage within the 2 s")


async def test_the_precharge_is_watched_though_the_rate_is_not_known_any_more() -> None:
    async with fast_bench() as bench:
        bench.measured = replace(bench.measured, boost_voltage_V=150.0)
        bench.frames(70)
        bench.ask(Enable())
        bench.frames(3)
        stutter(bench, frames=660, every=5)
        assert bench.trip.startswith("precharge: v_bst = 150.0 V after 5 s")


def start_at_an_unknown_rate(bench: FastBench, hold_s: float | None) -> None:
    """Set V_c by hand while the rate of the half cycles is not known."""
    bench.frames(70)
    bench.ask(SetMode(Mode.MANUAL))
    bench.ask(Enable())
    stutter(bench, frames=240, every=20)
    bench.ask(SetVoltage(250.0, hold_s))
    assert bench.state() is State.STARTING


@pytest.mark.parametrize(("hold_s", "limit_s"), [(None, 5.0), (60.0, 5.0), (2.0, 2.0)])
async def test_a_start_waits_for_its_rate_no_longer_than_a_precharge_or_its_operator_may_last(
    hold_s: float | None, limit_s: float
) -> None:
    async with fast_bench() as bench:
        start_at_an_unknown_rate(bench, hold_s)
        stutter(bench, frames=round(0.9 * limit_s / TICK_S), every=20)
        assert bench.state() is State.STARTING
        stutter(bench, frames=round(0.2 * limit_s / TICK_S), every=20)
        assert bench.trip.startswith(f"frame rate: not known {limit_s:g}")
        bench.frames(200)
        assert bench.state() is State.TRIPPED
        assert set(bench.sent) == {SAFE_COMMAND}


async def test_a_bridge_that_comes_on_before_the_rate_is_known_trips() -> None:
    async with fast_bench() as bench:
        start_at_an_unknown_rate(bench, None)
        stutter(bench, frames=3, every=20, bridge=True)
        assert "although this daemon did not command it" in bench.trip


async def test_a_bridge_that_has_not_gone_off_before_the_rate_is_known_trips() -> None:
    async with fast_bench() as bench:
        start_at_an_unknown_rate(bench, None)
        bench.ask(SetMode(Mode.FIXED))
        bench.frames(63)
        assert bench.state() is State.RUNNING
        stutter(bench, frames=240, every=20)
        bench.ask(SetSetpoint(0.0))
        bench.ask(SetSetpoint(3.0))
        stutter(bench, frames=round(FAST.timing.stop_s / TICK_S), every=20, bridge=True)
        assert bench.state() is State.STARTING
        stutter(bench, frames=5, every=20, bridge=True)
        assert bench.trip.startswith("the drive does not stop: its bridge is still")


async def test_a_start_before_the_bus_has_taken_a_command_waits_for_the_rate(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with fast_bench() as bench:
        monkeypatch.setattr(bench.port, "send", lambda _: False)
        bench.port.safe_s = math.inf
        bench.frame()
        bench.ask(Enable())
        bench.frames(64)
        assert bench.machine.trip is None
        assert bench.machine.stage is not Stage.OFF


@pytest.mark.parametrize("stride", [1, 2, 12, 120])
@pytest.mark.parametrize("jump_at", [0, 1, 17, 44])
def test_the_rate_of_a_steady_drive_is_known_in_time(stride: int, jump_at: int) -> None:
    """Wherever in the window its counter has jumped."""
    base, latest, counter = HalfCycles(65536, TICK_S, stride), -1, 0
    for number in range(jump_at + verdict_ticks(stride) // stride):
        counter += stride + 1000 * (number == jump_at)
        latest = base.place(counter % 65536, 100.0 + number * stride * TICK_S, latest)
    assert base.rate.judged


async def test_a_count_that_stands_in_standby_trips_nothing_and_refuses_enable() -> None:
    async with fast_bench() as bench:
        bench.frames(70)
        bench.frames(200, steps=0)
        assert bench.state() is State.STANDBY
        with pytest.raises(RefusedError, match=r"half-cycle counter: .* stood for 1667 ms"):
            bench.ask(Enable())
        bench.frame()
        assert bench.loop.cause is None


@pytest.mark.parametrize("modulus", [4, 16, 256])
def test_a_count_that_had_time_to_come_round_does_not_stand(modulus: int) -> None:
    base, latest = HalfCycles(modulus, TICK_S), -1
    for number in range(20):
        latest = base.place(7 % modulus, 100.0 + number * modulus * TICK_S, latest)
        assert base.rate.standing_s == 0.0
