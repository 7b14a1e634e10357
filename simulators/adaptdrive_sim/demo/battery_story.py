"""The battery's story: learn in a short wave, charge, taper at the voltage limit, end."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, ClassVar

from rich.table import Table

from adaptdrive.config.load import BatterySection
from adaptdrive.config.root import Configuration
from adaptdrive.control.signals import Mode
from adaptdrive.control.waveform import Shape, Waveform
from adaptdrive.runtime.requests import SetMode, SetSetpoint, SetWaveform
from adaptdrive.watch.tables import rows
from adaptdrive_sim.demo.settings import DemoError, ModeChoice
from adaptdrive_sim.demo.story import Scene, Story
from adaptdrive_sim.demo.subject import Figures
from adaptdrive_sim.plants.battery import Battery, BatteryParameters
from adaptdrive_sim.world import World, WorldParameters

CURRENT_A = 12.0
LEARN_LOW_A, LEARN_HIGH_A, LEARN_PERIOD_s = 8.0, 12.0, 60.0
LEARN_FROM_s, CHARGE_FROM_s = 60.0, 420.0
CHARGE_AT_START = 0.15
VOLTAGE_MARGIN = 1.005


class BatteryStory(Story):
    """See `Story`."""

    name = "battery"
    title = "current into the battery in ampere"
    window_s = 5400.0
    words = "current", "set-point", "A"
    symbols: ClassVar = {"direct_S": "Y(0)", "gain_S": "Y(∞)", "tau_s": "τ"}

    def __init__(
        self, configuration: Configuration, parameters: WorldParameters, mode: ModeChoice
    ) -> None:
        section = configuration.load
        if not isinstance(section, BatterySection):
            raise DemoError(f"load {section.type} is no battery")
        self._limits = section.charge
        self._mode = mode
        self.battery = Battery(BatteryParameters(charge=CHARGE_AT_START))
        super().__init__(configuration, World(self.battery, parameters))
        self.voltage_max_V = 0.0

    def scenes(self) -> Iterator[Scene]:
        """From nearly empty to full."""
        yield Scene(0.0, "The fixed controller brings the current up.", self._begin)
        caption = "A wave of the current, for the estimator to learn the battery from."
        yield Scene(LEARN_FROM_s, caption, self._learn)
        caption = "Constant current; at the voltage limit it will taper until the battery is full."
        yield Scene(CHARGE_FROM_s, caption, self._charge)

    def _begin(self) -> None:
        if self._mode == "adaptive":
            self.play.ask(SetMode(Mode.ADAPTIVE))
        self.play.ask(SetSetpoint(CURRENT_A))

    def _learn(self) -> None:
        wave = Waveform(Shape.SQUARE, LEARN_LOW_A, LEARN_HIGH_A, LEARN_PERIOD_s)
        self.play.ask(SetWaveform(wave))
        self.play.record.mark("learn")
        if self._mode != "fixed":
            self.play.ask(SetMode(Mode.ADAPTIVE))

    def _charge(self) -> None:
        self.play.ask(SetSetpoint(CURRENT_A))
        self.play.record.mark("charge")

    def watch(self) -> None:
        """Keep the highest terminal voltage, and report when the battery is full."""
        self.voltage_max_V = max(self.voltage_max_V, self.battery.terminal_voltage_V)
        if self.play.drive.completed:
            self.play.record.caption = "The battery is full: the drive went to standby by itself."

    @property
    def phase(self) -> str:
        """Phase of the charge: constant current, constant voltage, or its end."""
        if self.play.drive.completed:
            return "complete"
        if not self.play.record.running:
            return "off"
        limit_V = self._limits.voltage_max_V
        tapers = self.battery.output < 0.98 * self.play.drive.reference
        near = self.battery.terminal_voltage_V > 0.995 * limit_V
        return "CV" if tapers and near else "CC"

    @property
    def figures(self) -> Figures:
        """Drive, estimates and charge."""
        return lambda: {
            "drive": self.drive_table(("power", f"{self.play.drive.sample.load_power_W:.0f} W")),
            "admittance Y in S, τ in s": self.estimates_table(),
            "charge": self._charge_table(),
        }

    def _charge_table(self) -> Table:
        table, battery = rows("l", "r"), self.battery
        table.add_row("phase", self.phase)
        table.add_row("charge", f"{100.0 * battery.charge:.1f} %")
        table.add_row("voltage", f"{battery.terminal_voltage_V:.2f} V")
        table.add_row("limit", f"{self._limits.voltage_max_V:.2f} V")
        table.add_row("ends at", f"{self._limits.end_current_A:g} A")
        return table

    def summary(self) -> dict[str, Any]:
        """Charge, voltages, and the truth."""
        return {
            "complete": self.play.drive.completed,
            "charge": round(self.battery.charge, 4),
            "terminal_voltage_max_V": round(self.voltage_max_V, 3),
            "voltage_limit_V": self._limits.voltage_max_V,
            "truth": self.truth(),
        }

    def problems(self) -> Iterator[str]:
        """A terminal voltage beyond its limit."""
        if self.voltage_max_V > VOLTAGE_MARGIN * self._limits.voltage_max_V:
            yield f"terminal voltage of {self.voltage_max_V:.2f} V"
