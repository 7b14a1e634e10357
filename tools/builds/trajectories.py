"""Digests of campaign runs on the deployed controller: bit-equal with every build of it.

`python -m tools.builds.trajectories FIRST COUNT DURATION_S` prints the build, then a digest of each
seed.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterator
from pathlib import Path

from adaptdrive import build_name
from adaptdrive.control.signals import Mode
from adaptdrive_sim.campaign.settings import read_campaign
from adaptdrive_sim.campaign.stands import Stand, draw


def digests(seeds: range, duration_s: float) -> Iterator[str]:
    """Yield a digest of each adaptive run: every tick of the plant, every decision.

    Args:
        seeds: Seeds of the standard campaign.
        duration_s: Length of each run.
    """
    campaign = read_campaign(Path("standard.toml")).model_copy(update={"duration_s": duration_s})
    for seed in seeds:
        stand = Stand(draw(campaign, seed))
        course = stand.course(Mode.ADAPTIVE)
        run = stand.site().run(course, keep_ticks=True)
        digest = hashlib.sha256(run.fast_output.tobytes())
        digest.update(run.fast_voltage_V.tobytes())
        digest.update(run.trace.tobytes())
        digest.update(repr(run.decisions).encode())
        yield digest.hexdigest()


def main() -> None:
    """Print them."""
    first, count, duration_s = int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3])
    sys.stdout.write(f"{build_name()}\n")
    for digest in digests(range(first, first + count), duration_s):
        sys.stdout.write(f"{digest}\n")


if __name__ == "__main__":
    main()
