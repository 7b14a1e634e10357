"""What a controller that knows the load at every instant would reach in a campaign of motors.

    python -m tools.benchmarks.oracle SEED [--runs N] [--campaign FILE]

The known load takes the place of the estimate; design, limits of V_c and watches of the loop are
those of the adaptive controller.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control.estimation.direct import METHODS
from adaptdrive.control.estimation.estimator import LambdaEstimator
from adaptdrive.control.loads.load import Load
from adaptdrive.control.signals import Mode
from adaptdrive.control.vectors import Vector
from adaptdrive_sim.campaign.report import judge
from adaptdrive_sim.campaign.settings import read_campaign
from adaptdrive_sim.campaign.stands import Stand, draw

WIDE = Path(__file__).parents[2] / "simulators/adaptdrive_sim/campaign/wide.toml"
WORSE, MUCH_WORSE = 1.05, 1.5
LIMITED_SHARE = 0.01
"""Share of the slow periods with V_c at a limit from which a run counts as limited."""

Row = tuple[float, float, float, float]


class KnownLoad(LambdaEstimator):
    """The λ-method, whose estimate is replaced by the load of each slow period."""

    loads: ClassVar[Sequence[Load]]
    slow_s: ClassVar[float]

    def model(self) -> tuple[Vector, Vector]:
        """Return numerator and denominator in s of the true load of this slow period."""
        k = round(self.sample.time_s / self.slow_s) - 1
        true = self.loads[min(max(k, 0), len(self.loads) - 1)]
        return list(true.numerator), list(true.denominator)

    def root(self, values: Vector) -> Vector:
        """Return zeros: the true load is known exactly."""
        return [0.0] * (len(values) * len(values))


def compare(campaign: Path, seed: int) -> Row:
    """Return costs over those of fixed control, of the estimate and of the known load.

    Returns:
        Both ratios, the share of time with V_c at a limit, and whether the load changed.
    """
    stand = Stand(draw(read_campaign(campaign), seed))
    fixed, adaptive = stand.run(Mode.FIXED), stand.run(Mode.ADAPTIVE)
    settings = stand.own.settings
    KnownLoad.loads, KnownLoad.slow_s = stand.true_loads(), stand.own.period_s
    METHODS["known"] = KnownLoad
    trusting = replace(
        settings.supervision, ratio_min=-math.inf, ratio_max=math.inf, damping_min=0.0,
        residual_margin=0.0,
    )  # fmt: skip
    learning = replace(settings.learning, method="known")
    stand.own = replace(
        stand.own, settings=replace(settings, learning=learning, supervision=trusting)
    )
    known = judge(stand, fixed, stand.run(Mode.ADAPTIVE))
    estimated = judge(stand, fixed, adaptive)
    changed = float(bool(stand.change_times_s))
    return estimated["ratio"], known["ratio"], known["saturated_share"], changed


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seed", type=int)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--campaign", type=Path, default=WIDE)
    given = parser.parse_args()
    seeds = range(given.seed, given.seed + given.runs)
    with ProcessPoolExecutor() as pool:
        rows = np.array(list(pool.map(partial(compare, given.campaign), seeds)))
    limited = rows[:, 2] > LIMITED_SHARE
    sys.stdout.write("| runs | number | load | over 5 % worse | over 1.5 times | better |\n")
    sys.stdout.write("|---|---|---|---|---|---|\n")
    parts = (("all", limited | True), ("changed load", rows[:, 3] > 0.0))
    for name, chosen in (*parts, ("V_c at a limit", limited), ("V_c free", ~limited)):
        for load, column in (("estimated", 0), ("known", 1)):
            sys.stdout.write(_line(name, load, rows[chosen, column]))


def _line(name: str, load: str, ratios: NDArray[np.float64]) -> str:
    counts = [np.count_nonzero(ratios > bound) for bound in (WORSE, MUCH_WORSE)]
    better = 100.0 * np.mean(ratios < 1.0) if ratios.size else np.nan
    return f"| {name} | {ratios.size} | {load} | {counts[0]} | {counts[1]} | {better:.1f} % |\n"


if __name__ == "__main__":
    main()
