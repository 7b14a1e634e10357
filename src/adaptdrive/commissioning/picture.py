"""An experiment with its live picture in a terminal, ended by a key."""

import asyncio
import functools
import math
import sys
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NoReturn

from rich.layout import Layout
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from adaptdrive.commissioning import client, course
from adaptdrive.commissioning.experiment import LoadExperiment
from adaptdrive.tui import record, terminal, view
from adaptdrive.util.errors import CommissionError

KEYS = "q ends the experiment with the drive off, as does Ctrl-C"
_POINTS = 6000
_SHORTEST_WINDOW_S, _LONGEST_WINDOW_S = 30.0, 600.0
_HEADER_ROWS, _BAR_WIDTH = 2, 20


@dataclass(slots=True)
class Picture:
    """Live picture of an experiment.

    Attributes:
        drive: Name of the drive.
        experiment: The experiment.
        points: Output and the other signals over time.
        marks: Begin of each phase.
    """

    drive: str
    experiment: LoadExperiment
    points: deque[record.PlotPoint] = field(default_factory=lambda: deque(maxlen=_POINTS))
    marks: deque[record.Mark] = field(default_factory=lambda: deque(maxlen=50))

    def take(self, reading: client.FastReading) -> None:
        """Take a reading that the experiment has taken."""
        phase, outcome = self.experiment.course.phase.name.lower(), self.experiment.outcome
        if not self.marks or self.marks[-1][1] != phase:
            self.marks.append((reading.time_s, phase))
        rest = reading.output if outcome is None else outcome.rest
        self.points.append(record.PlotPoint(reading.time_s, rest, reading.output, "manual"))


def screen(picture: Picture, size: tuple[int, int]) -> Layout:
    """Return the whole screen.

    Args:
        picture: What is shown.
        size: Width and height of the terminal in characters.
    """
    width, height = size
    points = list(picture.points)
    now_s = points[-1].time_s if points else 0.0
    since_s = now_s - points[0].time_s if points else 0.0
    window_s = min(max(since_s, _SHORTEST_WINDOW_S), _LONGEST_WINDOW_S)
    canvas = (width - 1, height - _HEADER_ROWS - 2)
    target = picture.experiment.course.target
    content = record.plot(points, list(picture.marks), now_s, window_s, canvas)
    layout = Layout()
    layout.split_column(
        Layout(_header(picture, points), size=_HEADER_ROWS),
        Layout(view.titled(Text(f"{target.name} in {target.unit or '1'}"), content)),
        Layout(view.cut(Text(f" {KEYS}", view.DIM)), size=1),
    )
    return layout


def _header(picture: Picture, points: list[record.PlotPoint]) -> Table:
    now, started = picture.experiment.course, bool(points)
    target, given = now.target, now.target.given
    asked = f"{given.symbol} {view.figure(now.voltage_V if started else math.nan)} {given.unit}"
    output = f"{target.name} {view.figure(points[-1].output if started else math.nan)}"
    phase = str(now.phase) if started else "the drive starts"
    grid = Table.grid(expand=True)
    grid.add_row(view.cut(Text.assemble((f" {picture.drive} ", "bold reverse"), f" {phase}")))
    line = Table.grid(padding=(0, 1))
    bar = ProgressBar(total=1.0, completed=now.progress, width=_BAR_WIDTH)
    line.add_row("", bar, Text(f"{_ahead(now)}   {asked}   {output} {target.unit}"))
    grid.add_row(line)
    return grid


def _ahead(now: course.ExperimentCourse) -> str:
    """Return the share of the phase, and the time to the end where it is known."""
    share = f"{100.0 * now.progress:3.0f} %"
    if math.isnan(now.remaining_s):
        return share
    minutes, seconds = divmod(round(now.remaining_s), 60)
    return f"{share}, {minutes}:{seconds:02d} left"


async def carry_out(guide: client.Guide, picture: Picture) -> None:
    """Run an experiment and show it: as a picture where a terminal takes one, else by lines.

    Args:
        guide: The drive.
        picture: Of the experiment.

    Raises:
        AdaptdriveError: The experiment cannot continue, or was ended.
    """
    try:
        with terminal.ended_once():
            if sys.stdin.isatty() and sys.stdout.isatty():
                await _with_picture(guide, picture)
            else:
                await guide.carry_out(picture.experiment, phase_lines(picture.experiment))
    finally:
        if guide.unstopped:
            sys.stderr.write(f"adaptdrive: {guide.unstopped}\n")


async def _with_picture(guide: client.Guide, picture: Picture) -> None:
    lines = phase_lines(picture.experiment)

    def show(reading: client.FastReading, voltage_V: float) -> None:
        picture.take(reading)
        if drawing.done():
            lines(reading, voltage_V)

    work = asyncio.create_task(guide.carry_out(picture.experiment, show))
    drawing = asyncio.create_task(terminal.draw(functools.partial(screen, picture)))
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


def phase_lines(experiment: LoadExperiment) -> Callable[[client.FastReading, float], None]:
    """Return what prints the begin of each phase; a terminal that takes no output holds up nothing.

    It takes each reading, and the voltage that follows from it.
    """
    known: course.Phase | None = None

    def show(reading: client.FastReading, voltage_V: float) -> None:
        nonlocal known
        now = experiment.course
        if now.phase is known:
            return
        known, given = now.phase, now.target.given
        left = "" if math.isnan(now.remaining_s) else f" for {now.remaining_s:.0f} s"
        output = f"output {reading.output:.4g}"
        terminal.print_line(f"{given.symbol} {given.text(voltage_V)}  {output}  {known}{left}")

    return show
