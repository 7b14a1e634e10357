"""The loads of which a campaign can draw runs: a file names one by its key `type`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from adaptdrive_sim.campaign.bath_bench import BathStand, draw_bath
from adaptdrive_sim.campaign.bath_settings import BathCampaign
from adaptdrive_sim.campaign.battery_bench import (
    judge_batteries,
    repeat_battery,
    summarise_batteries,
)
from adaptdrive_sim.campaign.battery_scenario import BatteryCampaign
from adaptdrive_sim.campaign.bench import Stand, draw
from adaptdrive_sim.campaign.drawn import DrawnRun, Row
from adaptdrive_sim.campaign.judge import run_and_judge
from adaptdrive_sim.campaign.repeat import repeat
from adaptdrive_sim.campaign.settings import Campaign, read_campaign_of

AnyCampaign = Campaign | BathCampaign | BatteryCampaign

TYPES: dict[str, type[AnyCampaign]] = {
    "motor": Campaign,
    "bath": BathCampaign,
    "battery": BatteryCampaign,
}


@dataclass(frozen=True, slots=True)
class CampaignKind:
    """Functions that a campaign needs for the runs of one load.

    Attributes:
        judge: Runs a seed with both controllers; returns its row of the results.
        repeat: Runs a seed again on the deployed controller, and records it.
        summarise: Returns what is printed below the tables that every load has.
        compiled: Whether its runs are compiled code.
    """

    judge: Callable[[Any, int], Row]
    repeat: Callable[[Any, int, Path, Console], None]
    summarise: Callable[[list[Row]], str]
    compiled: bool


def _drawn(stand: Callable[[Any, int], DrawnRun]) -> CampaignKind:
    """Return the kind of a load whose runs are compiled."""

    def judge_seed(campaign: AnyCampaign, seed: int) -> Row:
        return run_and_judge(stand(campaign, seed))

    def repeat_seed(campaign: AnyCampaign, seed: int, output: Path, console: Console) -> None:
        repeat(stand(campaign, seed), output, console)

    return CampaignKind(judge_seed, repeat_seed, lambda _: "", compiled=True)


_KINDS = {
    "motor": _drawn(lambda campaign, seed: Stand(draw(campaign, seed))),
    "bath": _drawn(lambda campaign, seed: BathStand(draw_bath(campaign, seed))),
    "battery": CampaignKind(judge_batteries, repeat_battery, summarise_batteries, compiled=False),
}


def read_any_campaign(path: Path) -> AnyCampaign:
    """Read a file of any type; one without the key `type` is of motors.

    Raises:
        CampaignError: It cannot be read, or a value is not allowed.
    """
    return read_campaign_of(path, TYPES)


def kind_of(campaign: AnyCampaign) -> CampaignKind:
    """Return what a campaign does with the runs of its load."""
    return _KINDS[campaign.type]


def is_compiled(campaign: AnyCampaign) -> bool:
    """Return whether the runs of a campaign are compiled code."""
    return kind_of(campaign).compiled


def run_seed(campaign: AnyCampaign, seed: int) -> Row:
    """Run one seed with both controllers and judge them: one row of the results."""
    return kind_of(campaign).judge(campaign, seed)
