"""The tables of the paper's motor experiment in docs/proof/control.md.

`make tables` runs every controller with twenty seeds from a first one on (`SEED=81000`), and writes
the tables between their marks in the page, with seeds and date. Nothing in the controller was
tuned on the default seeds.
"""

from __future__ import annotations

import datetime as dt
import re
import statistics
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from adaptdrive_sim.experiments.case import (
    Cycle,
    Design,
    Variant,
    convergence_cycles,
    cycles,
    run_case,
)
from adaptdrive_sim.experiments.experiment import DROPPED
from adaptdrive_sim.world import NoiseParameters
from tests.unit.simulators.experiments.cases import make_case

ROOT = Path(__file__).parents[2]
SEEDS = 20
FIRST_SEED = 81_000
LAST_CYCLE = 10
"""The last one with three disks."""

NOISES = {
    "0.2 %": NoiseParameters(0.002),
    "0.2 %, spikes": NoiseParameters(0.002, 0.02, 0.1),
    "2 %": NoiseParameters(0.02),
}
CONTROLLERS: dict[str, tuple[Design, Variant]] = {
    "paper's design, fixed": ("paper", "fixed"),
    "paper's design, adaptive": ("paper", "adaptive"),
    "paper's design, direct RLS": ("paper", "direct_rls"),
    "exact design, fixed": ("exact", "fixed"),
    "exact design, adaptive": ("exact", "adaptive"),
}


@dataclass(frozen=True, slots=True)
class Found:
    """One run.

    Attributes:
        cycles: Every reference cycle.
        converged: Cycles until the estimates are right, for each disk; None for never.
    """

    cycles: list[Cycle]
    converged: list[float | None]


@cache
def run(controller: str, noise: str, seed: int) -> Found:
    """Run one controller once."""
    design, variant = CONTROLLERS[controller]
    record = run_case(make_case(DROPPED, variant, design, NOISES[noise], seed))
    converged = [convergence_cycles(DROPPED, record, one) for one in DROPPED.changes]
    return Found(cycles(DROPPED, design, record), converged)


def runs(controller: str, noise: str, first: int) -> list[Found]:
    """Run one controller with every seed."""
    return [run(controller, noise, seed) for seed in range(first, first + SEEDS)]


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a Markdown table."""
    lines = [list(head), *map(list, rows)]
    lines.insert(1, ["---"] * len(lines[0]))
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def spread(values: list[float], form: str) -> str:
    """Return median and worst of some values."""
    return f"{form.format(statistics.median(values))} ({form.format(max(values))})"


def three_disks(first: int) -> str:
    """Model error, as a fraction of the step, and overshoot in percent, in the last cycle."""
    rows = [[name, *(_last(name, noise, first) for noise in NOISES)] for name in CONTROLLERS]
    return table(["noise", *NOISES], rows)


def _last(controller: str, noise: str, first: int) -> str:
    found = [one.cycles[LAST_CYCLE] for one in runs(controller, noise, first)]
    error = spread([one.model_error_rms for one in found], "{:.3f}")
    return f"{error}; {spread([100.0 * one.overshoot for one in found], '{:.1f}')}"


def convergence(first: int) -> str:
    """Cycles until the estimates are within 5 %, after the second and after the third disk."""
    noises = ("0.2 %", "2 %")
    names = ("paper's design, adaptive", "exact design, adaptive")
    rows = [[name, *(_converged(name, one, first) for one in noises)] for name in names]
    return table(["noise", *noises], rows)


def _converged(controller: str, noise: str, first: int) -> str:
    found = runs(controller, noise, first)
    return "; ".join(_when([one.converged[disk] for one in found]) for disk in (0, 1))


def _when(found: list[float | None]) -> str:
    known = [one for one in found if one is not None]
    values = sorted(known) + [float("inf")] * (len(found) - len(known))
    text = f"{statistics.median(values):.2f} ({values[-1]:.2f})".replace("inf", "never")
    return text if len(known) == len(found) else f"{text}, {len(found) - len(known)} never"


def tables(first: int) -> Iterator[tuple[str, str]]:
    """Every table by the name of its mark."""
    yield "three-disks", three_disks(first)
    yield "convergence", convergence(first)


def write(page: Path, name: str, text: str) -> None:
    """Put a table between its marks in a page, where it has them."""
    old = page.read_text(encoding="utf-8")
    pattern = rf"(<!-- {name} -->\n).*?(\n<!-- /{name} -->)"
    new = re.sub(pattern, lambda found: f"{found[1]}{text}{found[2]}", old, flags=re.DOTALL)
    page.write_text(new, encoding="utf-8")


def main(words: list[str]) -> None:
    """Write every table, and print it."""
    first = int(words[0]) if words else FIRST_SEED
    today = dt.datetime.now(tz=dt.UTC).date().isoformat()
    note = f"\n\nSeeds {first} to {first + SEEDS - 1}, {today}."
    for name, text in tables(first):
        write(ROOT / "docs" / "proof" / "control.md", name, text + note)
        sys.stdout.write(f"{name}\n{text}{note}\n\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
