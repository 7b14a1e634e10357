"""An experiment with its live picture, ended by a key."""

from __future__ import annotations

import asyncio
import functools
import math
import sys
from typing import NoReturn

from adaptdrive.commission.experiment import LoadExperiment
from adaptdrive.commission.guide import Guide
from adaptdrive.commission.phases import Phase
from adaptdrive.commission.picture import Picture, screen
from adaptdrive.commission.readings import FastReading
from adaptdrive.errors import CommissionError
from adaptdrive.watch.ending import ended_once, tell
from adaptdrive.watch.keys import QUIT, pressed_keys
from adaptdrive.watch.terminal import draw


async def carry_out(guide: Guide, experiment: LoadExperiment, picture: Picture) -> None:
    """Run an experiment and show it: as a picture where a terminal takes one, else by lines.

    Args:
        guide: The drive.
        experiment: The experiment.
        picture: Takes what is shown.

    Raises:
        AdaptdriveError: The experiment cannot continue, or was ended.
    """
    try:
        with ended_once():
            if sys.stdin.isatty() and sys.stdout.isatty():
                await _with_picture(guide, experiment, picture)
            else:
                await guide.carry_out(experiment, PhaseLines(experiment))
    finally:
        if guide.unstopped:
            sys.stderr.write(f"adaptdrive: {guide.unstopped}\n")


async def _with_picture(guide: Guide, experiment: LoadExperiment, picture: Picture) -> None:
    lines = PhaseLines(experiment)

    def show(reading: FastReading, voltage_V: float) -> None:
        picture.take(experiment, reading, voltage_V)
        if drawing.done():
            lines(reading, voltage_V)

    work = asyncio.create_task(guide.carry_out(experiment, show))
    drawing = asyncio.create_task(draw(functools.partial(screen, picture)))
    drawing.add_done_callback(_explain)
    pressed = asyncio.Event()

    def on_keys(keys: str) -> None:
        if QUIT in keys:
            pressed.set()
            work.cancel()

    try:
        with pressed_keys(on_keys):
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
        tell(f"adaptdrive: no picture, each phase is a line: {why}")


class PhaseLines:
    """Prints the begin of each phase; a terminal that takes no output holds up nothing."""

    def __init__(self, experiment: LoadExperiment) -> None:
        self._experiment = experiment
        self._phase: Phase | None = None

    def __call__(self, reading: FastReading, voltage_V: float) -> None:
        """Take a reading and the voltage that follows from it."""
        phase = self._experiment.course.phase
        if phase is not self._phase:
            self._phase = phase
            output = f"output {reading.output:.4g}"
            left_s = self._experiment.course.remaining_s
            left = "" if math.isnan(left_s) else f" for {left_s:.0f} s"
            tell(f"V_c {voltage_V:.4g} V  {output}  {phase}{left}")
