"""Set-points that move by themselves: waveforms against scipy's, and ramps."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from adaptdrive.control.signals import MovingReference, Ramp, Shape, Waveform

ORACLES = {
    Shape.SQUARE: lambda phase: 0.5 + 0.5 * signal.square(2.0 * np.pi * phase),
    Shape.SINE: lambda phase: 0.5 + 0.5 * np.sin(2.0 * np.pi * phase),
    Shape.TRIANGLE: lambda phase: 0.5 + 0.5 * signal.sawtooth(2.0 * np.pi * phase + np.pi / 2, 0.5),
}


@pytest.mark.parametrize("shape", list(Shape))
def test_a_period_has_the_shape_that_its_name_says(shape: Shape) -> None:
    wave = Waveform(shape, low=3.0, high=3.2, period_s=120.0)
    for elapsed_s in np.arange(0.5, 400.0, 7.3):
        expected = 3.0 + 0.2 * ORACLES[shape](elapsed_s / 120.0)
        assert wave.value(float(elapsed_s)) == pytest.approx(expected, abs=1e-9)


@given(st.sampled_from(Shape), st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.integers(-9, 10**9))
def test_a_waveform_is_recorded_without_a_loss(
    shape: Shape, low: float, high: float, tick: int
) -> None:
    known = MovingReference(Waveform(shape, low, high, 0.1 * (1.0 + abs(high))), tick)
    assert MovingReference.parse(str(known)) == known


LEVEL, SLOPE = st.floats(-1e3, 1e3), st.floats(1e-6, 1e6)


@given(LEVEL, LEVEL, SLOPE, st.integers(-9, 10**9))
def test_a_ramp_is_recorded_without_a_loss(
    start: float, end: float, slope: float, tick: int
) -> None:
    known = MovingReference(Ramp(start, end, slope), tick)
    assert MovingReference.parse(str(known)) == known


@given(LEVEL, LEVEL, SLOPE, st.lists(st.integers(0, 10**6), min_size=2))
def test_a_ramp_is_the_line_between_two_points_and_then_its_end(
    start: float, end: float, slope: float, ticks: list[int]
) -> None:
    tick_s, ramp = 1.0 / 120.0, MovingReference(Ramp(start, end, slope), 7)
    arrival_s = abs(end - start) / slope
    for tick in ticks:
        line = np.interp(tick * tick_s, [0.0, max(arrival_s, 1e-12)], [start, end])
        assert ramp.value(7 + tick, tick_s) == pytest.approx(line, abs=1e-9)
    assert ramp.value(7 + int(arrival_s / tick_s) + 2, tick_s) == end
