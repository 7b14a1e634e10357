"""The plot in braille characters, read back dot by dot."""

from __future__ import annotations

import pytest

from adaptdrive.tui.record import Mark, PlotPoint, plot

WIDTH, HEIGHT = 66, 14
LABEL = 6
DOTS = {0: (0, 0), 1: (0, 1), 2: (0, 2), 3: (1, 0), 4: (1, 1), 5: (1, 2), 6: (0, 3), 7: (1, 3)}
"""Column and row of each bit of a braille character, from the Unicode standard."""


def dots(text: str) -> set[tuple[int, int]]:
    """Column and row of every dot of a plot's canvas."""
    found = set()
    for line, characters in enumerate(text.splitlines()[1:-1]):
        for cell, character in enumerate(characters[LABEL:]):
            bits = ord(character) - 0x2800
            for bit, (column, row) in DOTS.items():
                if bits >> bit & 1:
                    found.add((2 * cell + column, 4 * line + row))
    return found


def points(reference: float, *outputs: float) -> list[PlotPoint]:
    """One point each second, the last one at 100 s."""
    first_s = 101.0 - len(outputs)
    return [PlotPoint(first_s + i, reference, output) for i, output in enumerate(outputs)]


def drawn(shown: list[PlotPoint], window_s: float = 50.0, marks: tuple[Mark, ...] = ()) -> str:
    return plot(shown, marks, 100.0, window_s, (WIDTH, HEIGHT)).plain


def test_has_the_size_asked_for() -> None:
    lines = drawn(points(3.0, *[3.1] * 40)).splitlines()
    assert len(lines) == HEIGHT
    assert {len(line) for line in lines} == {WIDTH}


def test_a_higher_value_stands_higher() -> None:
    rising = points(3.0, *(3.0 + 0.01 * i for i in range(40)))
    reference_row = 4 * (HEIGHT - 2) - 1
    tops: dict[int, int] = {}
    for column, row in dots(drawn(rising)):
        tops[column] = min(row, tops.get(column, reference_row))
    heights = [tops[column] for column in sorted(tops)]
    assert heights == sorted(heights, reverse=True)
    assert heights[0] - heights[-1] > 30


def test_a_step_leaves_no_gap() -> None:
    stepped = points(3.0, *[3.0] * 20, *[3.4] * 20)
    rows = {row for _, row in dots(drawn(stepped))}
    assert rows == set(range(min(rows), max(rows) + 1))


def test_names_the_reference_at_its_height() -> None:
    lines = drawn([*points(3.0, *[3.0] * 40)[:20], *points(3.2, *[3.2] * 20)]).splitlines()
    assert sum(line.startswith(" 3.20 ") for line in lines) == 1
    assert sum(line.startswith(" 3.00 ") for line in lines) == 1


def test_marks_stand_above_their_time() -> None:
    shown = drawn(points(3.0, *[3.1] * 50), marks=((75.0, "2 disks"), (20.0, "too old")))
    marks = shown.splitlines()[0]
    assert "too old" not in marks
    middle = LABEL + (WIDTH - LABEL) // 2  # 75 s is half way between 50 s and 100 s
    assert marks.index("▼2 disks") == pytest.approx(middle, abs=1)


@pytest.mark.parametrize("size", [(5, 3), (66, 3), (10, 14)])
def test_has_no_room(size: tuple[int, int]) -> None:
    assert "waiting" in plot(points(3.0, 3.1), (), 100.0, 50.0, size).plain
