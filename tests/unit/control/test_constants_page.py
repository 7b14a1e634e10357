"""The page of the constants is what the code has."""

from __future__ import annotations

from pathlib import Path

from tools.pages.constants_effects import read_effects
from tools.pages.constants_page import constants, following, given, page, units

PAGE = Path(__file__).parents[3] / "docs" / "proof" / "constants.md"


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
