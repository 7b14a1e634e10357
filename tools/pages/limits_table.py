"""The limits of time in `docs/proof/obedience.md`, made from `Timing` and the example drives.

`python -m tools.pages.limits_table docs/proof/obedience.md` writes them; a test keeps them current.
"""

from __future__ import annotations

import inspect
import math
import sys
from pathlib import Path

from adaptdrive.config import load_configuration
from adaptdrive.safety.timing import Timing, timing_of
from tools.pages.marked import with_part

MARKS = "<!-- limits: written by `make docs` -->\n", "<!-- end of limits -->\n"
EXAMPLES = Path(__file__).parents[2] / "deploy" / "examples"
DRIVES = ("motor", "motor-modbus-tcp", "motor-cia402")


def limits() -> dict[str, property]:
    """Return the limits of `Timing`, by name, in their order."""
    members = vars(Timing).items()
    return {name: one for name, one in members if isinstance(one, property) and name[0] != "_"}


def _shown(seconds: float) -> str:
    return "none" if math.isinf(seconds) else f"{seconds * 1e3:.4g} ms"


def table() -> str:
    """Return the table as Markdown: each limit, its meaning, and its value for three drives."""
    drives = [timing_of(load_configuration(EXAMPLES / f"{name}.toml")) for name in DRIVES]
    heads = ["limit", "meaning", *(f"`{name}.toml`" for name in DRIVES)]
    lines = [f"| {' | '.join(heads)} |", "|" + "---|" * len(heads)]
    for name, limit in limits().items():
        meaning = (inspect.getdoc(limit) or "").partition("\n")[0].rstrip(".")
        values = (_shown(getattr(timing, name)) for timing in drives)
        lines.append(f"| `{name}` | {meaning} | {' | '.join(values)} |")
    return "\n".join([*lines, ""])


def with_table(page: str) -> str:
    """Return a page with the table between its marks.

    Args:
        page: Text of the page.
    """
    return with_part(page, MARKS, table())


if __name__ == "__main__":
    path = Path(sys.argv[1])
    path.write_text(with_table(path.read_text(encoding="utf-8")), encoding="utf-8")
