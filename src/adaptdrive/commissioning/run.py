"""Commissioning from the first look at the sensors to the proposal."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from adaptdrive.app.examine import examine_text
from adaptdrive.app.lock import LockedError, locked
from adaptdrive.commissioning.client import HOLD_S, Guide
from adaptdrive.commissioning.evaluation import judge_sensor
from adaptdrive.commissioning.experiment import LoadExperiment
from adaptdrive.commissioning.file import with_values, write_values
from adaptdrive.commissioning.picture import Picture, carry_out
from adaptdrive.commissioning.report import Commissioned, judged
from adaptdrive.commissioning.target import build_target
from adaptdrive.config.file import digest_of, parse_configuration, read_text
from adaptdrive.config.root import Configuration
from adaptdrive.config.services import Mqtt
from adaptdrive.util.errors import CommissionError, ConfigurationError, Flaw


@dataclass(frozen=True, slots=True)
class CommissionRequest:
    """An experiment as it was asked for.

    Attributes:
        path: Configuration of the drive.
        move_share: Movement of the output as a share of the set-point range.
        patience_s: Shortest wait for a response; that of the kind of load when None.
        standby_s: Time for which the sensors are watched with the drive off.
    """

    path: Path
    move_share: float
    patience_s: float | None
    standby_s: float


@contextmanager
def alone(drive: str, broker: Mqtt) -> Iterator[None]:
    """Keep other experiments off a drive until the block ends.

    Args:
        drive: Name of the drive.
        broker: Its broker, as others may have a drive of that name.

    Raises:
        CommissionError: Another process of this machine commissions it.
    """
    experiment = f"commissioning of {drive!r} by {broker.host}:{broker.port}"
    try:
        with locked([experiment], os.environ):
            yield
    except LockedError as problem:
        raise CommissionError(f"{drive} is already commissioned by {problem.holder}") from None


def announcement(wanted: CommissionRequest, drive: str) -> str:
    """Return what the experiment will do.

    Raises:
        ConfigurationError: The configuration is not valid, or that of another drive.
    """
    configuration = _configuration_of(drive, read_text(wanted.path), wanted.path)
    target = build_target(configuration, wanted.move_share, wanted.patience_s)
    given, onset = target.given, "" if target.onset is None else ", until a current flows,"
    return (
        f"{drive} is enabled in mode manual. {given.symbol} rises from "
        f"{given.text(target.low_V, 'g')}{onset} until {target.name} has moved by "
        f"{target.move:.3g} {target.unit}, then switches between the two for many minutes. The key "
        "q ends it, as do Ctrl-C, disable, a trip, and "
        f"{HOLD_S:g} s without this program; the drive is then off."
    )


async def commission(
    wanted: CommissionRequest, drive: str, broker: Mqtt, timeout_s: float
) -> Commissioned:
    """Run the experiment on a drive and evaluate it.

    Args:
        wanted: What was asked for.
        drive: Name of the drive.
        broker: The broker.
        timeout_s: Longest wait for a reply.

    Raises:
        AdaptdriveError: The drive refused or tripped, or the load cannot be identified.
    """
    text = read_text(wanted.path)
    configuration = _configuration_of(drive, text, wanted.path)
    target = build_target(configuration, wanted.move_share, wanted.patience_s)
    guide = Guide(broker, drive, timeout_s)
    standby = await guide.watch_standby(wanted.standby_s)
    sensor = judge_sensor(standby, configuration, target.move)
    experiment = LoadExperiment(target)
    await carry_out(guide, experiment, Picture(drive, target))
    return judged(sensor, experiment, configuration, text, wanted.path)


def _configuration_of(drive: str, text: str, path: Path) -> Configuration:
    """Return the configuration of a drive; the limits of another one do not hold for it."""
    configuration = examine_text(text, path)
    if configuration.drive.name != drive:
        flaw = Flaw("drive.name", f"is {configuration.drive.name}, and {drive} was named")
        raise ConfigurationError(path, [flaw])
    return configuration


def write(path: Path, commissioned: Commissioned) -> tuple[Path, str]:
    """Write the proposed settings to the configuration.

    Returns:
        A copy of the file before, and the digest of what was written.

    Raises:
        CommissionError: The predicted response is no good.
        ConfigurationError: The file was changed and is not valid with the settings, or cannot be
            written.
    """
    if commissioned.refusal:
        raise CommissionError(f"{path} stays as it is: {commissioned.refusal}")
    text = read_text(path)
    parse_configuration(text, path)
    proposed = with_values(path, text, commissioned.proposal.values)
    examine_text(proposed, path)
    return write_values(path, proposed), digest_of(proposed)


def reached(commissioned: Commissioned) -> float:
    """Return an output to hold next: one that the experiment has led the load to."""
    outcome, load = commissioned.outcome, commissioned.before.load
    reached = float(f"{outcome.rest + outcome.moved:.4g}")
    return min(max(reached, load.reference_min), load.reference_max)
