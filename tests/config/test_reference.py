"""The reference page says what the models check."""

from __future__ import annotations

from pathlib import Path

from tests.config.reference_page import reference_page

PAGE = Path(__file__).parents[2] / "docs" / "configuration.md"


def test_the_committed_page_is_current() -> None:
    assert PAGE.read_text(encoding="utf-8") == reference_page(), "run `make docs`"


def test_every_key_has_a_meaning() -> None:
    keys = [line for line in reference_page().splitlines() if line.startswith("| `")]
    assert len(keys) > 40
    assert [key for key in keys if key.endswith("|  |")] == []
