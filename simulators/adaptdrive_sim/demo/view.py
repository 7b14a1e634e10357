"""The view of a demonstration: that of `adaptdrive watch`, with the story and its table."""

from __future__ import annotations

import asyncio
import webbrowser
from textwrap import wrap

from rich.layout import Layout
from rich.table import Table
from rich.text import Text

from adaptdrive.tui.record import CONTROLLERS
from adaptdrive.tui.terminal import KeyCommand
from adaptdrive.tui.view import DIM, Surroundings, figure, flow, rows, screen
from adaptdrive.tui.view import KEYS as DRIVE_KEYS
from adaptdrive.util.clock import in_thread
from adaptdrive.util.errors import AdaptdriveError
from adaptdrive_sim.demo.player import Player
from adaptdrive_sim.demo.real import RealStage
from adaptdrive_sim.demo.record import DemoRecord
from adaptdrive_sim.demo.virtual import VirtualStage

KEYS = ("q end", "space pause", "d disk", "f fixed", "a adaptive", "p panel", "s STOP", "? help")


class DemoView:
    """Shows a record and its story, and heeds the keys of the story.

    Attributes:
        help: Whether the help is shown.
    """

    def __init__(self, record: DemoRecord, player: Player, stage: RealStage | VirtualStage) -> None:
        """Prepare the view.

        Args:
            record: What was heard.
            player: The story.
            stage: Where it is played.
        """
        self.help = False
        self._record, self._player, self._stage = record, player, stage
        self._opening: asyncio.Task[None] | None = None

    def takes(self, key: str) -> KeyCommand | bool:
        """Heed a key of the story; return its disturbance, or whether it was such a key."""
        match key:
            case " ":
                self._player.toggle()
            case "?":
                self.help = not self.help
            case "p":
                self._opening = asyncio.create_task(self._open_panel())
            case "d":
                return self._player.dropped() or True
            case "s" | "S":
                self._player.hold("The drive was stopped.")
                return False
        return key in " ?p"

    def screen(self, size: tuple[int, int]) -> Layout:
        """Return the whole screen for a terminal of some width and height."""
        drop = "d disk" if "disks" in self._record.truth else "d disturb"
        around = Surroundings(
            keys=[drop if key == "d disk" else key for key in KEYS],
            lead=self._lead(size[0]),
            tables=dict([story_table(self._record)]),
            longest_s=self._record.story.window_s,
            cover=self._help(size[0]) if self.help else None,
            plant=False,
        )
        return screen(self._record, size, around)

    def _lead(self, width: int) -> list[Text]:
        said = wrap(self._player.say, max(20, width - 2))[:2]
        return [
            Text(f" {self._player.position}", "bold cyan"),
            *(Text(f" {line}", "italic") for line in said),
        ]

    def _help(self, width: int) -> Text:
        """Return what else can be done, here and from another terminal."""
        offered = self._record.features
        digits = [f"{digit} {one.get('text')}" for digit, one in enumerate(offered, 1)]
        lines = [*flow(digits, width), *flow(DRIVE_KEYS[:-1], width)]
        lines += [f" {name:<7} {place}" for name, place in self._stage.places.items()]
        return Text("\n".join(lines), DIM, no_wrap=True, overflow="ellipsis")

    async def _open_panel(self) -> None:
        self._record.answer = "panel: starting…"
        try:
            address = await self._stage.panel()
        except AdaptdriveError as problem:
            self._record.answer = f"panel: {problem}"
        else:
            self._record.answer = f"panel: {address}"
            in_thread(lambda: webbrowser.open(address), "adaptdrive-browser")


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
    return "overshoot, %", table
