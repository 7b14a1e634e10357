"""Commissioning from the first look at the sensors to the file with new values."""

import asyncio
import os
import re
import shutil
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from adaptdrive.app.examine import examine_text
from adaptdrive.app.process import LockedError, locked
from adaptdrive.commissioning import client, evaluation, picture, report
from adaptdrive.commissioning.course import build_target
from adaptdrive.commissioning.experiment import LoadExperiment
from adaptdrive.config import root, services
from adaptdrive.config.file import digest_of, parse_configuration, read_text
from adaptdrive.mqtt.client import LIVE_S, NoAnswerError, read_status, send_command
from adaptdrive.tui.terminal import ended_once, tell, whole
from adaptdrive.util.errors import CommissionError, ConfigurationError, Flaw

# A measured load put to use: the file with new values, taken by the running daemon.

# The configuration file with new values: other comments stay, and the old file is kept.

ORIGIN = "by adaptdrive commission"


def with_values(path: Path, text: str, values: Mapping[str, float | int]) -> str:
    """Return a TOML document with new values, in its order.

    A comment with a figure after a value that changes goes: it describes the old value.

    Args:
        path: The file that it is from.
        text: The document.
        values: New values by dotted key; a missing table is made.

    Raises:
        ConfigurationError: The document cannot be changed: its tables are too scattered.
    """
    try:
        document = tomlkit.parse(text)
    except TOMLKitError as problem:  # of some documents that are valid, too
        flaw = f"cannot be changed: {problem}; write the parts of each table one after another"
        raise ConfigurationError(path, [Flaw("file", flaw)]) from problem
    for key, value in values.items():
        *tables, name = key.split(".")
        table: Any = document
        for part in tables:
            table = table.setdefault(part, tomlkit.table())
        old = table.get(name)
        if old != value:
            stays = old is not None and not re.search(r"\d", old.trivia.comment)
            table[name] = value if stays else tomlkit.item(value).comment(ORIGIN)
    return tomlkit.dumps(document)


def write_values(path: Path, text: str) -> Path:
    """Replace a file at once, after a copy of it was made; its owner and its rights stay.

    Args:
        path: The file; where it is a symbolic link, the file that the link leads to is replaced.
        text: Its new content.

    Returns:
        The copy.

    Raises:
        ConfigurationError: The file or its copy cannot be written, or its owner cannot be kept.
    """
    try:
        file = path.resolve(strict=True)
        backup = _free_backup(file)
        _replace(backup, file.read_bytes(), like=file)
        _replace(file, text.encode("utf-8"), like=file)
    except OSError as problem:
        raise _unwritable(path, problem) from problem
    return backup


def _free_backup(file: Path) -> Path:
    """Return the path of a copy: what an earlier copy holds may be nowhere else."""
    names = (f"{file.name}.bak{number}" for number in chain([""], count(2)))
    return next(path for path in map(file.with_name, names) if not os.path.lexists(path))


def refuse_unwritable(path: Path) -> None:
    """Make sure that a file can be changed and replaced; it is as before.

    Raises:
        ConfigurationError: It cannot.
    """
    with_values(path, read_text(path), {})
    try:
        file = path.resolve(strict=True)
        _written(file, file.read_bytes(), like=file).unlink()
    except OSError as problem:
        raise _unwritable(path, problem) from problem


def _unwritable(path: Path, problem: OSError) -> ConfigurationError:
    return ConfigurationError(path, [Flaw("file", f"cannot be written: {problem}")])


def _replace(file: Path, content: bytes, like: Path) -> None:
    """Replace a file by one with the owner, group and rights of another."""
    new = _written(file, content, like)
    try:
        new.replace(file)
    except OSError:
        new.unlink(missing_ok=True)
        raise


def _written(file: Path, content: bytes, like: Path) -> Path:
    """Write a file next to another, with the owner, group and rights of a third, and return it."""
    handle, name = tempfile.mkstemp(dir=file.parent, prefix=f".{file.name}.")
    try:
        with os.fdopen(handle, "wb") as stream:
            owner = like.stat()
            os.fchown(stream.fileno(), owner.st_uid, owner.st_gid)
            shutil.copystat(like, name)  # access control lists, too
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
    except OSError:
        Path(name).unlink(missing_ok=True)
        raise
    return Path(name)


# A measured load put to use: the running daemon takes the file, and adaptive control begins.

LONGEST_S = 60.0
"""Longest time for the daemon to begin another run, and for the drive to run in it."""

_GAP_S = 0.3


async def put_to_use(
    broker: services.Mqtt, drive: str, digest: str, setpoint: float, timeout_s: float
) -> float:
    """Have the daemon take the measured load of its file, and hold a set-point in mode adaptive.

    Args:
        broker: The broker.
        drive: Name of the drive, in standby.
        digest: Of the file that was written; a daemon with another one refuses.
        setpoint: Set-point, one that the experiment has led the output to.
        timeout_s: Longest wait for a reply.

    Returns:
        Time in seconds until the adaptive controller was in force.

    Raises:
        AdaptdriveError: The daemon refuses, or the drive does not run; it is off then.
    """
    began_s = time.monotonic()
    await _once(broker, drive, "reload", None, timeout_s, measured=digest)
    with ended_once():
        try:
            await _accepted(broker, drive, "mode", "adaptive", timeout_s)  # it energises nothing
            await _measuring(broker, drive, timeout_s)
            await _once(broker, drive, "enable", None, timeout_s)  # a repeat could undo a stop
            await _accepted(broker, drive, "setpoint", setpoint, timeout_s)
            await _in_force(broker, drive, timeout_s)
        except BaseException:
            await whole(_stop(broker, drive, timeout_s), complete=True)
            raise
    return time.monotonic() - began_s


async def _stop(broker: services.Mqtt, drive: str, timeout_s: float) -> None:
    try:
        await send_command(broker, drive, "disable", None, timeout_s)
    except NoAnswerError as silence:
        tell(
            f"the stop is unanswered ({silence.problem}): {drive} may run in mode adaptive; look "
            "at it, and disable it"
        )


async def _once(
    broker: services.Mqtt, drive: str, verb: str, value: object, timeout_s: float, **more: object
) -> None:
    """Send a command, and end where it is refused."""
    reply = await send_command(broker, drive, verb, value, timeout_s, **more)
    if not reply.accepted:
        raise CommissionError(f"{drive} refused {verb}: {reply.reason}")


async def _measuring(broker: services.Mqtt, drive: str, timeout_s: float) -> None:
    """Wait until the new run has a measurement, without which it refuses `enable`."""
    end_s = time.monotonic() + LONGEST_S
    while True:
        status = await read_status(broker, drive, timeout_s)
        age_s = status.telemetry.get("drive", {}).get("age_s")
        if status.live and age_s is not None and age_s < LIVE_S:
            return
        if time.monotonic() > end_s:
            raise CommissionError(f"{drive} has no measurement after {LONGEST_S:g} s")
        await asyncio.sleep(_GAP_S)


async def _accepted(
    broker: services.Mqtt, drive: str, verb: str, value: object, timeout_s: float
) -> None:
    """Send a command until it is accepted: the daemon begins another run."""
    end_s = time.monotonic() + LONGEST_S
    while True:
        try:
            reply = await send_command(broker, drive, verb, value, timeout_s)
        except NoAnswerError as silence:
            why = silence.problem
        else:
            if reply.accepted:
                return
            why = reply.reason
        if time.monotonic() > end_s:
            raise CommissionError(f"{drive} refused {verb} for {LONGEST_S:g} s: {why}")
        await asyncio.sleep(_GAP_S)


async def _in_force(broker: services.Mqtt, drive: str, timeout_s: float) -> None:
    """Wait until the adaptive controller runs the drive."""
    end_s = time.monotonic() + LONGEST_S
    while True:
        state = (await read_status(broker, drive, timeout_s)).state or {}
        if state.get("controller") == "adaptive" and state.get("state") == "running":
            return
        if state.get("trip"):
            raise CommissionError(f"{drive} is {state.get('state')}: {state['trip']}")
        if time.monotonic() > end_s:
            raise CommissionError(f"{drive} is not in adaptive control: {state.get('reason')}")
        await asyncio.sleep(_GAP_S)


# Commissioning from the first look at the sensors to the proposal.


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
def alone(drive: str, broker: services.Mqtt) -> Iterator[None]:
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
        f"{client.HOLD_S:g} s without this program; the drive is then off."
    )


async def commission(
    wanted: CommissionRequest, drive: str, broker: services.Mqtt, timeout_s: float
) -> report.Commissioned:
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
    guide = client.Guide(broker, drive, timeout_s)
    standby = await guide.watch_standby(wanted.standby_s)
    sensor = evaluation.judge_sensor(standby, configuration, target.move)
    experiment = LoadExperiment(target)
    await picture.carry_out(guide, experiment, picture.Picture(drive, target))
    return report.judged(sensor, experiment, configuration, text, wanted.path)


def _configuration_of(drive: str, text: str, path: Path) -> root.Configuration:
    """Return the configuration of a drive; the limits of another one do not hold for it."""
    configuration = examine_text(text, path)
    if configuration.drive.name != drive:
        flaw = Flaw("drive.name", f"is {configuration.drive.name}, and {drive} was named")
        raise ConfigurationError(path, [flaw])
    return configuration


def write(path: Path, commissioned: report.Commissioned) -> tuple[Path, str]:
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


def reached(commissioned: report.Commissioned) -> float:
    """Return an output to hold next: one that the experiment has led the load to."""
    outcome, load = commissioned.outcome, commissioned.before.load
    reached = float(f"{outcome.rest + outcome.moved:.4g}")
    return min(max(reached, load.reference_min), load.reference_max)
