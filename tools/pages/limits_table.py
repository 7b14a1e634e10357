"""The tables in `docs/proof/obedience.md`: doubts and verdicts, and the limits of `Timing`.

`python -m tools.pages.limits_table docs/proof/obedience.md` writes them; a test keeps them current.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

from adaptdrive.config import load_configuration
from adaptdrive.safety.monitor import FACTS, Doubt, Verdict
from adaptdrive.safety.timing import Timing, timing_of
from tools.pages.marked import with_part

MARKS = "<!-- limits: written by `make docs` -->\n", "<!-- end of limits -->\n"
FOLD_MARKS = "<!-- fold: written by `make docs` -->\n", "<!-- end of fold -->\n"
CHECKOUT = Path(__file__).parents[2]
EXAMPLES = CHECKOUT / "deploy" / "examples"
DRIVES = ("motor", "motor-modbus-tcp")


def limits() -> list[str]:
    """Return the names of the limits of `Timing`, in their order."""
    members = vars(Timing).items()
    return [name for name, one in members if isinstance(one, property) and name[0] != "_"]


def _shown(seconds: float) -> str:
    return "none" if math.isinf(seconds) else f"{seconds * 1e3:.4g} ms"


def fold() -> str:
    """Return the fold as Markdown: doubts, and verdicts."""
    lines = ["| doubt | fact | a trip says | ends with a report that was |", "|---|---|---|---|"]
    for doubt in Doubt:
        shown = doubt.value.replace("{:.0f}", "…")
        ends = f"{'came' if doubt is Doubt.SILENT else 'asked for'} after it"
        lines.append(f"| `{doubt.name}` | {FACTS[doubt]} | … {shown} | {ends} |")
    lines += ["", "| verdict | |", "|---|---|"]
    lines += [f"| `{verdict.name}` | {verdict.value} |" for verdict in Verdict]
    return "\n".join([*lines, ""])


def table() -> str:
    """Return the table as Markdown: each limit, and its value for two drives."""
    drives = [timing_of(load_configuration(EXAMPLES / f"{name}.toml")) for name in DRIVES]
    heads = ["limit", *(f"`{name}.toml`" for name in DRIVES)]
    lines = [f"| {' | '.join(heads)} |", "|" + "---|" * len(heads)]
    for name in limits():
        values = (_shown(getattr(timing, name)) for timing in drives)
        lines.append(f"| `{name}` | {' | '.join(values)} |")
    return "\n".join([*lines, ""])


def with_table(page: str) -> str:
    """Return a page with its tables between their marks.

    Args:
        page: Text of the page.
    """
    return with_part(with_part(page, MARKS, table()), FOLD_MARKS, fold())


if __name__ == "__main__":
    path = Path(sys.argv[1])
    path.write_text(with_table(path.read_text(encoding="utf-8")), encoding="utf-8")
