"""The page of the constants is what the code has."""

from __future__ import annotations

from pathlib import Path

from tests.control.constants_page import constants, page, units

PAGE = Path(__file__).parents[2] / "docs" / "constants.md"


def test_every_constant_has_a_unit_and_no_unit_is_left_over() -> None:
    assert {one.name for one in constants()} == units()


def test_every_constant_has_a_reason() -> None:
    assert [one.name for one in constants() if not one.reason] == []


def test_the_page_is_current() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "run `make docs`"
