"""Result of a campaign: the number of failed runs, the kinds of failure, and their seeds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from adaptdrive_sim.campaign.drawn import Row
from adaptdrive_sim.campaign.judge import WORSE

BETTER_SHARE = 0.95


@dataclass(frozen=True, slots=True)
class Failure:
    """A run that is not as it should be."""

    seed: int
    cause: str
    ratio: float


@dataclass(frozen=True, slots=True)
class CampaignClaim:
    """One sentence about a campaign, and whether it holds."""

    text: str
    found: str
    holds: bool


_CAUSES: dict[str, Callable[[Row], bool]] = {
    "interlock": lambda row: row["interlock_adaptive"] != 0,
    "unstable": lambda row: row["unstable_adaptive"],
    "worse than fixed": lambda row: row["ratio"] > WORSE,
}


def failures(rows: list[Row]) -> list[Failure]:
    """Every run that failed, the worst first."""
    found = [
        Failure(row["seed"], cause, row["ratio"])
        for row in rows
        for cause, applies in _CAUSES.items()
        if applies(row)
    ]
    return sorted(found, key=lambda failure: (failure.cause, -failure.ratio))


def claims(rows: list[Row]) -> list[CampaignClaim]:
    """Return the claims of a campaign."""
    changed = [row for row in rows if row["changes"]]
    better = sum(row["ratio"] < 1.0 for row in changed)
    share = better / len(changed) if changed else 1.0
    return [
        _none(rows, "no run is unstable", "unstable"),
        _none(rows, "no run ends with an interlock", "interlock"),
        _none(rows, "adaptive never costs over 5 % more than fixed", "worse than fixed"),
        CampaignClaim(
            "adaptive is better in 95 % of the runs whose load changed",
            f"{better} of {len(changed)}, {100.0 * share:.1f} %",
            share >= BETTER_SHARE,
        ),
    ]


def _none(rows: list[Row], text: str, cause: str) -> CampaignClaim:
    count = sum(_CAUSES[cause](row) for row in rows)
    return CampaignClaim(text, f"{count} of {len(rows)}", count == 0)
