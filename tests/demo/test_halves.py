"""Overshoot of half waves, sorted by controller and load."""

from __future__ import annotations

import pytest

from adaptdrive_sim.demo.record import Halves

LONG = 20


def feed(
    halves: Halves, reference: float, outputs: list[float], case: tuple[str, int] = ("fixed", 1)
) -> None:
    for output in outputs:
        halves.add(reference, output, *case)


def test_overshoot_is_a_fraction_of_the_step() -> None:
    halves = Halves()
    feed(halves, 3.0, [3.0] * 5)
    feed(halves, 3.2, [3.1] * LONG + [3.23] + [3.2] * LONG)
    feed(halves, 3.0, [3.0])
    assert halves.overshoot("fixed", 1) == pytest.approx(0.15)


def test_a_falling_step_overshoots_downwards() -> None:
    halves = Halves()
    feed(halves, 3.2, [3.2] * 5)
    feed(halves, 3.0, [3.1] * LONG + [2.98] + [3.0] * LONG)
    feed(halves, 3.2, [3.2])
    assert halves.overshoot("fixed", 1) == pytest.approx(0.10)


def test_the_larger_of_the_last_two_half_waves_counts() -> None:
    halves = Halves()
    feed(halves, 3.0, [3.0])
    for reference, peak in ((3.2, 3.3), (3.0, 2.98), (3.2, 3.21)):
        feed(halves, reference, [peak] * LONG)
    feed(halves, 3.0, [3.0])
    assert halves.overshoot("fixed", 1) == pytest.approx(0.10)


def test_a_speed_that_never_arrives_does_not_overshoot() -> None:
    halves = Halves()
    feed(halves, 3.0, [3.0])
    feed(halves, 3.2, [3.1] * LONG)
    feed(halves, 3.0, [3.0])
    assert halves.overshoot("fixed", 1) == 0.0


def test_what_comes_after_a_change_is_not_counted() -> None:
    halves = Halves()
    feed(halves, 3.0, [3.0])
    feed(halves, 3.2, [3.2] * LONG, ("fixed", 1))
    feed(halves, 3.2, [3.4] * LONG, ("fixed", 2))
    feed(halves, 3.0, [3.0], ("fixed", 2))
    assert halves.overshoot("fixed", 1) == pytest.approx(0.0)
    assert halves.overshoot("fixed", 2) is None


def test_each_controller_has_its_own() -> None:
    halves = Halves()
    feed(halves, 3.0, [3.0])
    feed(halves, 3.2, [3.24] * LONG, ("fixed", 3))
    feed(halves, 3.0, [2.998] * LONG, ("adaptive", 3))
    feed(halves, 3.2, [3.2], ("adaptive", 3))
    assert halves.overshoot("fixed", 3) == pytest.approx(0.20)
    assert halves.overshoot("adaptive", 3) == pytest.approx(0.01)


def test_a_half_wave_that_is_cut_short_says_nothing() -> None:
    halves = Halves()
    feed(halves, 3.0, [3.0])
    feed(halves, 3.2, [3.3] * 5)
    feed(halves, 3.0, [3.0] * LONG)
    assert halves.overshoot("fixed", 1) is None
