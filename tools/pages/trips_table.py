"""The table of the trips in `docs/operation.md`, made from `safety/trips.toml`.

`python -m tools.pages.trips_table docs/operation.md` writes the table; a test keeps it current.
"""

import sys
from pathlib import Path

from adaptdrive.safety.trips import ADVICES
from tools.pages.marked import with_part

MARKS = "<!-- trips: written by `make docs` -->\n", "<!-- end of trips -->\n"

LONGEST = 10
"""Words of a trip that the table shows, from its beginning."""

_AGE = "measurement is 54 ms old, limit 50 ms; "
_OLDEST = "output (0x101 (DriveLoad), Tachometer) is the oldest value, 54 ms old: "


def shown(example: str) -> str:
    """Return the beginning of a trip, without what all that are stale have in common."""
    words = example.replace(_AGE + _OLDEST, "…: ").replace(f"{_AGE}the", "…; the").split()
    return " ".join(words if len(words) <= LONGEST else [*words[:LONGEST], "…"])


def table() -> str:
    """Return the table as Markdown."""
    rows = [
        f"| `{kind}` | `{shown(one.example)}` | {one.cause} | {one.remedy} |"
        for kind, one in ADVICES.items()
    ]
    return "\n".join(["| kind | text | cause | remedy |", "|---|---|---|---|", *rows, ""])


def with_table(page: str) -> str:
    """Return a page with the table between its marks.

    Args:
        page: Text of the page.
    """
    return with_part(page, MARKS, table())


if __name__ == "__main__":
    path = Path(sys.argv[1])
    path.write_text(with_table(path.read_text(encoding="utf-8")), encoding="utf-8")
