"""The part of a page that is made from the code: it stands between two marks."""

Marks = tuple[str, str]
"""The mark before the part, and the one behind it."""


def with_part(page: str, marks: Marks, part: str) -> str:
    """Return a page with another part between its marks.

    Args:
        page: Text of the page.
        marks: Its marks, each of which occurs once.
        part: What stands between them.
    """
    begin, end = marks
    before, rest = page.split(begin)
    _, after = rest.split(end)
    return before + begin + part + end + after
