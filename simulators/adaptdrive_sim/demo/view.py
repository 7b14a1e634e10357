"""The view of a demonstration: that of `adaptdrive watch`, with the story and its table."""

from __future__ import annotations

from textwrap import wrap

from rich.layout import Layout
from rich.table import Table
from rich.text import Text

from adaptdrive.watch.plot import CONTROLLERS
from adaptdrive.watch.tables import DIM, figure, flow, rows
from adaptdrive.watch.view import KEYS as DRIVE_KEYS
from adaptdrive.watch.view import Surroundings, screen
from adaptdrive_sim.demo.player import Player
from adaptdrive_sim.demo.record import DemoRecord

KEYS = ("q end", "space pause", "d disk", "f fixed", "a adaptive", "p panel", "s STOP", "? help")


class DemoView:
    """Shows a record and its story.

    Attributes:
        help: Whether the help is shown.
    """

    def __init__(self, record: DemoRecord, player: Player, places: dict[str, str]) -> None:
        """Prepare the view.

        Args:
            record: What was heard.
            player: The story.
            places: Folder and addresses for the help, by name.
        """
        self.help = False
        self._record, self._player, self._places = record, player, places

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
        lines += [f" {name:<7} {place}" for name, place in self._places.items()]
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
    return "overshoot, %", table
