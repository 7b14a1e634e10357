"""A drive that sends at a wrong rate is noticed, and one that is only disturbed is not."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adaptdrive.control.signals import SAFE_COMMAND, Mode
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import Enable, Reset, SetMode, SetVoltage
from adaptdrive.runtime.timebase import HalfCycles
from adaptdrive.safety.frames import FrameRate, verdict_ticks
from adaptdrive.util.errors import RefusedError
from tests.unit.runtime.bench import TICK_S, FastBench, fast_bench, running_bench, timed

EXACT_S = 2.0**-7
"""A half cycle whose multiples are exact."""

STRIDE = 12
Frame = tuple[int | None, float]
"""Counter and arrival."""

Sent = tuple[int, float, int, bool]
"""Readings, half cycles between two of them and that each counts, and whether a stand-in ran."""


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
            return arrival_s - start_s, base.rate.cause.text
    return None


def steady(rate_Hz: float, count: int, modulus: int | None, per_frame: int = 1) -> Iterator[Frame]:
    for number in range(count):
        counter = None if modulus is None else number * per_frame % modulus
        yield counter, 100.0 + number / rate_Hz


@pytest.mark.parametrize("modulus", [None, 16, 65536])
@pytest.mark.parametrize("rate_Hz", [20.0, 50.0, 60.0, 100.0, 150.0, 240.0, 400.0, 1000.0])
def test_a_wrong_rate_is_named(rate_Hz: float, modulus: int | None) -> None:
    found = first_complaint(steady(rate_Hz, round(100 + 1.1 * rate_Hz), modulus), modulus)
    assert found is not None
    when_s, cause = found
    assert when_s <= 1.0 + 91.0 / rate_Hz
    measured = cause.partition("sends ")[2].partition(" readings/s")[0]
    assert float(measured) == pytest.approx(rate_Hz, rel=0.02)
    assert "expected 120/s" in cause


@pytest.mark.parametrize(
    ("rate_Hz", "cause"),
    [
        (120.0, "the drive counts 240 half cycles/s, expected 120/s"),
        (60.0, "the drive sends 60 readings/s"),  # half of the ticks run on held values
    ],
)
def test_a_counter_that_counts_by_two_is_named(rate_Hz: float, cause: str) -> None:
    found = first_complaint(steady(rate_Hz, 400, 256, per_frame=2), 256)
    assert cause in (found or (0.0, ""))[1]


SELDOM: Sent = (300, 2.0, 2, True)


def sent(*parts: tuple[int, float]) -> list[Sent]:
    """Readings that count a half cycle each, so many half cycles apart."""
    return [(count, after, 1, False) for count, after in parts]


@pytest.mark.parametrize(
    ("stride", "readings", "judged", "cause"),
    [
        (1, sent((59, 1.0)), False, None),  # half a second
        (1, sent((60, 1.0)), True, None),
        (STRIDE, [(9, 12.0, STRIDE, False)], False, None),  # ten readings
        (STRIDE, [(10, 12.0, STRIDE, False)], True, None),
        # 6 % of the line and 2 half cycles of jitter in 30: 12.7 % of the time
        (1, sent((60, 1.0 / 1.14)), True, None),
        (1, sent((60, 1.0 / 1.15)), False, None),
        (1, sent((60, 1.0 / 0.89)), True, None),
        (1, sent((240, 1.0), (30, 0.5)), False, None),  # for a second
        (1, sent((240, 1.0), (269, 0.5)), False, None),
        (1, sent((240, 1.0), (270, 0.5)), False, "sends 256 readings/s"),
        (1, sent((240, 1.0), (300, 0.5), (59, 1.0)), False, "sends "),  # half of the window
        (1, sent((240, 1.0), (300, 0.5), (60, 1.0)), True, None),
        (1, sent((100, 0.0)), False, None),  # all at once
        (STRIDE, [(60, 9.6, STRIDE, False)], False, "sends 13.33 readings/s, expected 10.67/s"),
        (1, [SELDOM], False, "the drive sends 64 readings/s, expected 128/s"),
        (1, [SELDOM, (300, 1.0, 1, False)], True, None),
        (1, [(300, 1.0, 1, True)], True, None),  # late
        (1, [(300, 2.0, 2, False)], True, None),  # lost in a stall
        (1, [(1, 1.0, 1, False), (9, 2.0, 2, True)] * 60, True, None),  # nine in ten
    ],
)  # fmt: skip
def test_the_bounds_within_which_a_rate_is_believed(
    stride: int, readings: list[Sent], judged: bool, cause: str | None
) -> None:
    rate = rate_of(stride, readings)
    assert rate.judged is judged
    assert (rate.cause is None) is (cause is None)
    assert (cause or "") in str(rate.cause)


def rate_of(stride: int, readings: list[Sent], *, counted: bool = True) -> FrameRate:
    rate, now_s = FrameRate(EXACT_S, stride, counted=counted), 64.0
    rate.add(now_s, None, stood_in=False)
    for count, after, steps, stood_in in readings:
        for _ in range(count):
            now_s += after * EXACT_S
            rate.add(now_s, steps, stood_in=stood_in)
    return rate


@pytest.mark.parametrize("counted", [False, True])
def test_without_a_counter_frames_of_the_right_rate_survive_jitter(*, counted: bool) -> None:
    """Time takes every second of them for two half cycles."""
    rate = rate_of(1, [(1, 0.4, 1, False), (1, 1.6, 2, False)] * 200, counted=counted)
    assert (rate.cause is None) is not counted


@st.composite
def honest_drives(draw: st.DrawFn, jitter_ticks: float) -> list[tuple[int, float]]:
    """Half cycle and arrival of each frame: a line off by 2 %, jitter, bursts lost, outages."""
    generator = np.random.default_rng(draw(st.integers(0, 2**32)))
    tick_s = TICK_S / draw(st.floats(0.98, 1.02))
    jitter_s = draw(st.floats(0.0, jitter_ticks)) * TICK_S
    lost_share, longest = draw(st.floats(0.0, 0.1)), draw(st.integers(1, 30))
    outage_at, outage = draw(st.integers(0, 1000)), draw(st.integers(0, 3000))
    frames, half_cycle, last_s = [], draw(st.integers(0, 70_000)), 0.0
    for number in range(1000):
        half_cycle += 1
        if number == outage_at:
            half_cycle += outage
        if generator.random() < lost_share / longest:
            half_cycle += int(generator.integers(1, longest + 1))
        last_s = max(last_s, half_cycle * tick_s + generator.uniform(0.0, jitter_s))
        frames.append((half_cycle, last_s))
    return frames


@pytest.mark.parametrize(("modulus", "jitter_ticks"), [(16, 2.5), (65536, 2.5), (None, 0.7)])
@settings(max_examples=15)
@given(data=st.data())
def test_a_disturbed_drive_of_the_right_rate_is_believed(
    modulus: int | None, jitter_ticks: float, data: st.DataObject
) -> None:
    frames = data.draw(honest_drives(jitter_ticks))
    counted = ((modulus and count % modulus, time_s) for count, time_s in frames)
    assert first_complaint(counted, modulus) is None


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
    frames = ((int(c), 1.0 + 0.2 * TICK_S * i) for i, c in enumerate(counts))
    assert "readings/s, expected 120/s" in (first_complaint(frames, modulus) or (0.0, ""))[1]


@pytest.mark.parametrize("kept", [False, True])
@given(
    stalls=st.lists(st.tuples(st.integers(60, 200), st.integers(1, 60)), min_size=1, max_size=20),
    modulus=st.sampled_from([16, 256, 65536]),
)
def test_frames_that_waited_in_a_stall_are_no_wrong_rate(
    stalls: list[tuple[int, int]], modulus: int, *, kept: bool
) -> None:
    """They come at once at its end, or only the newest does; no stand-in could run meanwhile."""
    base, counted = HalfCycles(modulus, EXACT_S), 0
    for prompt, stalled in stalls:
        for late in (*[0] * prompt, *range(stalled, 0, -1)):
            counted += 1
            if kept or late <= 1:
                base.place(counted % modulus, (counted + late) * EXACT_S, counted)
            assert base.rate.cause is None


@pytest.mark.parametrize("stride", [1, 2, 12, 120])
@pytest.mark.parametrize("jump_at", [0, 17, 44])
def test_the_rate_of_a_steady_drive_is_known_in_time(stride: int, jump_at: int) -> None:
    """Wherever in the window its counter has jumped."""
    base, latest, counter = HalfCycles(65536, TICK_S, stride), -1, 0
    for number in range(jump_at + verdict_ticks(stride) // stride):
        counter += stride + 1000 * (number == jump_at)
        latest = base.place(counter % 65536, 100.0 + number * stride * TICK_S, latest)
    assert base.rate.judged


@pytest.mark.parametrize("rate_Hz", [60.0, 100.0, 400.0])
@pytest.mark.parametrize("earlier", [1, 75, None])
async def test_a_drive_enabled_early_is_never_energised_wrongly(
    rate_Hz: float, earlier: int | None
) -> None:
    """One that is enabled when its rate is known to be wrong is refused."""
    async with fast_bench(modulus=None) as bench:
        if earlier is not None:
            bench.frames(earlier, 1.0 / rate_Hz)
            bench.ask(Enable())
        bench.frames(round(150 + rate_Hz), 1.0 / rate_Hz)
        if earlier is None:
            with pytest.raises(RefusedError, match=rf"sends {rate_Hz:g}\S* readings/s, expected"):
                bench.ask(Enable())
        else:
            assert bench.trip.startswith("frame rate: the drive ")
        assert set(bench.sent) == {SAFE_COMMAND}


async def test_a_rate_that_goes_wrong_later_trips() -> None:
    async with running_bench(frames=300) as bench:
        assert bench.state() is State.RUNNING
        bench.frames(300, 0.01)
        assert bench.state() is State.TRIPPED
        assert bench.trip.startswith("frame rate: the drive sends ")


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


@pytest.mark.parametrize(
    ("held", "stale_s"), [(2, 0.05), (7, 0.05), (9, 0.1), (10, 0.45), (40, 0.45), (100, 0.45)]
)
async def test_last_frames_that_are_repeated_in_turn_trip_as_one_does(
    held: int, stale_s: float
) -> None:
    """Buffers of a drive whose control hangs, or of a gateway: their values differ by the noise."""
    async with fast_bench(timed(stale_s=stale_s)) as bench:
        run_by_hand(bench, None)
        bench.frames(held)
        for number in range(math.ceil(1.1 * stale_s / TICK_S)):
            assert number > 5 or bench.state() is State.RUNNING
            bench.frame(steps=1 if number % held else 1 - held)
        assert bench.trip.startswith("half-cycle counter: the drive's count has ")


async def test_a_count_that_is_wrong_once_or_repeated_for_a_lost_one_trips_nothing() -> None:
    async with running_bench(frames=5) as bench:
        for leap in (-3, -20_000, 5000):
            bench.frame(steps=leap)
            bench.frame(steps=2 - leap)
            bench.frames(60)
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


async def test_a_count_that_stands_in_standby_trips_nothing_and_refuses_enable() -> None:
    async with fast_bench() as bench:
        bench.frames(70)
        bench.frames(200, steps=0)
        assert bench.state() is State.STANDBY
        with pytest.raises(RefusedError, match=r"half-cycle counter: .* stood for 1667 ms"):
            bench.ask(Enable())
        bench.frame()
        assert bench.loop.cause is None
