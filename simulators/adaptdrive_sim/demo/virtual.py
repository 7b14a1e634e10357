"""A demonstration in virtual time: one process, no bus, N times real time."""

from __future__ import annotations

import asyncio
import math
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

from rich.console import Console
from rich.live import Live

from adaptdrive.config.file import validate_configuration
from adaptdrive.runtime.requests import Enable
from adaptdrive_sim.demo.bath_story import BathStory
from adaptdrive_sim.demo.battery_story import BatteryStory
from adaptdrive_sim.demo.braking_story import BrakingStory
from adaptdrive_sim.demo.settings import VirtualSettings
from adaptdrive_sim.demo.stage import end_on_signals
from adaptdrive_sim.demo.story import Scene, Story
from adaptdrive_sim.demo.subject import Subject
from adaptdrive_sim.demo.summary import one_line
from adaptdrive_sim.demo.view import ViewContext, screen
from adaptdrive_sim.experiments.examples import FOLDER, example_tables
from adaptdrive_sim.line import LineParameters
from adaptdrive_sim.noise import NoiseParameters
from adaptdrive_sim.plants.boost import BoostParameters
from adaptdrive_sim.world import WorldParameters

_STORIES: dict[str, type[BathStory | BatteryStory | BrakingStory]] = {
    "bath": BathStory,
    "battery": BatteryStory,
    "braking": BrakingStory,
}
_FILES = {"bath": "bath", "battery": "battery", "braking": "motor-bidirectional"}
_NOISE = {"bath": 0.05, "battery": 0.02, "braking": 0.0004}
_SLICE_s = 0.02
_BREAK_s = 0.005
_REFRESH_s = 0.25
_LINE_DRIFT_Hz = 0.1


def run_virtual(settings: VirtualSettings) -> int:
    """Run a demonstration in virtual time and print its summary.

    Args:
        settings: What is wanted; without a terminal it is headless anyway.

    Returns:
        0 when control worked, 1 when it failed.

    Raises:
        AdaptdriveError: It could not begin.
    """
    settings.check()
    headless = settings.headless or not sys.stdout.isatty()
    story = build_story(settings)
    asyncio.run(_perform(settings, story, headless=headless))
    found = summarise(story, settings.speed)
    sys.stdout.write((one_line(found) if headless else "\n".join(_lines(found))) + "\n")
    if not found["ok"]:
        sys.stderr.write(f"adaptdrive-sim: {found['reason']}\n")
    return 0 if found["ok"] else 1


def build_story(settings: VirtualSettings) -> Story:
    """The controller of the packaged configuration, in front of the load's simulated plant."""
    source = f"{_FILES[settings.load]}.toml"
    configuration = validate_configuration(example_tables(source), FOLDER / source)
    noise = _NOISE[settings.load] if settings.noise is None else settings.noise
    parameters = WorldParameters(
        line=LineParameters(
            frequency_Hz=configuration.drive.line_frequency_Hz, drift_Hz=_LINE_DRIFT_Hz
        ),
        boost=BoostParameters(
            capacitance_F=configuration.drive.boost_capacitance_F,
            bidirectional=configuration.drive.kind == "bidirectional",
        ),
        noise=NoiseParameters(sigma=noise),
        seed=settings.seed,
    )
    return _STORIES[settings.load](configuration, parameters, settings.mode)


async def _perform(settings: VirtualSettings, story: Story, *, headless: bool) -> None:
    """Play until the time is over, the story ends, or a signal asks for the end."""
    asked = end_on_signals()
    async with asyncio.TaskGroup() as tasks:
        roles = [tasks.create_task(_pace(settings, story, asked, stay=not headless))]
        if not headless:
            roles.append(tasks.create_task(_show(settings, story)))
        await asked.wait()
        for role in roles:
            role.cancel()


async def _pace(
    settings: VirtualSettings, story: Story, asked: asyncio.Event, *, stay: bool
) -> None:
    """Let virtual time pass; a machine that is too slow for the speed does what it can."""
    teller = Teller(story)
    last_s, due_s = time.monotonic(), 0.0
    end_s = math.inf if settings.duration_s is None else settings.duration_s
    while not _over(story, teller, end_s, stay=stay):
        now_s = time.monotonic()
        due_s = min(due_s + (now_s - last_s) * settings.speed, teller.time_s + settings.speed)
        last_s = now_s
        slice_ends_s = now_s + _SLICE_s
        while teller.time_s < min(due_s, end_s) and time.monotonic() < slice_ends_s:
            if story.ended() or _tripped(story):
                break
            teller.tick()
        await asyncio.sleep(_BREAK_s if teller.time_s >= due_s or story.ended() else 0.0)
    asked.set()


def _over(story: Story, teller: Teller, end_s: float, *, stay: bool) -> bool:
    """Keep the last view on the screen until the user ends the demonstration."""
    return teller.time_s >= end_s or (not stay and (story.ended() or _tripped(story)))


def _tripped(story: Story) -> bool:
    return story.play.drive.machine.trip is not None


class Teller:
    """Lets the scenes of a story come in their time."""

    def __init__(self, story: Story) -> None:
        """Enable the drive."""
        self._story = story
        self._play = story.play
        self._scenes = story.scenes()
        self._next: Scene | None = next(self._scenes)
        self._began_s: float | None = None
        self._play.tick()
        self._play.ask(Enable())

    @property
    def time_s(self) -> float:
        """Seconds of control."""
        return 0.0 if self._began_s is None else self._play.drive.time_s - self._began_s

    def tick(self) -> None:
        """Run one half line cycle, and what has become due."""
        if self._began_s is None and self._play.record.running:
            self._began_s = self._play.drive.time_s
            self._play.report()
        if self._began_s is not None:
            self._turn()
        if self._play.tick():
            self._story.watch()

    def _turn(self) -> None:
        scene = self._next
        if scene is None or self.time_s < scene.time_s or not self._play.record.running:
            return
        self._next = next(self._scenes, None)
        self._play.record.caption = scene.caption
        scene.do()


async def _show(settings: VirtualSettings, story: Story) -> None:
    foot = (
        f"virtual time, {settings.speed:g} times real time: no bus, no broker   Ctrl-C ends",
        f"the controller and settings of {_FILES[story.name]}.toml, against a simulated load",
    )
    around = ViewContext(
        bus="",
        broker="",
        program="",
        duration_s=settings.duration_s,
        longest_window_s=story.window_s,
        subject=Subject(story.name, f"{story.title}, virtual time", story.figures, foot),
    )
    console = Console()
    with Live(console=console, screen=True, auto_refresh=False) as live, suppress(BrokenPipeError):
        while True:
            size = console.size
            picture = screen(story.play.record, around, (size.width, size.height))
            live.update(picture, refresh=True)
            await asyncio.sleep(_REFRESH_s)


def summarise(story: Story, speed: float) -> dict[str, Any]:
    """Everything worth knowing at the end, as one object for JSON."""
    record, drive = story.play.record, story.play.drive
    problems = list(_problems(story))
    control = record.control
    return {
        "demo": story.name,
        "ok": not problems,
        "reason": "; ".join(problems),
        "virtual_time": True,
        "speed": speed,
        "state": str(drive.machine.state),
        "mode": str(drive.machine.mode),
        "controller": str(drive.decision.controller) if drive.decision else None,
        "controller_reason": drive.decision.reason if drive.decision else "",
        "duration_s": round(control.time_s, 3) if control else 0.0,
        "ticks": control.ticks if control else 0,
        "slow_periods": record.slow_periods,
        "trips": record.trips,
        "estimates": _estimates(story),
        **story.summary(),
    }


def _estimates(story: Story) -> dict[str, float | None]:
    decision = story.play.drive.decision
    found = decision.estimates if decision else {}
    return {n: e.value if math.isfinite(e.value) else None for n, e in found.items()}


def _problems(story: Story) -> Iterator[str]:
    if story.play.drive.machine.trip is not None:
        yield f"the drive tripped: {story.play.drive.machine.trip}"
    yield from story.problems()


def _lines(found: dict[str, Any]) -> Iterator[str]:
    verdict = "control worked" if found["ok"] else "control failed"
    yield f"{found['demo']} demo: {verdict} for {found['duration_s']:.0f} s of virtual time"
    for name in (
        "state",
        "overshoot",
        "complete",
        "charge",
        "terminal_voltage_max_V",
        "returned_J",
    ):
        if name in found:
            yield f"  {name.replace('_', ' '):<24} {found[name]}"
