"""Result of a campaign: the number of failed runs, the kinds of failure, and their seeds.

A run that ends unstable or with an interlock under the fixed controller as well is no failure of
the adaptive one. It is counted and listed apart, with what the run shows of the reason.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from adaptdrive_sim.campaign.criteria import WORSE
from adaptdrive_sim.campaign.drawn import Row

BETTER_SHARE = 0.95

_MUCH = 0.1
"""Share of the time that is named as a reason."""


@dataclass(frozen=True, slots=True)
class Failure:
    """A run that is not as it should be.

    Attributes:
        seed: It repeats the run.
        cause: Kind of failure.
        ratio: Cost of adaptive over that of fixed control.
        reason: What the run shows of the reason; empty where adaptive control alone failed.
    """

    seed: int
    cause: str
    ratio: float
    reason: str = ""


@dataclass(frozen=True, slots=True)
class CampaignClaim:
    """One sentence about a campaign, and whether it holds."""

    text: str
    found: str
    holds: bool


_CAUSES: dict[str, Callable[[Row], bool]] = {
    "interlock": lambda row: row["interlock_adaptive"] != 0 and row["interlock_fixed"] == 0,
    "unstable": lambda row: row["unstable_adaptive"] and not row["unstable_fixed"],
    "worse than fixed": lambda row: row["ratio"] > WORSE,
}

_SHARED: dict[str, Callable[[Row], bool]] = {
    "interlock, fixed too": lambda row: (
        row["interlock_adaptive"] != 0 and row["interlock_fixed"] != 0
    ),
    "unstable, fixed too": lambda row: row["unstable_adaptive"] and row["unstable_fixed"],
}
"""Runs that neither controller holds."""


def failures(rows: list[Row]) -> list[Failure]:
    """Every run in which adaptive control failed, the worst first."""
    found = [
        Failure(row["seed"], cause, row["ratio"])
        for row in rows
        for cause, applies in _CAUSES.items()
        if applies(row)
    ]
    return sorted(found, key=lambda failure: (failure.cause, -failure.ratio))


def shared_failures(rows: list[Row]) -> list[Failure]:
    """Every run that neither controller has held, with the reason that it shows."""
    return [
        Failure(row["seed"], cause, row["ratio"], _reason(row))
        for cause, applies in _SHARED.items()
        for row in rows
        if applies(row)
    ]


def _reason(row: Row) -> str:
    """Return what lasted for much of a run with adaptive control and keeps it from its design."""
    verdicts = sum(value for name, value in row.items() if name.startswith("verdict_"))
    shares = {
        "V_c at a limit": row.get("saturated_share", 0.0),
        "estimate outside of the bounds": row.get("verdict_out_of_bounds", 0) / max(1, verdicts),
    }
    found = [f"{name} for {share:.0%} of the time" for name, share in shares.items()]
    named = [text for text, share in zip(found, shares.values(), strict=True) if share > _MUCH]
    return "; ".join(named) or "none of those that are looked for"


def claims(rows: list[Row]) -> list[CampaignClaim]:
    """Return the claims of a campaign."""
    changed = [row for row in rows if row["changes"]]
    better = sum(row["ratio"] < 1.0 for row in changed)
    share = better / len(changed) if changed else 1.0
    return [
        _none(rows, "no run is unstable that fixed control holds", "unstable"),
        _none(rows, "no run ends with an interlock that fixed control ends without", "interlock"),
        _none(rows, "adaptive never costs over 5 % more than fixed", "worse than fixed"),
        CampaignClaim(
            "adaptive is better in 95 % of the runs whose load changed",
            f"{better} of {len(changed)}, {100.0 * share:.1f} %",
            share >= BETTER_SHARE,
        ),
    ]


def _none(rows: list[Row], text: str, cause: str) -> CampaignClaim:
    count = sum(_CAUSES[cause](row) for row in rows)
    shared = sum(
        applies(row) for name, applies in _SHARED.items() if name.startswith(cause) for row in rows
    )
    others = f"; {shared} with fixed control too" if shared else ""
    return CampaignClaim(text, f"{count} of {len(rows)}{others}", count == 0)
