"""Write the table of the faults of the wire into the documentation.

`python -m tools.pages.wire_faults MEASURED PAGE` takes the times that a run of
`tests/integration/wire/test_matrix.py` with `WIRE_REPORT=MEASURED` has measured.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path

from tests.integration.wire.matrix import LINKS, ROWS, Cell, Row

BEGIN, END = "<!-- wire faults -->\n", "<!-- end of wire faults -->\n"


def table(measured: Mapping[str, Mapping[str, float]]) -> str:
    """The matrix in Markdown."""
    head = "| fault | on CAN | on Modbus TCP | on Modbus RTU | test |\n|---|---|---|---|---|\n"
    return head + "".join(_row(row, measured) for row in ROWS)


def _row(row: Row, measured: Mapping[str, Mapping[str, float]]) -> str:
    cells = [_cell(f"{row.name}-{link}", getattr(row, link), measured) for link in LINKS]
    return f"| {row.label} | {' | '.join(cells)} | `[{row.name}-…]` |\n"


def _cell(name: str, cell: Cell | str, measured: Mapping[str, Mapping[str, float]]) -> str:
    if isinstance(cell, str):
        return f"({cell})"
    times = measured.get(name, {})
    shown = [f"`{cell.count}`"] if cell.count else []
    shown += ["event `bus`"] if cell.words else []
    if not cell.trips:
        return "; ".join([*(shown or ["`held`"]), "continues"])
    shown += [] if cell.cause == "stale" else [f"trip `{cell.cause}`"]
    told = f"{_ms(times, 'reaction_ms')}/{_ms(times, 'back_ms')}"
    return "; ".join([*shown, told if cell.hears else f"trip {told}"])


def _ms(times: Mapping[str, float], name: str) -> str:
    return f"{times[name]:.0f}" if name in times else "?"


def without_times(text: str) -> str:
    """A table without its measured times."""
    return re.sub(r"(\d+|\?)/(\d+|\?)", "…", text)


def section(page: str) -> str:
    """The table as it stands in a page."""
    return page.partition(BEGIN)[2].partition(END)[0]


def main(report: Path, page: Path) -> None:
    """Write the table into a page."""
    text = page.read_text(encoding="utf-8")
    new = table(json.loads(report.read_text(encoding="utf-8")))
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    page.write_text(f"{before}{BEGIN}{new}{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
