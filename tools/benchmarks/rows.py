"""Rows of the table: ours, what it is held against, and the target."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")


@dataclass(frozen=True)
class Extent:
    """How long to measure.

    Attributes:
        quick: Seconds instead of minutes, for a first look.
        minutes: Of ticks on the timer, for rare late ones.
        shortest: Only to see that each part can be measured.
    """

    quick: bool
    minutes: float
    shortest: bool = False

    def pick(self, whole: T, quick: T, shortest: T) -> T:
        """Return what this extent takes of a part."""
        return shortest if self.shortest else quick if self.quick else whole


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes:
        name: What is measured.
        ours: Our figure.
        reference: The figure it is held against, measured in the same run.
        against: What that is.
        unit: Of both.
        target: What is wanted, in words.
        met: Whether it is so; None without a target.
        note: What else must be known.
    """

    name: str
    ours: float
    unit: str
    reference: float | None = None
    against: str = ""
    target: str = ""
    met: bool | None = None
    note: str = ""

    @property
    def ratio(self) -> float | None:
        """Ours over the reference."""
        return self.ours / self.reference if self.reference else None


def quantile(values: Sequence[float], share: float) -> float:
    """The value that a share of the values does not exceed."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


def table(rows: Sequence[Row]) -> Iterator[str]:
    """The rows as text."""
    head = f"{'':58} {'ours':>10} {'against':>10} {'ratio':>7}  unit  target"
    yield head
    for row in rows:
        reference = "" if row.reference is None else f"{row.reference:.4g}"
        ratio = "" if row.ratio is None else f"{row.ratio:.3g}"
        verdict = {None: "", True: "met", False: "NOT MET"}[row.met]
        yield (
            f"{row.name:58} {row.ours:10.4g} {reference:>10} {ratio:>7}  {row.unit:4}  "
            f"{row.target} {verdict}"
        ).rstrip()
        extra = "; ".join(part for part in (row.against, row.note) if part)
        if extra:
            yield f"    {extra}"


def write_json(rows: Sequence[Row], facts: dict[str, object], path: Path) -> None:
    """Write the rows, with their ratios, and what is known of the machine."""
    path.parent.mkdir(parents=True, exist_ok=True)
    content = facts | {"rows": [asdict(row) | {"ratio": row.ratio} for row in rows]}
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
