"""`adaptdrive-sim demo`: plays one story and prints its outcome."""

from __future__ import annotations

import asyncio
import sys
import time
from contextlib import suppress
from dataclasses import replace
from typing import Any

import msgspec

from adaptdrive.errors import AdaptdriveError, first_error
from adaptdrive.household.processes import ProcessDiedError
from adaptdrive.watch.main import run_view
from adaptdrive.watch.terminal import refuse_dumb_terminal
from adaptdrive_sim.demo.player import Player
from adaptdrive_sim.demo.real import RealStage
from adaptdrive_sim.demo.record import DemoRecord
from adaptdrive_sim.demo.settings import DemoSettings
from adaptdrive_sim.demo.story import Story, read_story
from adaptdrive_sim.demo.summary import keep_marks, show_end, summarise
from adaptdrive_sim.demo.view import DemoView
from adaptdrive_sim.demo.virtual import VirtualStage


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
            view = DemoView(record, player, stage)
            show = None if settings.headless else view.screen
            jobs = [player.run(), *stage.services(record)]
            with suppress(KeyboardInterrupt):
                await run_view(record, stage.ask, jobs, show, view.takes)
    except* AdaptdriveError as problems:
        problem = first_error(problems)
    if stage.session is not None:
        keep_marks(record, stage.session)
    summary = summarise(record, player, str(problem or "")) | stage.facts
    if not settings.headless:
        show_end(record, summary, stage.session)
    return summary, problem
