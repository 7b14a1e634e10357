"""The page of the constants is what the code has."""

from __future__ import annotations

from pathlib import Path

from tools.pages.constants_effects import COLUMNS, read_effects
from tools.pages.constants_page import constants, following, given, page, units

PAGE = Path(__file__).parents[2] / "docs" / "proof" / "constants.md"


def test_every_constant_has_a_unit_and_no_unit_is_left_over() -> None:
    assert {one.name for one in constants()} == units()


def test_every_constant_has_a_reason() -> None:
    numbers = [*constants(), *following(), *given()]
    assert [f"{one.module}: {one.name}" for one in numbers if not one.reason] == []


def test_every_effect_was_measured_with_a_present_constant() -> None:
    present = {(one.module, one.name) for one in constants()}
    assert {row[:2] for row in read_effects() if row} <= present


def test_the_page_is_current() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "run `make docs`"


def test_the_page_shows_the_effect_of_the_present_value_alone(tmp_path: Path) -> None:
    path = tmp_path / "constants.tsv"
    usual = ("", "", "", "", "", "1", "1", "2", "0", "0")
    gain = ("control/watch.py", "CLOSER", "0.9")
    rows = [
        usual,
        (*gain, "halved", "1.05", "1.2345", "0.98", "3", "0", "17"),
        (*gain[:2], "1.3", "doubled", "1.6", "9", "9", "9", "9", "9"),
        ("control/cycling.py", "AT_LIMIT", "0.1", "halved", "0.05", "1", "1", "2", "0", "0"),
    ]
    lines = ["\t".join(row) for row in (COLUMNS, *rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    shown = page(read_effects(path)).splitlines()
    (closer,) = (line for line in shown if "`CLOSER`" in line)
    (cycling,) = (line for line in shown if "`AT_LIMIT`" in line)
    assert closer.endswith("| 1.23/0.98, 3 worse |  |")
    assert cycling.endswith("| same |  |")


def test_without_a_measurement_the_page_has_no_such_columns(tmp_path: Path) -> None:
    assert "halved" not in page(read_effects(tmp_path / "none.tsv"))
