"""Set-point waveforms against scipy's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from adaptdrive.control.signals import KnownWaveform, Shape, Waveform

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
def test_a_known_waveform_is_recorded_without_a_loss(
    shape: Shape, low: float, high: float, tick: int
) -> None:
    known = KnownWaveform(Waveform(shape, low, high, 0.1 * (1.0 + abs(high))), tick)
    assert KnownWaveform.parse(str(known)) == known
