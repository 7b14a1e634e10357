"""The whole configuration of one drive."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from adaptdrive.config.bus import CanBus, Signals
from adaptdrive.config.drive import Drive, VoltageLoop
from adaptdrive.config.load import Bath, Battery, Estimator, Motor, Supervisor
from adaptdrive.config.section import Section
from adaptdrive.config.services import Interlocks, Mqtt, Realtime, Recording


class Configuration(Section):
    """One TOML file, one drive."""

    drive: Drive
    bus: CanBus
    signals: Signals
    voltage_loop: VoltageLoop = Field(default_factory=VoltageLoop)
    load: Motor | Bath | Battery = Field(discriminator="type")
    estimator: Estimator = Field(default_factory=Estimator)
    supervisor: Supervisor = Field(default_factory=Supervisor)
    interlocks: Interlocks
    mqtt: Mqtt = Field(default_factory=Mqtt)
    recording: Recording = Field(default_factory=Recording)
    realtime: Realtime = Field(default_factory=Realtime)

    @property
    def ticks_per_period(self) -> int:
        """Q: fast ticks in one slow period."""
        return round(2 * self.drive.line_frequency_Hz * self.load.period_s)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        _check_rates(self)
        _check_command_signals(self)
        _check_trip_levels(self)
        return self


def _check_rates(configuration: Configuration) -> None:
    load, ticks = configuration.load, configuration.ticks_per_period
    if load.samples > ticks:
        raise ValueError(f"load.samples = {load.samples} exceeds the {ticks} ticks of one period")
    if load.latency_ticks >= ticks:
        raise ValueError(
            f"load.latency_ticks = {load.latency_ticks} must be below the {ticks} ticks "
            "of one period"
        )


def _check_command_signals(configuration: Configuration) -> None:
    command = configuration.signals.command
    in_daemon = configuration.voltage_loop.where == "daemon"
    needed = "current_scale_S" if in_daemon else "boost_reference_V"
    for name in (needed, "bridge"):
        if getattr(command, name) is None:
            raise ValueError(
                f"signals.command.{name} is missing: voltage_loop.where = "
                f"{configuration.voltage_loop.where!r} needs it"
            )


def _check_trip_levels(configuration: Configuration) -> None:
    highest = configuration.drive.limits.boost_reference_max_V
    trip = configuration.interlocks.boost_voltage_max_V
    if trip <= highest:
        raise ValueError(
            f"interlocks.boost_voltage_max_V = {trip} must be above "
            f"drive.limits.boost_reference_max_V = {highest}"
        )
    if configuration.interlocks.output_max <= configuration.load.reference_max:
        raise ValueError(
            f"interlocks.output_max = {configuration.interlocks.output_max} must be above "
            f"load.reference_max = {configuration.load.reference_max}"
        )
