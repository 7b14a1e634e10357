"""Claims about what was simulated, and the verdicts on them."""

from __future__ import annotations

import sys
from dataclasses import dataclass

_VERDICTS = {True: "holds", False: "FAILS", None: "not judged"}


@dataclass(frozen=True, slots=True)
class Claim:
    """One claim.

    Attributes:
        claim: What is claimed.
        measured: What was measured.
        target: What is expected.
        met: Whether it holds; None where this run's noise is not the one to judge it by.
    """

    claim: str
    measured: str
    target: str
    met: bool | None


def print_claims(title: str, claims: list[Claim]) -> None:
    """Print the verdict on every claim."""
    lines = [
        f"{_VERDICTS[one.met]}: {one.claim}: {one.measured} (target: {one.target})"
        for one in claims
    ]
    sys.stdout.write("\n".join((title, *lines)) + "\n")
