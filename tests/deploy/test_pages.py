"""The pages of the manual keep their form."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("tests/*.md")])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_row_of_a_table_belongs_to_a_header(page: Path) -> None:
    """A blank line within a table would show the rest of it as plain text."""
    lines = page.read_text().splitlines()
    for number, (before, row, after) in enumerate(
        zip(lines, lines[1:], lines[2:], strict=False), start=2
    ):
        if row.startswith("|") and not before.startswith("|"):
            assert re.fullmatch(r"\|[\s:|-]+", after), f"{page.name}:{number}: {row}"
