"""Parts of a demonstration in virtual time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

from rich.table import Table

from adaptdrive.config.root import Configuration
from adaptdrive.watch.tables import figure, number, percent, rows
from adaptdrive_sim.demo.heard import known
from adaptdrive_sim.demo.play import Play
from adaptdrive_sim.demo.subject import Figures
from adaptdrive_sim.world import World


@dataclass(frozen=True, slots=True)
class Scene:
    """One turn of a story.

    Attributes:
        time_s: When it comes, since the drive was enabled.
        caption: What to look at, in words.
        do: What is done to drive or load.
    """

    time_s: float
    caption: str
    do: Callable[[], None]


class Story:
    """A load, what happens to it, and how to describe it.

    Attributes:
        name: Name of the demonstration.
        title: What the plot shows.
        window_s: Longest time that the plot shows.
        words: What the output and its set-point are called, and their unit.
        symbols: Short names of the estimates.
        play: The drive.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    window_s: ClassVar[float]
    words: ClassVar[tuple[str, str, str]]
    symbols: ClassVar[dict[str, str]]

    def __init__(self, configuration: Configuration, world: World) -> None:
        """Put the daemon's controller in front of a load."""
        self.play = Play(configuration, world)

    def scenes(self) -> Iterator[Scene]:
        """Return the scenes in the order of time; the first is the beginning."""
        raise NotImplementedError

    def watch(self) -> None:
        """Look at the load, once in every slow period."""
        raise NotImplementedError

    @property
    def figures(self) -> Figures:
        """Tables for the live view."""
        raise NotImplementedError

    def ended(self) -> bool:
        """Return whether there is nothing more to see."""
        return self.play.drive.completed

    def summary(self) -> dict[str, Any]:
        """Return the summary for the end, apart from the part that all demonstrations have."""
        raise NotImplementedError

    def problems(self) -> Iterator[str]:
        """Return the problems that occurred."""
        raise NotImplementedError

    def truth(self) -> dict[str, float]:
        """The load's parameters by formula, by the names of its estimates."""
        model = self.play.drive.world.true_model
        return {name: model[name] for name in self.symbols}

    def drive_table(self, *more: tuple[str, str]) -> Table:
        """Output, set-point and boost voltage, and what the load adds."""
        table, sample, load = rows("l", "r"), self.play.drive.sample, self.play.record.load
        output, reference, unit = self.words
        table.add_row(output, f"{number(sample.output, 2)} {unit}")
        table.add_row(reference, f"{number(load.reference if load else math.nan, 2)} {unit}")
        asked = load.boost_reference_V if load else math.nan
        table.add_row("V_c / v_bst", f"{number(asked, 0)} / {sample.boost_voltage_V:.0f} V")
        for row in more:
            table.add_row(*row)
        return table

    def estimates_table(self) -> Table:
        """Each estimate beside the truth."""
        table, load = rows("l", "r", "r", "r"), self.play.record.load
        table.add_row("", "learned", "truth", "error", style="bold")
        truth, estimates = self.truth(), load.estimates if load else {}
        for name, symbol in self.symbols.items():
            value = known(estimates[name].value) if name in estimates else math.nan
            error = percent(value / truth[name] - 1.0)
            table.add_row(symbol, figure(value), figure(truth[name]), error)
        return table
