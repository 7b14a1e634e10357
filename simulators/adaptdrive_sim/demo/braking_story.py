"""The story of a bidirectional drive: a shaft is braked, and its energy returns to the line."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, ClassVar

from rich.table import Table

from adaptdrive.config.root import Configuration
from adaptdrive.control.signals import Mode
from adaptdrive.control.waveform import Shape, Waveform
from adaptdrive.runtime.requests import SetMode, SetWaveform
from adaptdrive.watch.tables import rows
from adaptdrive_sim.demo.settings import ModeChoice
from adaptdrive_sim.demo.story import Scene, Story
from adaptdrive_sim.demo.subject import Figures
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from adaptdrive_sim.world import World, WorldParameters

LOW_V, HIGH_V, PERIOD_s = 2.6, 4.2, 120.0
MARK_s = 0.5 * PERIOD_s


class BrakingStory(Story):
    """See `Story`."""

    name = "braking"
    title = "speed in tachometer volts"
    window_s = 3.0 * PERIOD_s
    words = "speed", "reference", "V"
    symbols: ClassVar = {"gain": "g"}

    def __init__(
        self, configuration: Configuration, parameters: WorldParameters, mode: ModeChoice
    ) -> None:
        self._mode = mode
        self._period_s = configuration.load.period_s
        self.motor = Motor(MotorParameters())
        world = World(self.motor, parameters)
        world.settle(world.boost_voltage_for(LOW_V))
        super().__init__(configuration, world)
        self.returned_J = self.lowest_load_W = self.lowest_scale_S = self.highest_V = 0.0

    def scenes(self) -> Iterator[Scene]:
        """A wave whose steps downwards are larger than friction can follow."""
        yield Scene(0.0, "The shaft is brought up to 4.2 V of the tachometer.", self._begin)
        caption = "Braked: the motor feeds the capacitor, and the boost stage feeds the line."
        yield Scene(MARK_s, caption, lambda: self.play.record.mark("brake"))

    def _begin(self) -> None:
        self.play.ask(SetWaveform(Waveform(Shape.SQUARE, LOW_V, HIGH_V, PERIOD_s)))
        if self._mode != "fixed":
            self.play.ask(SetMode(Mode.ADAPTIVE))

    def watch(self) -> None:
        """Add up the energy that returns to the line; called at the end of each slow period."""
        world = self.play.drive.world
        self.returned_J += max(0.0, -world.boost.mean_line_W) * self._period_s
        self.lowest_load_W = min(self.lowest_load_W, world.boost.mean_load_W)
        self.lowest_scale_S = min(self.lowest_scale_S, world.current_scale_S)
        self.highest_V = max(self.highest_V, world.boost.voltage_V)

    @property
    def figures(self) -> Figures:
        """Drive, estimates and the energy."""
        return lambda: {
            "drive": self.drive_table(("power", f"{self.play.drive.sample.load_power_W:.0f} W")),
            "gain in V/V": self.estimates_table(),
            "braking": self._braking_table(),
        }

    def _braking_table(self) -> Table:
        table = rows("l", "r")
        table.add_row("returned", f"{self.returned_J:.0f} J")
        table.add_row("lowest power", f"{self.lowest_load_W:.0f} W")
        table.add_row("highest v_bst", f"{self.highest_V:.0f} V")
        return table

    def summary(self) -> dict[str, Any]:
        """Energy, power and voltage while braking."""
        return {
            "returned_J": round(self.returned_J, 1),
            "lowest_load_W": round(self.lowest_load_W, 1),
            "lowest_scale_S": round(self.lowest_scale_S, 5),
            "highest_boost_V": round(self.highest_V, 1),
            "truth": self.truth(),
        }

    def problems(self) -> Iterator[str]:
        """No energy in spite of a step downwards."""
        control = self.play.record.control
        if control and control.time_s > MARK_s + 10.0 and not self.returned_J > 0.0:
            yield "no energy returned to the line"
