"""Showing a demonstration while it runs: a live screen, a progress bar, or nothing."""

from __future__ import annotations

import asyncio
import os
import shutil
import sys
from pathlib import Path
from typing import NoReturn

from rich.console import Console
from rich.live import Live
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from adaptdrive_sim.demo.record import DemoRecord
from adaptdrive_sim.demo.settings import DemoSettings
from adaptdrive_sim.demo.stage import Show, Venue
from adaptdrive_sim.demo.view import WIDE, ViewContext, screen

_REFRESH_s = 0.25
_PERIODS_SHOWN, _PERIODS_SHOWN_WIDE = 2.0, 3.0


def choose_show(settings: DemoSettings) -> Show:
    """The live screen on a terminal; headless a progress bar there, and nothing in a pipe."""
    if not settings.headless:
        return _live(settings)
    return _progress(settings) if sys.stderr.isatty() else _nothing


def operator_program() -> str:
    """Return the command for `adaptdrive`: its name, or its path if the name is not found."""
    if shutil.which("adaptdrive"):
        return "adaptdrive"
    path = Path(sys.executable).with_name("adaptdrive")
    return os.path.relpath(path) if path.is_relative_to(Path.cwd()) else str(path)


def _live(settings: DemoSettings) -> Show:
    async def show(record: DemoRecord, scene: Venue) -> None:
        console = Console()
        try:
            with Live(console=console, screen=True, auto_refresh=False) as live:
                while True:
                    size = console.size
                    around = _surroundings(settings, scene, size.width)
                    live.update(screen(record, around, (size.width, size.height)), refresh=True)
                    await asyncio.sleep(_REFRESH_s)
        finally:
            console.print("The drive is brought to its safe state, and the session is closed.")

    return show


def _surroundings(settings: DemoSettings, scene: Venue, width: int) -> ViewContext:
    periods = _PERIODS_SHOWN_WIDE if width >= WIDE else _PERIODS_SHOWN
    return ViewContext(
        bus=str(scene.bus),
        broker=scene.broker_text,
        panel=scene.panel.address if scene.panel else "",
        program=operator_program(),
        duration_s=settings.duration_s,
        longest_window_s=periods * settings.period_s,
    )


def _progress(settings: DemoSettings) -> Show:
    async def show(record: DemoRecord, _: Venue) -> None:
        columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
        console = Console(stderr=True)
        with Progress(*columns, console=console, transient=True, redirect_stdout=False) as bar:
            task = bar.add_task("starting", total=settings.duration_s)
            while True:
                bar.update(task, description=_what(record), completed=_controlled_s(record))
                await asyncio.sleep(_REFRESH_s)

    return show


def _what(record: DemoRecord) -> str:
    state = record.state
    return f"{state.state}, {state.controller}" if state else "starting"


def _controlled_s(record: DemoRecord) -> float:
    return record.clock() - record.first.time_s if record.first else 0.0


async def _nothing(_: DemoRecord, __: Venue) -> NoReturn:
    await asyncio.Event().wait()
    raise AssertionError
