"""The table of the trips in `docs/operation.md`, made from `safety/trips.toml`.

`python -m tools.pages.trips_table docs/operation.md` writes the table; a test keeps it current.
"""

import sys
from pathlib import Path

from adaptdrive.safety.trips import ADVICES
from tools.pages.marked import with_part

MARKS = "<!-- trips: written by `make docs` -->\n", "<!-- end of trips -->\n"


def table() -> str:
    """Return the table as Markdown."""
    rows = [f"| `{kind}` | {one.cause} | {one.remedy} |" for kind, one in ADVICES.items()]
    return "\n".join(["| kind | cause | remedy |", "|---|---|---|", *rows, ""])


def with_table(page: str) -> str:
    """Return a page with the table between its marks.

    Args:
        page: Text of the page.
    """
    return with_part(page, MARKS, table())


if __name__ == "__main__":
    path = Path(sys.argv[1])
    path.write_text(with_table(path.read_text(encoding="utf-8")), encoding="utf-8")
