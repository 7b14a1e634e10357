"""`adaptdrive-sim demo`: plays one story and prints its outcome."""

from __future__ import annotations

import asyncio
import sys
import time
import webbrowser
from collections.abc import Coroutine
from contextlib import suppress
from dataclasses import replace
from typing import Any

import msgspec

from adaptdrive.aside import in_thread
from adaptdrive.errors import AdaptdriveError, first_error
from adaptdrive.household.processes import ProcessDiedError
from adaptdrive.watch.keys import KeyCommand, KeyReader
from adaptdrive.watch.main import run_view
from adaptdrive.watch.sending import CommandsUnderWay
from adaptdrive.watch.terminal import refuse_dumb_terminal
from adaptdrive_sim.demo.player import Player
from adaptdrive_sim.demo.real import RealStage
from adaptdrive_sim.demo.record import DemoRecord
from adaptdrive_sim.demo.settings import DemoSettings
from adaptdrive_sim.demo.story import Story, read_story
from adaptdrive_sim.demo.summary import keep_marks, show_end, summarise
from adaptdrive_sim.demo.view import DemoView
from adaptdrive_sim.demo.virtual import VirtualStage

Service = Coroutine[Any, Any, None]


def run_demo(name: str, settings: DemoSettings) -> int:
    """Play a story and print its summary.

    Args:
        name: Name of the story.
        settings: What is wanted; without a terminal it is headless anyway.

    Returns:
        0 when control worked, 1 when it failed.

    Raises:
        AdaptdriveError: It could not begin.
    """
    story = read_story(name)
    settings.check(virtual=story.speed is not None)
    seen = sys.stdout.isatty() and sys.stdin.isatty() and not settings.headless
    if seen:
        refuse_dumb_terminal()
    summary, problem = asyncio.run(_play(story, replace(settings, headless=not seen)))
    if not seen:
        sys.stdout.write(msgspec.json.encode(summary).decode() + "\n")
    if not summary["ok"]:
        tail = problem.tail if isinstance(problem, ProcessDiedError) else []
        lines = [f"adaptdrive-sim: {summary['reason']}", *(f"  {line}" for line in tail)]
        sys.stderr.write("\n".join(lines) + "\n")
    return 0 if summary["ok"] else 1


async def _play(
    story: Story, settings: DemoSettings
) -> tuple[dict[str, Any], AdaptdriveError | None]:
    """Play a story to its end, and return its figures and what has ended it early."""
    problem: AdaptdriveError | None = None
    virtual = story.speed is not None
    stage = VirtualStage(story, settings) if virtual else RealStage(story, settings)
    record = DemoRecord(stage.drive_name, time.monotonic, story=story)
    player = Player(story, stage, record, settings.duration_s)
    try:
        async with stage:
            await _perform(_Hand(record, player, stage), stage.services(record), settings)
    except* AdaptdriveError as problems:
        problem = first_error(problems)
    if stage.session is not None:
        keep_marks(record, stage.session)
    summary = summarise(record, player, str(problem or "")) | stage.facts
    if not settings.headless:
        show_end(record, summary, stage.session)
    return summary, problem


async def _perform(hand: _Hand, services: list[Service], settings: DemoSettings) -> None:
    """Play to the end, until `q`, or until a signal asks for the end."""
    show = None if settings.headless else hand.view.screen
    with suppress(KeyboardInterrupt):
        await run_view(show, hand.press, hand.under_way, [hand.player.run(), *services])


class _Hand:
    """Maps the keys of a viewer to what they do."""

    def __init__(
        self,
        record: DemoRecord,
        player: Player,
        stage: RealStage | VirtualStage,
    ) -> None:
        self.player = player
        self.view = DemoView(record, player, stage.places)
        self.under_way = CommandsUnderWay(stage.ask, record)
        self._record, self._stage = record, stage
        self._reader = KeyReader(record)
        self._opening: asyncio.Task[None] | None = None

    def press(self, key: str, *, alone: bool = True) -> KeyCommand | None:
        """Return the command of a key, None for none."""
        if key == " ":
            self.player.toggle()
        elif key == "?":
            self.view.help = not self.view.help
        elif key == "p":
            self._opening = asyncio.create_task(self._open_panel())
        elif key == "d":
            return self.player.dropped()
        else:
            command = self._reader.press(key, alone=alone)
            if command is not None and command.stops:
                self.player.hold("The drive was stopped.")
            return command
        return None

    async def _open_panel(self) -> None:
        self._record.answer = "panel: starting…"
        try:
            address = await self._stage.panel()
        except AdaptdriveError as problem:
            self._record.answer = f"panel: {problem}"
        else:
            self._record.answer = f"panel: {address}"
            in_thread(lambda: webbrowser.open(address), "adaptdrive-browser")
