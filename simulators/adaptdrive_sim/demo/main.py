"""`adaptdrive-sim demo`: plays one story, shows it, and prints its figures."""

import asyncio
import math
import os
import shutil
import sys
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from textwrap import wrap
from typing import Any

import msgspec
from rich.console import Console, Group
from rich.layout import Layout
from rich.table import Table
from rich.text import Text

from adaptdrive.tui import Show, run_view, terminal
from adaptdrive.tui.record import CONTROLLERS, plot
from adaptdrive.tui.view import DIM, ViewExtras, figure, flow, rows, screen
from adaptdrive.tui.view import KEYS as DRIVE_KEYS
from adaptdrive.util.errors import RefusedError
from adaptdrive_sim.demo.player import DemoError, Player
from adaptdrive_sim.demo.stage import Stage
from adaptdrive_sim.demo.story import DemoRecord, read_story

# The view of a demonstration: that of `adaptdrive watch`, with the story and its table.

KEYS = ("q end", "space pause", "d disk", "f fixed", "a adaptive", "s STOP", "? help")

_DEPLOYED = " bus     adaptdrive start FILE --simulate FILE has broker, daemon and panel"


def show(player: Player, size: tuple[int, int]) -> Layout:
    """Return the whole screen.

    Args:
        player: The story.
        size: Width and height of the terminal in characters.
    """
    record = player.stage.record
    drop = "d disk" if "disks" in record.truth else "d disturb"
    around = ViewExtras(
        keys=[drop if key == "d disk" else key for key in KEYS],
        lead=_lead(player, size[0]),
        tables=dict([story_table(record)]),
        longest_s=record.story.window_s,
        cover=_help(player.stage, size[0]) if player.help else None,
        plant=False,
    )
    return screen(record, size, around)


def _lead(player: Player, width: int) -> list[Text]:
    lines = wrap(player.say, max(20, width - 2))[:2]
    position = Text(f" {player.position}", "bold cyan")
    return [position, *(Text(f" {line}", "italic") for line in lines)]


def _help(stage: Stage, width: int) -> Text:
    """Return what else can be done."""
    digits = [f"{digit} {one.get('text')}" for digit, one in enumerate(stage.record.features, 1)]
    lines = [*flow(digits, width), *flow(DRIVE_KEYS[:-1], width)]
    lines += [f" time    {stage.speed:g} times real time, in one process", _DEPLOYED]
    return Text("\n".join(lines), DIM, no_wrap=True, overflow="ellipsis")


def story_table(record: DemoRecord) -> tuple[str, Table]:
    """Return the table of a story and its title: overshoots, or values of the truth."""
    known = record.story.overshoot
    if known is None:
        table = rows("l", "r")
        for one in record.story.values:
            value = record.values.get(one.name, float("nan"))
            table.add_row(one.name, f"{figure(value)} {one.unit}")
        return "truth", table
    table = rows("l", "r", "r")
    table.add_row("", *(Text(name, form.style) for name, form in CONTROLLERS.items()))
    for k, name in enumerate(known.names):
        found = (record.halves.overshoot(controller, k) for controller in CONTROLLERS)
        table.add_row(name, *("·" if one is None else f"{100.0 * one:.1f}" for one in found))
    return "overshoot of the last step, %", table


# `adaptdrive-sim demo`: plays one story, and prints its figures and what was seen in a picture.

_PICTURE = (100, 18)

Summary = dict[str, Any]

_SPEED_MAX = 1e6
"""Times real time: more than any machine reaches."""


def run_demo(name: str, duration_s: float | None, *, headless: bool, speed: float | None) -> int:
    """Play a story and print its summary.

    Args:
        name: Name of the story.
        duration_s: Seconds of the story; the whole story when None.
        headless: Show nothing; so it is without a terminal anyway.
        speed: Times real time; the story's own when None.

    Returns:
        0 when control worked, 1 when it failed.

    Raises:
        AdaptdriveError: It could not begin.
    """
    if duration_s is not None and not 1.0 <= duration_s < math.inf:
        raise RefusedError(f"--duration {duration_s:g} must be at least 1 second")
    if speed is not None and not 0.0 < speed <= _SPEED_MAX:
        raise RefusedError(f"--speed {speed:g} must lie above 0, and up to 1e6")
    seen = sys.stdout.isatty() and sys.stdin.isatty() and not headless
    if seen:
        terminal.refuse_dumb_terminal()
    player = Player(Stage(read_story(name), speed), duration_s)
    summary = asyncio.run(_play(player, partial(show, player) if seen else None))
    if seen:
        show_end(player.stage.record, summary)
    else:
        sys.stdout.write(msgspec.json.encode(summary).decode() + "\n")
    if not summary["ok"]:
        sys.stderr.write(f"adaptdrive-sim: {summary['reason']}\n")
    return 0 if summary["ok"] else 1


async def _play(player: Player, shown: Show | None) -> Summary:
    """Play a story to its end, and return its figures."""
    stage, problem = player.stage, ""
    try:
        with suppress(KeyboardInterrupt):
            await run_view(stage.record, stage.ask, [player.run()], shown, player.takes)
    except DemoError as failure:
        problem = str(failure)
    return summarise(player, problem)


def summarise(player: Player, failure: str) -> Summary:
    """Return everything worth knowing at the end, as one flat object for JSON.

    Args:
        player: The story.
        failure: What ended the demonstration early; empty when nothing did.
    """
    stage, record = player.stage, player.stage.record
    problems = [failure] if failure else list(_problems(record, player))
    return {
        "demo": record.story.name,
        "ok": not problems,
        "reason": "; ".join(problems),
        **{name: record.state.get(name) for name in ("state", "mode", "controller")},
        "story_s": round(player.at_s, 3),
        "duration_s": round(record.control_s, 3),
        **{name: int(count) for name, count in record.counts.items()},
        "slow_periods": record.slow_periods,
        "trips": record.trips,
        "complete": record.completed,
        "overshoot": _overshoots(record),
        "values": {name: round(value, 4) for name, value in record.values.items()},
        "estimates": record.load.get("estimates"),
        "truth": {name: record.truth.get(name) for name in record.load.get("estimates") or ()},
        "speed": stage.speed,
    }


def _problems(record: DemoRecord, player: Player) -> Iterator[str]:
    """Yield everything that makes the demonstration a failure, in one sentence each."""
    if not (record.control_s or record.running):
        yield "the drive never ran"
    elif not record.running and not record.completed and not player.paused:
        yield f"the drive is not running but in {record.state.get('state')}"
    for one in record.story.values:
        value = record.values.get(one.name, 0.0)
        if player.at_s >= one.from_s and not one.fits(value):
            yield f"{one.name} was {value:.4g} {one.unit}"
    if (known := record.story.overshoot) is not None:
        for name, share in _overshoots(record)["adaptive"].items():
            if share > known.adaptive_at_most and not record.trips:
                yield f"the adaptive controller overshot by {100.0 * share:.1f} % with {name}"


def _overshoots(record: DemoRecord) -> dict[str, dict[str, float]]:
    """Return overshoots as shares of a step, by controller and size of the load."""
    names = record.story.overshoot.names if record.story.overshoot else []
    return {
        controller: {
            name: round(found, 4)
            for k, name in enumerate(names)
            if (found := record.halves.overshoot(controller, k)) is not None
        }
        for controller in CONTROLLERS
    }


def show_end(record: DemoRecord, summary: Summary) -> None:
    """Print what was seen, the figures, and the line that shows it again."""
    points = list(record.points)
    console = Console(highlight=False)
    size = min(_PICTURE[0], console.width), _PICTURE[1]
    if points:
        since_s = points[-1].time_s - points[0].time_s
        title = Text(f"{record.story.about} ({record.output_name} in {record.unit})", "bold")
        picture = plot(points, list(record.marks), points[-1].time_s, max(since_s, 1.0), size)
        name, table = story_table(record)
        table.expand = False
        console.print(Group(title, picture, Text(f"\n{name}", "bold"), table, ""))
    sys.stdout.write("\n".join(_lines(summary)) + "\n")


def _lines(summary: Summary) -> Iterator[str]:
    verdict = "control worked" if summary["ok"] else "control failed"
    yield f"{summary['demo']}: {verdict} for {summary['duration_s']:.0f} s"
    counted = (f"{summary[name]} {name}" for name in ("ticks", "missed", "held"))
    yield f"  ticks      {', '.join(counted)}, {len(summary['trips'])} trips"
    yield f"  once more  {program('adaptdrive-sim')} demo {summary['demo']}"
    yield f"  next       {next_step()}"


def next_step() -> str:
    """Return what to type for a drive of one's own, where `adaptdrive` is not known, too."""
    activate = Path(sys.executable).with_name("activate")
    if shutil.which("adaptdrive") is None and activate.exists():
        return f". {_short(activate)}   # then adaptdrive is a command here: README.md goes on"
    return f"{program()} init motor --device siemens-v20 --name pump   # README.md goes on"


def program(name: str = "adaptdrive") -> str:
    """Return the command for a program: its name, or its path if the name is not found."""
    return name if shutil.which(name) else _short(Path(sys.executable).with_name(name))


def _short(path: Path) -> str:
    return os.path.relpath(path) if path.is_relative_to(Path.cwd()) else str(path)
