"""The causes of trips with their remedies, as `trips.toml` lists them.

An interlock gives its cause as text, and records keep only that. The registry leads from there to
the remedy: in the table of `docs/operation.md`, and in each message.
"""

import re
import tomllib
from dataclasses import dataclass
from importlib import resources


@dataclass(frozen=True, slots=True)
class Trip:
    """A kind of trip.

    Attributes:
        sign: Regular expression that occurs in the text of such a trip.
        example: Text of such a trip; `…` stands for the rest.
        cause: Cause in words.
        remedy: Steps that remove the cause, before `reset`.
    """

    sign: str
    example: str
    cause: str
    remedy: str


def _read() -> tuple[Trip, ...]:
    text = (resources.files("adaptdrive.runtime") / "trips.toml").read_text(encoding="utf-8")
    return tuple(Trip(**{"sign": _beginning(one)} | one) for one in tomllib.loads(text)["trip"])


def _beginning(entry: dict[str, str]) -> str:
    """Return the sign of an entry that has none: what comes before the colon of its example."""
    return f"^{re.escape(entry['example'].partition(': ')[0])}: "


TRIPS = _read()


def remedy(text: str) -> str:
    """Return the steps that remove the cause of a trip as plain text, empty for an unknown cause.

    Args:
        text: Text of the trip.
    """
    return next((trip.remedy for trip in TRIPS if re.search(trip.sign, text)), "").replace("`", "")
