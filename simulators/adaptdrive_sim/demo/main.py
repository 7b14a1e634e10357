"""`adaptdrive-sim demo`: plays one story and prints its outcome."""

from __future__ import annotations

import asyncio
import sys
import time
import webbrowser
from collections.abc import Coroutine
from dataclasses import replace
from typing import Any

import msgspec

from adaptdrive.aside import in_thread
from adaptdrive.config.file import validate_configuration
from adaptdrive.errors import AdaptdriveError, first_error
from adaptdrive.watch.ending import ended_once
from adaptdrive.watch.keys import KeyCommand, KeyReader
from adaptdrive.watch.main import run_view
from adaptdrive.watch.sending import CommandsUnderWay
from adaptdrive.watch.view import refuse_dumb_terminal
from adaptdrive_sim.demo.player import Player
from adaptdrive_sim.demo.processes import ProcessDiedError
from adaptdrive_sim.demo.real import RealStage
from adaptdrive_sim.demo.record import DemoRecord
from adaptdrive_sim.demo.settings import DemoSettings
from adaptdrive_sim.demo.story import Story, read_story
from adaptdrive_sim.demo.summary import keep_marks, operator_program, show_end, summarise
from adaptdrive_sim.demo.view import DemoView
from adaptdrive_sim.demo.virtual import VirtualStage
from adaptdrive_sim.device_main import build_world
from adaptdrive_sim.device_settings import DeviceSettings
from adaptdrive_sim.experiments.examples import FOLDER

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
    settings = replace(settings, headless=not seen)
    if seen:
        refuse_dumb_terminal()
    virtual = story.speed is not None
    failure, summary = asyncio.run(
        _play_virtual(story, settings) if virtual else _play_real(story, settings)
    )
    if settings.headless:
        sys.stdout.write(msgspec.json.encode(summary).decode() + "\n")
    if not summary["ok"]:
        tail = failure.tail if isinstance(failure, ProcessDiedError) else []
        lines = [f"adaptdrive-sim: {summary['reason']}", *(f"  {line}" for line in tail)]
        sys.stderr.write("\n".join(lines) + "\n")
    return 0 if summary["ok"] else 1


Outcome = tuple[AdaptdriveError | None, dict[str, Any]]


async def _play_real(story: Story, settings: DemoSettings) -> Outcome:
    failure: AdaptdriveError | None = None
    stage = RealStage(story, settings)
    record = DemoRecord(stage.drive, time.monotonic, story=story)
    player = Player(story, stage, record, settings.duration_s)
    places = {
        "folder": str(stage.workspace.directory),
        "bus": str(stage.bus),
        "broker": stage.broker,
        "try": f"{operator_program()} mode {stage.drive} adaptive --broker {stage.broker}",
        "or": f"{operator_program()} watch {stage.drive} --broker {stage.broker}",
    }
    try:
        async with stage:
            await _perform(_Hand(record, player, stage, places), stage.services(record), settings)
    except* AdaptdriveError as problems:
        failure = first_error(problems)
    session = stage.workspace.session()
    if session is not None:
        keep_marks(record, session)
    found = summarise(record, player, str(failure or "")) | {
        "bus": str(stage.bus),
        "broker": stage.broker,
        "directory": str(stage.workspace.directory),
        "session": None if session is None else str(session),
    }
    if not settings.headless:
        show_end(record, found, session)
    return failure, found


async def _play_virtual(story: Story, settings: DemoSettings) -> Outcome:
    """Let the controller of a configuration play in front of the simulated plant."""
    configuration = validate_configuration(story.document(), FOLDER / story.configuration)
    noise = story.noise if settings.noise is None else settings.noise
    device = DeviceSettings(
        noise_V=noise, seed=settings.seed, initial_voltage_V=story.initial_voltage_V
    )
    speed = settings.speed or story.speed or 1.0
    world = build_world(configuration, device)
    stage = VirtualStage(configuration, world, speed)
    record = DemoRecord(configuration.drive.name, time.monotonic, story=story)
    player = Player(story, stage, record, settings.duration_s)
    stage.open(record)
    places = {"time": f"virtual, {speed:g} times real time: no bus, no broker, no panel"}
    failure: AdaptdriveError | None = None
    try:
        await _perform(_Hand(record, player, stage, places), [], settings)
    except AdaptdriveError as problem:
        failure = problem
    found = summarise(record, player, str(failure or "")) | {"virtual_time": True, "speed": speed}
    if not settings.headless:
        show_end(record, found, None)
    return failure, found


async def _perform(hand: _Hand, services: list[Service], settings: DemoSettings) -> None:
    """Play to the end, until `q`, or until a signal asks for the end."""
    services = [hand.player.run(), *services]
    try:
        if settings.headless:
            await _unseen(services)
        else:
            await run_view(hand.view.screen, hand.press, hand.under_way, services)
    except KeyboardInterrupt:
        return


async def _unseen(services: list[Service]) -> None:
    with ended_once():
        tasks = [asyncio.ensure_future(one) for one in services]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
    for task in done:
        await task


class _Hand:
    """What the keys of a viewer do."""

    def __init__(
        self,
        record: DemoRecord,
        player: Player,
        stage: RealStage | VirtualStage,
        places: dict[str, str],
    ) -> None:
        self.player = player
        self.view = DemoView(record, player, places)
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
        if not isinstance(self._stage, RealStage):
            self._record.answer = "panel: this story passes in virtual time, without a broker"
            return
        self._record.answer = "panel: starting…"
        try:
            address = await self._stage.panel()
        except AdaptdriveError as problem:
            self._record.answer = f"panel: {problem}"
        else:
            self._record.answer = f"panel: {address} (log in without a name)"
            in_thread(lambda: webbrowser.open(address), "adaptdrive-browser")
