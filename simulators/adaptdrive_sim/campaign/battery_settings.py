"""Contents of a campaign's file with `type = "battery"`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from adaptdrive_sim.campaign.ranges import CampaignTable, Range, within
from adaptdrive_sim.campaign.settings import CampaignFile, LineRanges


class BatteryRanges(CampaignTable):
    """The battery; resistances and times are relative to the settings of the controller.

    Attributes:
        full_V: Terminal voltage at which it is full; drawn evenly on a logarithmic scale.
        rate_per_h: Largest current over the capacity: the EMF rises faster with it.
        charge: State of charge at the start.
        series: Series resistance.
        relaxation: Resistance of the relaxation element.
        relaxation_s: Its time constant.
        second: Resistance of a second, slower relaxation element, relative to the first.
        second_s: Its time constant in s.
        aged: Share of runs in which the series resistance grows.
        growth: By which factor.
    """

    full_V: Annotated[Range, within(12.0, 400.0)]
    rate_per_h: Annotated[Range, within(0.05, 5.0)]
    charge: Annotated[Range, within(0.0, 0.9)]
    series: Annotated[Range, within(0.2, 5.0)]
    relaxation: Annotated[Range, within(0.2, 5.0)]
    relaxation_s: Annotated[Range, within(0.2, 5.0)]
    second: Annotated[Range, within(0.0, 2.0)]
    second_s: Annotated[Range, within(50.0, 1e4)]
    aged: float = Field(ge=0.0, le=1.0)
    growth: Annotated[Range, within(1.0, 5.0)]


class CurrentRanges(CampaignTable):
    """The charging current, which is lowered for a while in the second half of the run.

    Attributes:
        share: Of the largest one.
        lowered: To this share of itself.
        ripple: `load.probe_share`.
        noise: Standard deviation of each sample, as a share of the largest current.
    """

    share: Annotated[Range, within(0.1, 1.0)]
    lowered: Annotated[Range, within(0.1, 0.95)]
    ripple: Annotated[Range, within(0.0, 0.1)]
    noise: Annotated[Range, within(0.0, 0.1)]


class BatteryCampaign(CampaignFile):
    """A whole file."""

    type: Literal["battery"]
    duration_s: float = Field(ge=300.0, le=1e6)
    battery: BatteryRanges
    current: CurrentRanges
    line: LineRanges
