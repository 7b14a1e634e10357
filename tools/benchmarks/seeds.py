"""One run for each of many seeds, as a command asks for it, on all processors."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

T = TypeVar("T")


def over_seeds(
    run: Callable[[int], T], about: str | None, runs: int = 20
) -> Iterator[tuple[int, T]]:
    """Run `SEED [--runs N] [--jobs N]` of the command line; yield each seed with its result.

    Args:
        run: One run; a function that another process can import.
        about: What `--help` says.
        runs: Number of seeds unless it is given.
    """
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("seed", type=int, help="the first")
    parser.add_argument("--runs", type=int, default=runs)
    parser.add_argument("--jobs", type=int, default=None)
    given = parser.parse_args()
    seeds = range(given.seed, given.seed + given.runs)
    with ProcessPoolExecutor(given.jobs) as pool:
        yield from zip(seeds, pool.map(run, seeds), strict=True)
