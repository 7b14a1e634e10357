"""Commissioning of a drive, or of a plant of the user, from the first look to the new settings."""

import asyncio
import os
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from adaptdrive.analysis.closed_loop import Plant, PlantLoop
from adaptdrive.app.examine import examine_text
from adaptdrive.app.process import LockedError, locked
from adaptdrive.commissioning import client, evaluation, picture, proposal
from adaptdrive.commissioning.course import Samples, Target, build_target
from adaptdrive.commissioning.experiment import LoadExperiment
from adaptdrive.config import root
from adaptdrive.config.file import digest_of, parse_configuration, read_text
from adaptdrive.control.signals import Command
from adaptdrive.mqtt.client import LIVE_S, NoAnswerError
from adaptdrive.mqtt.connection import Broker
from adaptdrive.safety.timing import timing_of
from adaptdrive.tui.terminal import ended_once, print_line, whole
from adaptdrive.util.errors import CommissionError, ConfigurationError, Flaw

# A measured load put to use: the running daemon takes the file, and adaptive control begins.

LONGEST_S = 60.0
"""Longest time for the daemon to begin another run, and for the drive to run in it."""

_GAP_S = 0.3


async def put_to_use(guide: client.Guide, digest: str, setpoint: float) -> float:
    """Have the daemon take the measured load of its file, and hold a set-point in mode adaptive.

    Args:
        guide: Commands the drive, which is in standby.
        digest: Of the file that was written; a daemon with another one refuses.
        setpoint: Set-point, one that the experiment has led the output to.

    Returns:
        Time in seconds until the adaptive controller was in force.

    Raises:
        AdaptdriveError: The daemon refuses, or the drive does not run; it is off then.
    """
    began_s = time.monotonic()
    await guide.ask("reload", measured=digest)
    with ended_once():
        try:
            # the mode energises nothing
            await _until_none(guide, lambda: _refusal(guide, "mode", "adaptive"))
            await _until_none(guide, lambda: _lack_of_measurement(guide))
            await guide.ask("enable")  # a repeat could undo a stop
            await _until_none(guide, lambda: _refusal(guide, "setpoint", setpoint))
            await _until_none(guide, lambda: _lack_of_control(guide))
        except BaseException:
            await whole(_stop(guide), complete=True)
            raise
    return time.monotonic() - began_s


async def _stop(guide: client.Guide) -> None:
    try:
        await guide.send("disable")
    except NoAnswerError as silence:
        print_line(
            f"the stop is unanswered ({silence.problem}): {guide.drive} may run in mode adaptive; "
            "look at it, and disable it"
        )


async def _until_none(guide: client.Guide, look: Callable[[], Awaitable[str]]) -> None:
    """Wait until there is no problem any more: the daemon begins another run."""
    end_s = time.monotonic() + LONGEST_S
    while problem := await look():
        if time.monotonic() > end_s:
            raise CommissionError(f"{guide.drive} {problem}")
        await asyncio.sleep(_GAP_S)


async def _refusal(guide: client.Guide, verb: str, value: object) -> str:
    """Send a command; return why it is not carried out, empty where it is accepted."""
    try:
        reply = await guide.send(verb, value)
    except NoAnswerError as silence:
        return f"refused {verb} for {LONGEST_S:g} s: {silence.problem}"
    return "" if reply.accepted else f"refused {verb} for {LONGEST_S:g} s: {reply.reason}"


async def _lack_of_measurement(guide: client.Guide) -> str:
    """Return whether the new run has no measurement yet, without which it refuses `enable`."""
    status = await guide.status()
    age_s = status.telemetry.get("drive", {}).get("age_s")
    measured = status.live and age_s is not None and age_s < LIVE_S
    return "" if measured else f"has no measurement after {LONGEST_S:g} s"


async def _lack_of_control(guide: client.Guide) -> str:
    """Return why the adaptive controller does not run the drive yet."""
    state = (await guide.status()).state or {}
    if state.get("controller") == "adaptive" and state.get("state") == "running":
        return ""
    if state.get("trip"):
        raise CommissionError(f"{guide.drive} is {state.get('state')}: {state['trip']}")
    return f"is not in adaptive control: {state.get('reason')}"


# Commissioning from the first look at the sensors to the proposal.

_WATCHED_S = 5.0
"""Time for which the sensors are watched with the drive off."""


@contextmanager
def alone(drive: str, broker: Broker) -> Iterator[None]:
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


def announcement(path: Path, drive: str, move_share: float, patience_s: float | None) -> str:
    """Return what the experiment will do; arguments as of `commission`.

    Raises:
        ConfigurationError: The configuration is not valid, or that of another drive.
    """
    _, _, target = _prepared(path, drive, move_share, patience_s)
    given, onset = target.given, "" if target.battery is None else ", until a current flows,"
    return (
        f"{drive} is enabled in mode manual. {given.symbol} rises from "
        f"{given.text(target.low_V, 'g')}{onset} until {target.name} has moved by "
        f"{target.move:.3g} {target.unit}, then switches between the two for many minutes. The key "
        "q ends it, as do Ctrl-C, disable, a trip, and "
        f"{client.HOLD_S:g} s without this program; the drive is then off."
    )


async def commission(
    path: Path, guide: client.Guide, move_share: float, patience_s: float | None
) -> evaluation.Commissioned:
    """Run the experiment on a drive and evaluate it.

    Args:
        path: Configuration of the drive.
        guide: Commands the drive.
        move_share: Movement of the output as a share of the set-point range.
        patience_s: Shortest wait for a response; that of the kind of load when None.

    Raises:
        AdaptdriveError: The drive refused or tripped, or the load cannot be identified.
    """
    text, configuration, target = _prepared(path, guide.drive, move_share, patience_s)
    standby = await guide.watch_standby(_WATCHED_S)
    sensor = evaluation.judge_sensor(standby, configuration, target.move)
    experiment = LoadExperiment(target)
    await picture.carry_out(guide, picture.Picture(guide.drive, experiment))
    return evaluation.judged(sensor, experiment, configuration, text, path)


def _prepared(
    path: Path, drive: str | None, move_share: float, patience_s: float | None
) -> tuple[str, root.Configuration, Target]:
    """Return the text of a configuration, what it says, and the limits of the experiment.

    Those of another drive than the one that is named do not hold for it; None is any drive.
    """
    text = read_text(path)
    configuration = examine_text(text, path)
    if drive is not None and configuration.drive.name != drive:
        flaw = Flaw("drive.name", f"is {configuration.drive.name}, and {drive} was named")
        raise ConfigurationError(path, [flaw])
    return text, configuration, build_target(configuration, move_share, patience_s)


def write(path: Path, commissioned: evaluation.Commissioned) -> tuple[Path, str]:
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
    proposed = proposal.with_values(path, text, commissioned.proposal.values)
    examine_text(proposed, path)
    return proposal.write_values(path, proposed), digest_of(proposed)


def reached(commissioned: evaluation.Commissioned) -> float:
    """Return an output to hold next: one that the experiment has led the load to."""
    outcome, load = commissioned.outcome, commissioned.before.load
    reached = float(f"{outcome.rest + outcome.moved:.4g}")
    return min(max(reached, load.reference_min), load.reference_max)


# The experiment on a plant of the user, in virtual time.

_SAMPLE_S = 0.1
"""Time between two samples, as between two messages of the daemon."""

_LONGEST_RUN_S = 30.0 * 86400.0


def _samples(
    configuration: root.Configuration, plant: Plant
) -> Callable[[float], tuple[float, float, float]]:
    """Return what advances a plant by a sample under V_c: to its time, boost voltage and output."""
    loop = PlantLoop(configuration, plant, follows=True)
    count = max(1, round(_SAMPLE_S / timing_of(configuration).reading_s))

    def sample(voltage_V: float) -> tuple[float, float, float]:
        for _ in range(count):
            loop.step(Command(0.0, voltage_V, bridge=True))
        return loop.time_s, loop.voltage_V, loop.output

    return sample


def commission_plant(
    path: Path, plant: Plant, move_share: float, patience_s: float | None
) -> evaluation.Commissioned:
    """Run the experiment on a plant and evaluate it.

    Args:
        path: Configuration with the limits of the drive and of the output.
        plant: The plant.
        move_share: Movement of the output as a share of the set-point range.
        patience_s: Shortest wait for a response; that of the kind of load when None.

    Raises:
        AdaptdriveError: The experiment cannot continue, or does not show the load.
    """
    text, configuration, target = _prepared(path, None, move_share, patience_s)
    sample, standby = _samples(configuration, plant), Samples()
    while not standby.times_s or standby.times_s[-1] < _WATCHED_S:
        standby.append(*sample(target.low_V))
    sensor = evaluation.judge_sensor(standby, configuration, target.move)
    experiment = LoadExperiment(target)
    while not experiment.done:
        experiment.take(*sample(experiment.course.voltage_V))
        if experiment.course.time_s > _LONGEST_RUN_S:
            raise CommissionError("the experiment does not end within 30 days")
    return evaluation.judged(sensor, experiment, configuration, text, path)
