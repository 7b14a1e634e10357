"""The table of the trips in `docs/operation.md`, made from the registry of `runtime/trips.toml`.

`python -m tools.pages.trips_table docs/operation.md` writes the table; a test keeps it current.
"""

import re
import sys
from pathlib import Path

from adaptdrive.mqtt.contract import TRIPS

BEGIN, END = "<!-- trips: written by `make docs` -->\n", "<!-- end of trips -->\n"


LONGEST = 10
"""Words of a trip that the table shows, from its beginning."""


def shown(example: str) -> str:
    """Return the beginning of a trip that tells it from others."""
    text = re.sub(r"^stale: measurement is .*?(; the polls|54 ms old: )", _part, example)
    words = text.split()
    return text if len(words) <= LONGEST else f"{' '.join(words[:LONGEST])} …"


def _part(found: re.Match[str]) -> str:
    return f"stale: …{found[1].removeprefix('54 ms old')}"


def table() -> str:
    """Return the table as Markdown."""
    rows = [
        f"| `{shown(trip['example'])}` | {trip['cause']} | {trip['remedy']} |" for trip in TRIPS
    ]
    return "\n".join(["| trip | cause | remedy |", "|---|---|---|", *rows, ""])


def with_table(page: str) -> str:
    """Return a page with the table between its marks.

    Args:
        page: Text of the page.
    """
    before, rest = page.split(BEGIN)
    _, after = rest.split(END)
    return before + BEGIN + table() + END + after


if __name__ == "__main__":
    path = Path(sys.argv[1])
    path.write_text(with_table(path.read_text(encoding="utf-8")), encoding="utf-8")
