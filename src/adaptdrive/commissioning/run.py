"""Commissioning of a drive, or of a plant of the user, from the first look to the new settings."""

import asyncio
import functools
import math
import os
import sys
import time
from collections.abc import Awaitable, Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import NoReturn

from rich.layout import Layout
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from adaptdrive.analysis.closed_loop import Plant, PlantLoop
from adaptdrive.app.examine import examine_text
from adaptdrive.app.process import locked
from adaptdrive.commissioning import client, evaluation
from adaptdrive.commissioning.course import ExperimentCourse, Phase, Samples, Target, build_target
from adaptdrive.commissioning.experiment import load_experiment
from adaptdrive.config import root
from adaptdrive.config.file import read_text
from adaptdrive.control.signals import Command
from adaptdrive.mqtt.client import LIVE_S, NoAnswerError
from adaptdrive.mqtt.connection import Broker
from adaptdrive.safety.timing import timing_of
from adaptdrive.tui import terminal, view
from adaptdrive.tui.record import PlotPoint, WatchRecord
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
    with terminal.ended_once():
        try:
            # the mode energises nothing
            await _until_none(guide, lambda: _refusal(guide, "mode", "adaptive"))
            await _until_none(guide, lambda: _lack_of_measurement(guide))
            await guide.ask("enable")  # a repeat could undo a stop
            await _until_none(guide, lambda: _refusal(guide, "setpoint", setpoint))
            await _until_none(guide, lambda: _lack_of_control(guide))
        except BaseException:
            await terminal.whole(_stop(guide), complete=True)
            raise
    return time.monotonic() - began_s


async def _stop(guide: client.Guide) -> None:
    try:
        await guide.send("disable")
    except NoAnswerError as silence:
        terminal.print_line(
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


# An experiment with its live picture in a terminal, ended by a key.

_KEYS = "q ends the experiment with the drive off, as does Ctrl-C"
_HEADER_ROWS, _BAR_WIDTH = 2, 20


def take_point(record: WatchRecord, course: ExperimentCourse, reading: client.FastReading) -> None:
    """Add a reading that an experiment has taken, and the begin of its phase, to a picture.

    Args:
        record: The picture.
        course: The experiment.
        reading: The reading.
    """
    phase, outcome = course.phase.name.lower(), course.outcome
    if not record.marks or record.marks[-1][1] != phase:
        record.marks.append((reading.time_s, phase))
    rest = reading.output if outcome is None else outcome.rest
    record.points.append(PlotPoint(reading.time_s, rest, reading.output, "manual"))


def screen(record: WatchRecord, course: ExperimentCourse, size: tuple[int, int]) -> Layout:
    """Return the whole screen.

    Args:
        record: Output and phases over time.
        course: The experiment.
        size: Width and height of the terminal in characters.
    """
    target, rows = course.target, size[1] - _HEADER_ROWS - 1
    title = Text(f"{target.name} in {target.unit or '1'}")
    layout = Layout()
    layout.split_column(
        Layout(_header(record, course), size=_HEADER_ROWS),
        Layout(view.plotted(record, title, (size[0], rows))),
        Layout(view.cut(Text(f" {_KEYS}", view.DIM)), size=1),
    )
    return layout


def _header(record: WatchRecord, course: ExperimentCourse) -> Table:
    target, given, points = course.target, course.target.given, record.points
    asked_V, output = (course.voltage_V, points[-1].output) if points else (math.nan, math.nan)
    asked = f"{given.symbol} {view.figure(asked_V)} {given.unit}"
    shown = f"{target.name} {view.figure(output)} {target.unit}"
    phase = str(course.phase) if points else "the drive starts"
    grid, line = Table.grid(expand=True), Table.grid(padding=(0, 1))
    grid.add_row(view.cut(Text.assemble((f" {record.drive} ", "bold reverse"), f" {phase}")))
    bar = ProgressBar(total=1.0, completed=course.progress, width=_BAR_WIDTH)
    line.add_row("", bar, Text(f"{_ahead(course)}   {asked}   {shown}"))
    grid.add_row(line)
    return grid


def _ahead(course: ExperimentCourse) -> str:
    """Return the share of the phase, and the time to the end where it is known."""
    share = f"{100.0 * course.progress:3.0f} %"
    if math.isnan(course.remaining_s):
        return share
    minutes, seconds = divmod(round(course.remaining_s), 60)
    return f"{share}, {minutes}:{seconds:02d} left"


async def carry_out(guide: client.Guide, course: ExperimentCourse) -> None:
    """Run an experiment and show it: as a picture where a terminal takes one, else by lines.

    Args:
        guide: The drive.
        course: The experiment.

    Raises:
        AdaptdriveError: The experiment cannot continue, or was ended.
    """
    try:
        with terminal.ended_once():
            if sys.stdin.isatty() and sys.stdout.isatty():
                await _with_picture(guide, course)
            else:
                await guide.carry_out(course, phase_lines(course))
    finally:
        if guide.unstopped:
            sys.stderr.write(f"adaptdrive: {guide.unstopped}\n")


async def _with_picture(guide: client.Guide, course: ExperimentCourse) -> None:
    record, lines = WatchRecord(guide.drive, time.monotonic), phase_lines(course)

    def show(reading: client.FastReading, voltage_V: float) -> None:
        take_point(record, course, reading)
        if drawing.done():
            lines(reading, voltage_V)

    work = asyncio.create_task(guide.carry_out(course, show))
    drawing = asyncio.create_task(terminal.draw(functools.partial(screen, record, course)))
    drawing.add_done_callback(_explain)
    pressed = asyncio.Event()

    def on_keys(keys: str) -> None:
        if terminal.QUIT in keys:
            pressed.set()
            work.cancel()

    try:
        with terminal.pressed_keys(on_keys):
            await work
    except asyncio.CancelledError:
        if pressed.is_set():
            off = "" if guide.unstopped else ": the drive is off"
            raise CommissionError(f"ended by a key{off}") from None
        raise
    finally:
        drawing.cancel()
        await asyncio.wait([drawing])


def _explain(drawing: asyncio.Task[NoReturn]) -> None:
    """Tell why there is no picture any more."""
    if not drawing.cancelled():
        why = " ".join(str(drawing.exception()).split())
        terminal.print_line(f"adaptdrive: no picture, each phase is a line: {why}")


def phase_lines(course: ExperimentCourse) -> Callable[[client.FastReading, float], None]:
    """Return what prints the begin of each phase; a terminal that takes no output holds up nothing.

    It takes each reading, and the voltage that follows from it.
    """
    known: Phase | None = None

    def show(reading: client.FastReading, voltage_V: float) -> None:
        nonlocal known
        if course.phase is known:
            return
        known, given = course.phase, course.target.given
        left = "" if math.isnan(course.remaining_s) else f" for {course.remaining_s:.0f} s"
        output = f"output {reading.output:.4g}"
        terminal.print_line(f"{given.symbol} {given.text(voltage_V)}  {output}  {known}{left}")

    return show


# Commissioning from the first look at the sensors to the proposal.

_WATCHED_S = 5.0
"""Time for which the sensors are watched with the drive off."""


def alone(drive: str, broker: Broker) -> AbstractContextManager[object]:
    """Keep other experiments off a drive until the block ends.

    Args:
        drive: Name of the drive.
        broker: Its broker, as others may have a drive of that name.

    Raises:
        AdaptdriveError: Another process of this machine commissions it.
    """
    experiment = f"commissioning of {drive!r} by {broker.host}:{broker.port}"
    return locked([experiment], os.environ, f"{drive} is already commissioned by {{holder}}")


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
    evaluation.refuse_blind(standby, configuration, target.move)
    experiment = load_experiment(target)
    await carry_out(guide, experiment)
    return evaluation.judged(standby, experiment, configuration, text, path)


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


# The experiment on a plant of the user, in virtual time.

_SAMPLE_S = 0.1
"""Time between two samples, as between two messages of the daemon."""

_LONGEST_RUN_S = 30.0 * 86400.0


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
    loop, standby = PlantLoop(configuration, plant, follows=True), Samples()
    count = max(1, round(_SAMPLE_S / timing_of(configuration).reading_s))

    def sample(voltage_V: float) -> tuple[float, float, float]:
        """Advance by a sample under V_c: to its time, boost voltage and output."""
        for _ in range(count):
            loop.step(Command(0.0, voltage_V, bridge=True))
        return loop.time_s, loop.voltage_V, loop.output

    while not standby.times_s or standby.times_s[-1] < _WATCHED_S:
        standby.append(*sample(target.low_V))
    evaluation.refuse_blind(standby, configuration, target.move)
    experiment = load_experiment(target)
    while not experiment.done:
        experiment.take(*sample(experiment.voltage_V))
        if experiment.time_s > _LONGEST_RUN_S:
            raise CommissionError("the experiment does not end within 30 days")
    return evaluation.judged(standby, experiment, configuration, text, path)
