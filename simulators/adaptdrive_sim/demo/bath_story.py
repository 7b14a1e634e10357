"""The bath's story: a square wave, a drain that is raised over five minutes, two controllers."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from typing import Any, ClassVar

from rich.table import Table
from rich.text import Text

from adaptdrive.config.root import Configuration
from adaptdrive.control.signals import Mode
from adaptdrive.control.waveform import Shape, Waveform
from adaptdrive.runtime.requests import SetMode, SetWaveform
from adaptdrive.watch.plot import CONTROLLER_STYLES
from adaptdrive.watch.tables import overshoot, rows
from adaptdrive_sim.demo.settings import ModeChoice
from adaptdrive_sim.demo.story import Scene, Story
from adaptdrive_sim.demo.subject import Figures
from adaptdrive_sim.plants.bath import Bath, BathParameters
from adaptdrive_sim.world import World, WorldParameters

LOW_K, HIGH_K = 10.0, 13.0
CYCLE_s = 2400.0
SMALL_gal, LARGE_gal = 0.6, 1.5
FILLING_s = 300.0
OVERSHOOT_MAX = 0.05

_ROUND_s = 6 * CYCLE_s
_SIZES = {1: f"{SMALL_gal:g} gal", 2: f"{LARGE_gal:g} gal", 3: "between"}


class BathStory(Story):
    """See `Story`."""

    name = "bath"
    title = "temperature in kelvin above the inflow"
    window_s = 2.0 * CYCLE_s
    words = "temperature", "reference", "K"
    symbols: ClassVar = {"resistance_K_per_W": "R", "tau_s": "RC"}

    def __init__(
        self, configuration: Configuration, parameters: WorldParameters, mode: ModeChoice
    ) -> None:
        self._mode = mode
        self.bath = Bath(BathParameters(volume_gal=SMALL_gal))
        world = World(self.bath, parameters)
        world.settle(world.boost_voltage_for(LOW_K))
        super().__init__(configuration, world)

    def scenes(self) -> Iterator[Scene]:
        """A round of six cycles, for ever; with one controller only the volume changes."""
        yield Scene(0.0, self._caption("The wave begins, with 0.6 gal in the bath."), self._begin)
        start_s = 0.0
        while True:
            for time_s, caption, do in self._round():
                yield Scene(start_s + time_s, self._caption(caption), do)
            start_s += _ROUND_s

    def _round(self) -> Iterator[tuple[float, str, functools.partial[None]]]:
        fill, mode = functools.partial, functools.partial
        rise, sink = fill(self._fill, LARGE_gal), fill(self._fill, SMALL_gal)
        last_s = 0.5 * CYCLE_s - FILLING_s - 60.0
        yield 0.5 * CYCLE_s + last_s, "The drain goes up: 1.5 gal, and the same fixed gains.", rise
        yield 2 * CYCLE_s - 60.0, "Adaptive from here: it has learned the load.", mode(self._ask, 1)
        yield 3 * CYCLE_s, "The drain goes down again, the adaptive controller in force.", sink
        yield 4 * CYCLE_s, "And up, still adaptive. Compare the overshoots.", rise
        yield 5 * CYCLE_s, "Down once more, back to where the story begins.", sink
        yield (
            _ROUND_s - 60.0,
            "The fixed controller again: it was made for 0.6 gal.",
            mode(self._ask, 0),
        )

    def _caption(self, caption: str) -> str:
        return caption if self._mode == "alternate" else f"The bath holds a wave. {_PLAIN}"

    def _begin(self) -> None:
        self.play.ask(SetWaveform(Waveform(Shape.SQUARE, LOW_K, HIGH_K, CYCLE_s)))
        if self._mode == "adaptive":
            self.play.ask(SetMode(Mode.ADAPTIVE))

    def _fill(self, volume_gal: float) -> None:
        self.bath.fill(volume_gal, FILLING_s)
        self.play.record.mark(f"to {volume_gal:g} gal")
        self.play.event("bath", f"the drain moves: {volume_gal:g} gal in {FILLING_s:g} s")

    def _ask(self, adaptive: int) -> None:
        if self._mode == "alternate":
            self.play.ask(SetMode(Mode.ADAPTIVE if adaptive else Mode.FIXED))

    def watch(self) -> None:
        """Keep the volume as a number of its own for the overshoots."""
        self.play.record.size = _size(self.bath.volume_gal)

    @property
    def figures(self) -> Figures:
        """Drive, estimates and overshoots."""
        return lambda: {
            "drive": self.drive_table(
                ("heater", f"{self.bath.heater_W:.0f} W"),
                ("volume", f"{self.bath.volume_gal:.2f} gal"),
            ),
            "R in K/W, RC in s": self.estimates_table(),
            "overshoot": self._overshoots(),
        }

    def _overshoots(self) -> Table:
        table = rows("l", "r", "r")
        fixed, adaptive = (Text(name, style) for name, style in CONTROLLER_STYLES.items())
        table.add_row("gal", fixed, adaptive, style="bold")
        for size in (1, 2):
            found = (self.play.record.halves.overshoot(one, size) for one in CONTROLLER_STYLES)
            table.add_row(_SIZES[size].removesuffix(" gal"), *map(overshoot, found))
        return table

    def summary(self) -> dict[str, Any]:
        """Volume, overshoots, estimates and the truth."""
        halves = self.play.record.halves
        return {
            "volume_gal": round(self.bath.volume_gal, 3),
            "overshoot": {
                controller: {
                    _SIZES[size]: round(found, 4)
                    for size in (1, 2)
                    if (found := halves.overshoot(controller, size)) is not None
                }
                for controller in CONTROLLER_STYLES
            },
            "truth": self.truth(),
        }

    def problems(self) -> Iterator[str]:
        """An adaptive controller that overshoots."""
        for size in (1, 2):
            found = self.play.record.halves.overshoot("adaptive", size)
            if found is not None and found > OVERSHOOT_MAX:
                yield f"adaptive overshoot of {100.0 * found:.1f} % with {_SIZES[size]}"


_PLAIN = "The drain moves between 0.6 and 1.5 gal."


def _size(volume_gal: float) -> int:
    """1 for the small bath, 2 for the large one, 3 in between."""
    if abs(volume_gal - SMALL_gal) < 1e-6:
        return 1
    return 2 if abs(volume_gal - LARGE_gal) < 1e-6 else 3
