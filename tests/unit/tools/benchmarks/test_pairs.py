"""Ratios of paired measurements, their spread, and when they say nothing."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tools.benchmarks.paired.pairs import (
    BUSY,
    LEAST_TURNS,
    OutOfTimeError,
    Row,
    Spread,
    Turn,
    take_turns,
    time_box,
)

POSITIVE = st.floats(0.01, 100.0)


def row(*turns: Turn, most: float | None = None, most_ratio: float | None = None) -> Row:
    return Row("tick", "compiled", "us", "the script", turns, most, most_ratio)


def steady(ours: float = 3.0) -> list[Turn]:
    return [Turn(ours, 2.0, 2.0)] * LEAST_TURNS


@given(st.lists(POSITIVE, min_size=2))
def test_median_and_quartiles_are_those_of_numpy(values: list[float]) -> None:
    found = Spread.of(values)
    expected = np.quantile(values, [0.25, 0.5, 0.75])
    assert [found.low, found.median, found.high] == pytest.approx(expected)


@given(POSITIVE, POSITIVE, POSITIVE)
def test_a_ratio_is_that_to_the_mean_of_both_references(a: float, b: float, c: float) -> None:
    assert Turn(a, b, c).ratio == pytest.approx(a / np.mean([b, c]))


@given(POSITIVE, POSITIVE, st.lists(st.floats(0.1, 10.0), min_size=LEAST_TURNS))
def test_a_machine_that_becomes_slower_changes_no_ratio(
    ours: float, reference: float, speeds: list[float]
) -> None:
    found = row(*(Turn(ours * one, reference * one, reference * one) for one in speeds))
    assert not found.doubt
    assert found.ratio.median == pytest.approx(ours / reference)


def test_turns_alternate_and_ours_is_between_the_references() -> None:
    order = []

    def measure(name: str) -> Iterator[float]:
        while True:
            order.append(name)
            yield float(len(order))

    ours, reference = measure("ours"), measure("reference")
    turns = take_turns(2, lambda: next(ours), lambda: next(reference))
    assert turns == (Turn(2.0, 1.0, 3.0), Turn(5.0, 4.0, 6.0))
    assert order == ["reference", "ours", "reference"] * 2


def test_a_steady_row_is_told_with_its_quartiles() -> None:
    turns = [Turn(one, 2.0, 2.0) for one in (2.8, 2.9, 3.0, 3.1, 3.2)]
    assert row(*turns).cell == "1.50 (1.45–1.55), 3 us"


@pytest.mark.parametrize(
    ("turns", "reason"),
    [
        pytest.param(steady()[1:], "4 turns of 5", id="too few turns"),
        pytest.param(
            [Turn(3.0, 2.0, one) for one in (1.6, 1.7, 2.0, 2.3, 2.4)],
            "the reference over itself spreads from 0.85 to 1.15",
            id="a reference that differs from itself",
        ),
        pytest.param(
            [Turn(one, 2.0, 2.0) for one in (2.6, 2.6, 3.0, 3.4, 3.4)],
            "the ratio spreads from 1.30 to 1.70",
            id="a ratio that spreads",
        ),
    ],
)
def test_a_row_that_cannot_be_trusted_says_so(turns: list[Turn], reason: str) -> None:
    assert row(*turns).doubt == reason
    assert row(*turns, most_ratio=1.0).cell == BUSY


def test_a_reference_that_always_comes_second_hides_no_row() -> None:
    assert not row(*[Turn(3.0, 2.0, 1.6)] * LEAST_TURNS).doubt


def test_one_disturbed_turn_hides_no_row() -> None:
    assert not row(*steady(), Turn(30.0, 2.0, 7.0)).doubt


@pytest.mark.parametrize(
    ("more", "verdict"),
    [
        ({"most_ratio": 1.5}, "; within 1.5 x"),
        ({"most_ratio": 1.4}, "; over 1.4 x"),
        ({"most": 3.0}, "; within 3 us"),
        ({"most": 2.9}, "; over 2.9 us"),
    ],
)
def test_a_target_is_judged(more: dict[str, float], verdict: str) -> None:
    assert row(*steady(), **more).cell.endswith(verdict)


def test_what_takes_too_long_is_ended() -> None:
    with pytest.raises(OutOfTimeError, match=r"0\.01 s"), time_box(0.01):
        signal.pause()
    with time_box(60.0):
        pass
