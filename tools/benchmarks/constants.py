"""Measure what it does to the campaigns to halve and to double each constant.

    XDG_CACHE_HOME=$(mktemp -d) python -m tools.benchmarks.constants tools/pages/constants.tsv

writes a row for each constant and change. docs/proof/constants.md takes two columns from them, for
the values that the code still has. The fixed controller runs once, with the constants as they are.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from adaptdrive.control.signals import Mode
from adaptdrive.errors import AdaptdriveError
from adaptdrive_sim.campaign import bench
from adaptdrive_sim.campaign.bench import draw
from adaptdrive_sim.campaign.drawn import Row
from adaptdrive_sim.campaign.judge import WORSE, judge
from adaptdrive_sim.campaign.settings import read_campaign
from adaptdrive_sim.compiled import run
from adaptdrive_sim.course import Run
from tools.benchmarks.dials import DIALS, Dial, Number, install, turn
from tools.pages.constants_effects import CHANGES, COLUMNS, SEEDS

Stands = dict[str, list[bench.Stand]]
Fixed = dict[int, Run]

TO_ONE = {"_NEAR_LIMIT", "_CEILING_RISE", "CLOSER"}
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
    install()
    stands = {name: [_stand(name, seed) for seed in seeds] for name, seeds in SEEDS.items()}
    fixed = {id(one): one.run(Mode.FIXED) for group in stands.values() for one in group}
    before = measure(stands, fixed)
    with path.open("w", encoding="utf-8") as file:
        file.write("\t".join(COLUMNS) + "\n")
        file.write(_line(("", "", "", "", ""), before, before))
        for place, dial in enumerate(DIALS):
            for change, value in variants(dial):
                turn(place, value)
                found = _measured(stands, fixed)
                turn(place, dial.value)
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


def _stand(name: str, seed: int) -> bench.Stand:
    return bench.Stand(draw(read_campaign(Path(name)), seed))


def _measured(stands: Stands, fixed: Fixed) -> Effect | None:
    """Measure; None for a value with which the controller cannot run."""
    try:
        return measure(stands, fixed)
    except (AdaptdriveError, ValueError, IndexError, ArithmeticError) as problem:
        sys.stderr.write(f"{problem!r}\n")
        return None


def measure(stands: Stands, fixed: Fixed) -> Effect:
    """Run every seed with the constants as they are."""
    bench.deployed.cache_clear()
    run._constant.cache_clear()  # settings hold some of the constants
    rows: dict[str, list[Row]] = {
        name: [judge(one, fixed[id(one)], one.run(Mode.ADAPTIVE)) for one in group]
        for name, group in stands.items()
    }
    everything = [row for group in rows.values() for row in group]
    return Effect(
        {name: [row["cost_adaptive"] for row in group] for name, group in rows.items()},
        sum(row["ratio"] > WORSE for row in everything),
        sum(row["unstable_adaptive"] or row["interlock_adaptive"] != 0 for row in everything),
    )


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
