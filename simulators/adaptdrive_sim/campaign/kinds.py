"""The loads of which a campaign can draw runs: a file names one by its key `type`."""

from __future__ import annotations

from pathlib import Path

from adaptdrive_sim.campaign.bath_bench import BathStand
from adaptdrive_sim.campaign.bath_scenario import draw_bath
from adaptdrive_sim.campaign.bath_settings import BathCampaign
from adaptdrive_sim.campaign.bench import Stand
from adaptdrive_sim.campaign.drawn import DrawnRun
from adaptdrive_sim.campaign.scenario import draw
from adaptdrive_sim.campaign.settings import Campaign, read_campaign_of

AnyCampaign = Campaign | BathCampaign

TYPES: dict[str, type[AnyCampaign]] = {"motor": Campaign, "bath": BathCampaign}


def read_any_campaign(path: Path) -> AnyCampaign:
    """Read a file of any type; one without the key `type` is of motors.

    Raises:
        CampaignError: It cannot be read, or a value is not allowed.
    """
    return read_campaign_of(path, TYPES)


def stand_of(campaign: AnyCampaign, seed: int) -> DrawnRun:
    """Return the run of a campaign that a seed stands for."""
    if isinstance(campaign, BathCampaign):
        return BathStand(draw_bath(campaign, seed))
    return Stand(draw(campaign, seed))
