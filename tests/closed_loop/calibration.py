"""How often the 95 % intervals of accepted estimates hold the truth, over a campaign.

`python -m tests.closed_loop.calibration FILE FIRST_SEED COUNT` runs seeds of a campaign with the
adaptive controller, compiled, and prints the share of samples in which each parameter lies within
1.96 shown deviations, by the time since the last change of the load.
"""

from __future__ import annotations

import itertools
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control.signals import Mode
from adaptdrive_sim.campaign.bench import Stand, deployed
from adaptdrive_sim.campaign.scenario import draw
from adaptdrive_sim.campaign.settings import Campaign, read_campaign
from adaptdrive_sim.compiled import bench

Array = NDArray[np.float64]

WIDTH = 1.96
AGES_s = (0.0, 60.0, 240.0, np.inf)
"""Limits of the classes of time since a change; a start is none."""


def inside(stand: Stand) -> tuple[Array, Array]:
    """Return for each accepted estimate the age of the load, and which parameters hold."""
    trace = stand.run(Mode.ADAPTIVE).trace
    count = len(deployed().load.names)
    values = trace[:, bench.VALUES : bench.VALUES + count]
    deviations = trace[:, bench.VALUES + count :]
    truth = np.array([stand.truth_of(inertia) for inertia in stand.inertias.tolist()])
    accepted = trace[:, bench.ACCEPTED] > 0.0
    held = np.abs(values - truth) <= WIDTH * deviations
    return ages(stand)[accepted], held[accepted].astype(float)


def ages(stand: Stand) -> Array:
    """Time since the last change of the load at each slow instant; infinite before the first."""
    found = np.full(stand.times_s.size, np.inf)
    for change_s in stand.scenario.change_times_s:
        after = stand.times_s >= change_s
        found[after] = stand.times_s[after] - change_s
    return found


def coverage(campaign: Campaign, seeds: range) -> dict[str, Array]:
    """Return the number of samples and the share inside for each parameter, by class."""
    sums: dict[str, Array] = defaultdict(lambda: np.zeros(1 + len(deployed().load.names)))
    for seed in seeds:
        age, held = inside(Stand(draw(campaign, seed)))
        for low, high in itertools.pairwise(AGES_s):
            chosen = (age >= low) & (age < high)
            sums[f"{low:g} to {high:g} s"] += [chosen.sum(), *held[chosen].sum(axis=0)]
        chosen = np.isinf(age)
        sums["before any change"] += [chosen.sum(), *held[chosen].sum(axis=0)]
    return {name: np.array([row[0], *(row[1:] / max(row[0], 1.0))]) for name, row in sums.items()}


def main() -> None:
    """Print the table."""
    path, first, count = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    found = coverage(read_campaign(path), range(first, first + count))
    sys.stdout.write(f"{'since the change':>20} {'samples':>9} {' '.join(deployed().load.names)}\n")
    for name, row in found.items():
        shares = " ".join(f"{share:6.3f}" for share in row[1:])
        sys.stdout.write(f"{name:>20} {row[0]:9.0f} {shares}\n")


if __name__ == "__main__":
    main()
