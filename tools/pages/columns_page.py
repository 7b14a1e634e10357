"""The page of the columns, made from the dataclasses that declare them.

`python -m tools.pages.columns_page docs/columns.md` writes the page; a test keeps it true.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

from adaptdrive.runtime.reports import SLOW_COLUMNS, TICK_COLUMNS
from adaptdrive.util.quantity import Column

_HEAD = """\
# Columns

For those who read records or telemetry: the columns of a session and of `telemetry/load`. `make
docs` writes this page from the dataclasses in `control/signals.py` and `runtime/reports.py`.

On disk each row begins with `utc`, its wall-clock time: `monotonic_s` plus the offset of the two
clocks when the row was flushed. Each column carries `unit`, `description` and `source` as
metadata of its Arrow field.

Unit `y` is that of the output, and `u` that of the load's input; both depend on the load
([control.md](proof/control.md)). Unit `v` is that of `[drive.manipulated]`, V where nothing
else is named; what it names is meant by boost voltage, v_bst and V_c then. Estimates are in SI. An
unknown number is NaN on disk and `null` in a message.
"""
_TABLES = (
    ("## A slow step: `telemetry/load` and `slow-….parquet`", SLOW_COLUMNS),
    ("## A fast tick: `ticks-….parquet`", TICK_COLUMNS),
)
_KINDS = {
    float: "float",
    int: "integer",
    bool: "boolean",
    str: "text",
    tuple: "list of floats",
    dict: "estimates",
}


def page() -> str:
    """The whole page."""
    parts = [_HEAD]
    for title, columns in _TABLES:
        parts += [title, _table(columns)]
    return "\n".join(parts)


def _table(columns: Sequence[Column]) -> str:
    rows = [f"| `{c.name}` | {_KINDS[c.kind]} | {c.unit} | {c.meaning} |" for c in columns]
    return "\n".join(["", "| name | type | unit | meaning |", "|---|---|---|---|", *rows, ""])


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(), encoding="utf-8")
