from pathlib import Path

from tools.pages.columns_page import page

PAGE = Path(__file__).parents[3] / "docs" / "columns.md"


def test_the_page_of_the_columns_is_current() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "run `make docs`"
