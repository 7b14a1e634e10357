"""Short tables for the pages, from the kept texts of long forms."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

LOADS = ("motor, CAN", "motor, Modbus", "bath, Modbus", "battery, CAN")
PASSED = re.compile(r"([a-z-]+): (\d+) inputs, random damage, .* s: passed")
FAULTS = "| fault | motor, CAN | motor, Modbus | bath, Modbus | battery, CAN | highest / limit |"


def cells_of(text: str) -> Iterator[list[str]]:
    """Yield the cells of each row of the Markdown tables in a text, heads and rules left out."""
    lines = text.splitlines()
    for line, following in zip(lines, [*lines, ""][1:], strict=True):
        if line.startswith("| ") and not following.startswith("|---"):
            yield [cell.strip() for cell in line.strip("|").split("|")]


def fault_matrix(texts: Iterable[str]) -> str:
    """Return a row for each fault, with a cell for each load, from the tables of all groups.

    Faults of a group that every load rides through share one row.
    """
    found: dict[tuple[str, str], dict[str, list[str]]] = {}
    for text in texts:
        for group, fault, load, *rest in cells_of(text):
            found.setdefault((group, fault), {})[load] = rest
    rows: dict[tuple[str, ...], list[_Row]] = {}
    for (group, fault), loads in found.items():
        row = _row(fault, loads)
        alike = () if set(row.cells) <= {"holds", ""} and not row.flaws else (fault,)
        rows.setdefault((group, *row.cells, *alike), []).append(row)
    shown = (_shown(key[0], alike) for key, alike in rows.items())
    return "\n".join([FAULTS, "|---|---|---|---|---|---|", *shown])


@dataclass(frozen=True, slots=True)
class _Row:
    """What was found of a fault.

    Attributes:
        fault: Its name.
        cells: Reaction for each of LOADS.
        highest: Highest true output over its limit.
        flaws: What broke a rule.
    """

    fault: str
    cells: tuple[str, ...]
    highest: str
    flaws: str


def _row(fault: str, loads: dict[str, list[str]]) -> _Row:
    cells = tuple(_reaction(*loads[load][:3]) if load in loads else "" for load in LOADS)
    highest = max(rest[3] for rest in loads.values())
    flaws = "; ".join(dict.fromkeys(rest[4] for rest in loads.values() if rest[4]))
    return _Row(fault, cells, highest, flaws)


def _shown(group: str, alike: Sequence[_Row]) -> str:
    """A row for faults that are alike: more than one only where each load holds them."""
    names, flaws = "; ".join(one.fault for one in alike), alike[0].flaws
    highest = max(one.highest for one in alike)
    cells = " | ".join(alike[0].cells)
    return f"| {group}: {names} | {cells} | {highest}{flaws and f'; {flaws}'} |"


def _reaction(must: str, tripped: str, reaction: str) -> str:
    """Median/worst/longest time to the trip, s; the share where not every run tripped."""
    count, runs = tripped.split(" of ")
    times = reaction.replace(" s (", "/").strip(")")
    if must == "hold":
        return "holds" if count == "0" else f"FAILED: {tripped} tripped"
    if must.startswith("trip in"):
        limit = must.removeprefix("trip in ").removesuffix(" s")
        return f"{times}/{limit}" if count == runs else f"FAILED: {times}/{limit}, {tripped}"
    return f"{times}, {tripped}" if times else tripped


def without_still(text: str) -> str:
    """Return a text with one row for all figures of its table that are flat and did not grow."""
    still: dict[str, list[str]] = {}
    lines = text.splitlines()
    for line in tuple(lines):
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("| ") and cells[5].startswith("+0 (") and cells[-1] == "flat":
            still.setdefault(cells[0], []).append(cells[1].partition(",")[0])
            lines.remove(line)
    named = "; ".join(f"{process} {', '.join(figures)}" for process, figures in still.items())
    return "\n".join([*lines, "", f"Flat, and no larger at the end: {named}."]) if still else text


def life(text: str) -> str:
    """Return the text of virtual days with its trips in one list, and without what stays flat."""
    trips = re.findall(r"([\d,]+) × trip: ([^,.]+)[,.]", text)
    first = re.search(r", [\d,]+ × trip: .*", text)
    if first is not None:
        listed = ", ".join(f"{cause} {count}" for count, cause in trips)
        text = text.replace(first[0], f"; trips: {listed}.")
    return without_still(text)


def tried(text: str) -> str:
    """Return the lines of the fuzzer as one; as they are where one has not passed."""
    found = [PASSED.fullmatch(line) for line in text.splitlines()]
    names = [f"{one[1]} {int(one[2]):,}" for one in found if one]
    return f"Passed, random damage: {', '.join(names)}." if len(names) == len(found) else text


def totals(text: str, columns: int) -> list[str]:
    """Return the sums of the columns of numbers behind the name, as many as asked for."""
    rows = [row[1 : columns + 1] for row in cells_of(text)]
    return [str(sum(int(row[i]) for row in rows)) for i in range(columns)]


def counted(name: str, text: str, columns: int) -> str:
    """Return a row: what was tried, and the sum of each column."""
    return "| " + " | ".join([name, *totals(text, columns)]) + " |"


def table(head: Sequence[str], rows: Iterable[str]) -> str:
    """Return a Markdown table from its heads and its finished rows."""
    return "\n".join(["| " + " | ".join(head) + " |", "|---" * len(head) + "|", *rows])
