"""Overshoot of half waves, sorted by controller and load."""

from __future__ import annotations

import pytest

from adaptdrive_sim.demo.story import Halves

LONG = 20
Half = tuple[float, list[float]]


def feed(
    halves: Halves, reference: float, outputs: list[float], case: tuple[str, int] = ("fixed", 1)
) -> None:
    for output in outputs:
        halves.add(reference, output, *case)


@pytest.mark.parametrize(
    ("waves", "overshoot"),
    [
        pytest.param(
            [(3.0, [3.0] * 5), (3.2, [3.1] * LONG + [3.23] + [3.2] * LONG)], 0.15, id="upwards"
        ),
        pytest.param(
            [(3.2, [3.2] * 5), (3.0, [3.1] * LONG + [2.98] + [3.0] * LONG)], 0.10, id="downwards"
        ),
        pytest.param(
            [(3.0, [3.0]), (3.2, [3.3] * LONG), (3.0, [2.98] * LONG), (3.2, [3.21] * LONG)],
            0.05,
            id="last of all",
        ),
        pytest.param([(3.0, [3.0]), (3.2, [3.1] * LONG)], 0.0, id="never arrives"),
        pytest.param([(3.0, [3.0]), (3.2, [3.3] * 5)], None, id="cut short"),
    ],
)
def test_overshoot_is_a_fraction_of_the_step(waves: list[Half], overshoot: float | None) -> None:
    halves = Halves()
    for reference, outputs in waves:
        feed(halves, reference, outputs)
    feed(halves, 3.0 if waves[-1][0] == 3.2 else 3.2, [3.0] * LONG)
    assert halves.overshoot("fixed", 1) == pytest.approx(overshoot)


def test_each_controller_and_load_has_its_own_and_a_change_ends_a_half_wave() -> None:
    halves = Halves()
    feed(halves, 3.0, [3.0])
    feed(halves, 3.2, [3.24] * LONG, ("fixed", 3))
    feed(halves, 3.0, [2.98] * LONG, ("adaptive", 3))
    feed(halves, 3.2, [3.202] * LONG, ("adaptive", 3))
    feed(halves, 3.2, [3.4] * LONG, ("adaptive", 2))
    feed(halves, 3.0, [3.05] * 4, ("adaptive", 2))
    feed(halves, 3.0, [2.982] * LONG, ("fixed", 2))  # adaptive fell back
    feed(halves, 3.2, [3.2], ("fixed", 2))
    assert halves.overshoot("fixed", 3) == pytest.approx(0.20)
    assert halves.overshoot("adaptive", 3) == pytest.approx(0.01)
    assert halves.overshoot("adaptive", 2) == pytest.approx(0.09)
    assert halves.overshoot("fixed", 2) is None
