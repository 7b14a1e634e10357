"""Measure what it does to the campaigns to halve and to double each constant.

    ADAPTDRIVE_PURE=1 python -m tools.benchmarks.constants tools/pages/constants.tsv

writes a row for each constant and change. docs/proof/constants.md takes two columns from them, for
the values that the code still has. The fixed controller runs with the constants as they are. All
processors are busy for some hours.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

from adaptdrive.control.signals import Mode
from adaptdrive.util.errors import AdaptdriveError
from adaptdrive_sim.campaign import stands
from adaptdrive_sim.campaign.drawn import Row
from adaptdrive_sim.campaign.report import WORSE, judge
from adaptdrive_sim.campaign.settings import read_campaign
from adaptdrive_sim.campaign.stands import draw
from adaptdrive_sim.course import Run
from tools.benchmarks.dials import DIALS, Dial, Number, turn
from tools.pages.constants_effects import CHANGES, COLUMNS, SEEDS

Place = tuple[str, int]
"""Campaign and seed."""

PLACES: list[Place] = [(name, seed) for name, seeds in SEEDS.items() for seed in seeds]

TO_ONE = {"_NEAR_LIMIT", "CLOSER"}
"""Constants near 1, of which the distance from 1 is halved and doubled."""


@dataclass(frozen=True, slots=True)
class Effect:
    """Results of all seeds.

    Attributes:
        costs: Of the adaptive controller, by campaign; infinite for a run that ended early.
        worse: Runs in which it costs over 5 % more than the fixed controller.
        lost: Runs that are unstable or tripped.
    """

    costs: dict[str, list[float]]
    worse: int
    lost: int


def main(path: Path) -> None:
    """Measure every constant and write the file."""
    with ProcessPoolExecutor() as pool, path.open("w", encoding="utf-8") as file:
        before = measure(pool, DIALS[0], DIALS[0].value)
        file.write("\t".join(COLUMNS) + "\n")
        file.write(_line(("", "", "", "", ""), before, before))
        for dial in DIALS:
            for change, value in variants(dial):
                found = _measured(pool, dial, value)
                known = (dial.constant.module, dial.name, dial.constant.value, change, f"{value:g}")
                file.write(_line(known, found, before))
                file.flush()


def variants(dial: Dial) -> Iterator[tuple[str, Number]]:
    """Half and twice a constant, or its distance from 1."""
    for change, factor in zip(CHANGES, (0.5, 2.0), strict=True):
        if dial.name in TO_ONE:
            yield change, 1.0 - factor * (1.0 - dial.value)
        elif isinstance(dial.value, int):
            yield change, max(1, round(factor * dial.value))
        else:
            yield change, factor * dial.value


def _measured(pool: Executor, dial: Dial, value: Number) -> Effect | None:
    """Measure; None for a value with which the controller cannot run."""
    try:
        return measure(pool, dial, value)
    except (AdaptdriveError, ValueError, IndexError, ArithmeticError) as problem:
        sys.stderr.write(f"{problem!r}\n")
        return None


def measure(pool: Executor, dial: Dial, value: Number) -> Effect:
    """Run every seed with a constant of another value."""
    everything = list(pool.map(partial(_run, dial, value), PLACES))
    rows: dict[str, list[Row]] = {name: [] for name in SEEDS}
    for (name, _), row in zip(PLACES, everything, strict=True):
        rows[name].append(row)
    return Effect(
        {name: [row["cost_adaptive"] for row in group] for name, group in rows.items()},
        sum(row["ratio"] > WORSE for row in everything),
        sum(row["unstable_adaptive"] or row["interlock_adaptive"] != 0 for row in everything),
    )


def _run(dial: Dial, value: Number, place: Place) -> Row:
    """Run the adaptive controller with a constant of another value, and judge it."""
    fixed = _fixed(place)
    turn(dial, value)
    try:
        stands.deployed.cache_clear()  # settings hold some of the constants
        stand = _stand(place)
        return judge(stand, fixed, stand.run(Mode.ADAPTIVE))
    finally:
        turn(dial, dial.value)
        stands.deployed.cache_clear()


@cache
def _fixed(place: Place) -> Run:
    return _stand(place).run(Mode.FIXED)


def _stand(place: Place) -> stands.Stand:
    name, seed = place
    return stands.Stand(draw(read_campaign(Path(name)), seed))


def _line(known: tuple[str, ...], found: Effect | None, before: Effect) -> str:
    cells = [*known]
    if found is None:
        cells += ["cannot run", "", "", "", ""]
    else:
        cells += [f"{_ratio(found.costs[name], before.costs[name]):.4f}" for name in SEEDS]
        cells += [str(found.worse), str(found.lost), str(_differ(found, before))]
    return "\t".join(cells) + "\n"


def _ratio(costs: list[float], before: list[float]) -> float:
    """Return the sum of the costs over that of before, of the runs that ended neither time."""
    both = [pair for pair in zip(costs, before, strict=True) if all(map(math.isfinite, pair))]
    return sum(one for one, _ in both) / sum(one for _, one in both)


def _differ(found: Effect, before: Effect) -> int:
    """Return the number of runs whose cost is not the same to the last bit."""
    pairs = [zip(found.costs[name], before.costs[name], strict=True) for name in SEEDS]
    return sum(one != other for pair in pairs for one, other in pair)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
