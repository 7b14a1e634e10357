"""Read what it does to the campaigns to halve and to double each constant.

`python -m tools.benchmarks.constants tools/pages/constants.tsv` measures it.
"""

from __future__ import annotations

import csv
from pathlib import Path

PATH = Path(__file__).with_name("constants.tsv")

SEEDS = {"standard.toml": range(95_001, 95_031), "wide.toml": range(96_001, 96_031)}
"""Runs of each campaign."""

CHANGES = ("halved", "doubled")
UNCHANGED = ()
COLUMNS = (
    *("module", "name", "value", "change", "changed"),
    *("standard_cost", "wide_cost", "worse", "lost", "differ"),
)

Row = dict[str, str]
Effects = dict[tuple[str, ...], Row]

_HEAD = """\
Last columns: {runs} with half and with twice the constant (of poles and of ratios next to 1, the
distance from 1): sum of the [costs](campaign.md#criteria) of the adaptive controller over that with
the constant unchanged, standard/wide. *Worse*: runs that cost over 5 % more than with the fixed
controller, where they are not {worse}. *Lost*: unstable or tripped runs, where they are not {lost}.
*Same*: every run is bit-equal. An empty cell: not measured with this value, or with the present
bank of branches.
"""


def read_effects(path: Path = PATH) -> Effects:
    """Return what was measured, by module, name, value and change; nothing without a file."""
    if not path.exists():
        return {}
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file, delimiter="\t"))
    names = ("module", "name", "value", "change")
    return {tuple(row[name] for name in names if row[name]): row for row in rows}


def head(effects: Effects) -> str:
    """Return the text above the table."""
    runs = " and ".join(
        f"{len(seeds)} of `{name}` (seeds {seeds.start} to {seeds.stop - 1})"
        for name, seeds in SEEDS.items()
    )
    usual = effects[UNCHANGED]
    return _HEAD.format(runs=runs, worse=usual["worse"], lost=usual["lost"])


def cells(effects: Effects, module: str, name: str, value: str) -> list[str]:
    """Return the cells of a constant."""
    found = [effects.get((module, name, value, change)) for change in CHANGES]
    return ["" if row is None else _shown(row, effects[UNCHANGED]) for row in found]


def is_active(effects: Effects, module: str, name: str, value: str) -> bool:
    """Return whether a change of a constant changes any run."""
    found = [effects.get((module, name, value, change)) for change in CHANGES]
    return any(row is not None and row["differ"] != "0" for row in found)


def _shown(row: Row, usual: Row) -> str:
    if row["standard_cost"] == "cannot run":
        return "cannot run"
    if row["differ"] == "0":
        return "same"
    costs = f"{float(row['standard_cost']):.2f}/{float(row['wide_cost']):.2f}"
    counts = [f"{row[one]} {one}" for one in ("worse", "lost") if row[one] != usual[one]]
    return ", ".join([costs, *counts])
