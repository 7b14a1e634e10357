"""The screen opens within five samples of an honest change, whatever the signal was before."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.control.screen import LASTING, Screen, pass_sample

CLIP = 5.0
STEP = 0.026


def still(kind: str, level: float) -> Iterator[float]:
    """Yield a thousand samples of a load at rest."""
    for number in range(1000):
        match kind:
            case "constant":
                yield level
            case "quantised":
                yield round(level / STEP) * STEP
            case _:
                yield round(level / STEP + 0.5 * (number % 2)) * STEP


@pytest.mark.parametrize("kind", ["constant", "quantised", "one digit up and down"])
@given(
    level=st.sampled_from([0.0, 0.003, 75.0]),
    change=st.floats(-100.0, 100.0),
    ticks=st.integers(1, 12),
)
def test_a_change_after_a_standstill_passes_in_five(
    kind: str, level: float, change: float, ticks: int
) -> None:
    screen = Screen(level, 0.0, 0.01 * level)
    for sample in still(kind, level):
        pass_sample(screen, sample, CLIP, ticks)
    passed = [pass_sample(screen, level + change, CLIP, ticks) for _ in range(3 * LASTING)]
    assert passed[LASTING - 1 :] == pytest.approx([level + change] * (2 * LASTING + 1), abs=STEP)


@given(spikes=st.lists(st.floats(10.0, 1e6), min_size=1, max_size=LASTING - 1))
def test_fewer_spikes_than_five_count_as_deviations(spikes: list[float]) -> None:
    """However high they are, no sample passes further than the limit, which each may double."""
    screen = Screen(1.0, 0.0, 0.01)
    for spike in spikes:
        assert pass_sample(screen, spike, CLIP, 1) < 1.0 + CLIP * 0.01 * 2.0 ** len(spikes)
