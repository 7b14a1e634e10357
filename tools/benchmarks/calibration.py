"""How often the shown 95 % intervals hold the truth, over the runs of a campaign.

    python -m tools.benchmarks.calibration standard.toml FIRST COUNT

prints a table: the share of samples whose interval holds the true parameter, by the time since the
last change of the load. Samples in which no interval is shown do not count.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control.signals import Mode
from adaptdrive_sim.campaign.settings import read_campaign
from adaptdrive_sim.campaign.stands import Stand, draw

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

NAMES = ("gain", "sum of time constants", "product")
PHASES = {
    "before a change": (-1.0, 0.0),
    "0–20 s after": (0.0, 20.0),
    "20–40 s": (20.0, 40.0),
    "40–60 s": (40.0, 60.0),
    "60–120 s": (60.0, 120.0),
    "later": (120.0, np.inf),
    "all": (-1.0, np.inf),
}
QUANTILE = 1.96
"""Of the normal distribution: 95 % within."""


@dataclass(frozen=True, slots=True)
class Samples:
    """The samples of all runs in which an interval is shown.

    Attributes:
        age_s: Time since the last change of the load, n; -1 before the first.
        inside: Whether the interval of each parameter holds the truth, n × 3.
        accepted: Whether the supervisor accepted the estimate, n.
    """

    age_s: Array
    inside: Flags
    accepted: Flags

    def trusted(self) -> Samples:
        """Return the samples with an accepted estimate."""
        chosen = self.accepted
        return Samples(self.age_s[chosen], self.inside[chosen], self.accepted[chosen])


def coverage(samples: Samples) -> dict[str, list[float]]:
    """Return for each phase the shares of the three parameters, and the number of samples."""
    age, inside = samples.age_s, samples.inside
    found = {}
    for phase, (from_s, to_s) in PHASES.items():
        chosen = inside[(age >= from_s) & (age < to_s)]
        found[phase] = [*chosen.mean(axis=0).tolist(), float(len(chosen))]
    return found


def run_all(campaign: str, seeds: range) -> Samples:
    """Run the seeds of a campaign with the adaptive controller."""
    runs = zip(*(_run(campaign, seed) for seed in seeds), strict=True)
    return Samples(*map(np.concatenate, runs))


def _run(campaign: str, seed: int) -> tuple[Array, Flags, Flags]:
    """Return the columns of `Samples` for one run."""
    stand = Stand(draw(read_campaign(Path(campaign)), seed))
    run = stand.run(Mode.ADAPTIVE)
    loads = stand.true_loads()
    truth = np.array([one.physical(list(one.numerator), list(one.denominator)) for one in loads])
    names = stand.own.load.names
    values = np.column_stack([run[name] for name in names])
    deviations = np.column_stack([run[f"{name}_std"] for name in names])
    shown = np.isfinite(deviations).all(axis=1)
    inside = np.abs(values - truth) <= QUANTILE * deviations
    return _ages(stand)[shown], inside[shown], run["accepted"][shown] > 0.0


def _ages(stand: Stand) -> Array:
    """Return the time since the last change of the load; -1 before the first."""
    changes_s = np.array([-np.inf, *stand.scenario.change_times_s])
    last_s = changes_s[np.searchsorted(changes_s, stand.times_s, "right") - 1]
    return np.where(np.isfinite(last_s), stand.times_s - last_s, -1.0)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("campaign")
    parser.add_argument("first", type=int)
    parser.add_argument("count", type=int)
    given = parser.parse_args()
    seeds = range(given.first, given.first + given.count)
    say = sys.stdout.write
    say(f"| | samples | {' | '.join(NAMES)} |\n|---|---|{'---|' * len(NAMES)}\n")
    for phase, (*shares, samples) in coverage(run_all(given.campaign, seeds)).items():
        cells = " | ".join(f"{100.0 * share:.0f} %" for share in shares)
        say(f"| {phase} | {samples:.0f} | {cells} |\n")


if __name__ == "__main__":
    main()
