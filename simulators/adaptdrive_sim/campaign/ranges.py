"""Ranges to draw from, and how they are checked."""

from __future__ import annotations

from pydantic import AfterValidator, BaseModel, ConfigDict

Range = tuple[float, float]
WholeRange = tuple[int, int]


class CampaignTable(BaseModel):
    """A table of a campaign's file."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


def within(low: float, high: float) -> AfterValidator:
    """Make sure that a range is one, and lies within limits."""

    def check(pair: tuple[float, float]) -> tuple[float, float]:
        if not (low <= pair[0] and pair[1] <= high):
            raise ValueError(f"must lie within {low:g}…{high:g}")
        return _ordered(pair)

    return AfterValidator(check)


def _ordered(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] > pair[1]:
        raise ValueError(f"the lower end {pair[0]:g} is above the upper end {pair[1]:g}")
    return pair
