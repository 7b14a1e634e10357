"""One course of a drive in virtual time: the daemon by hand, a simulated drive, and one fault.

Daemon and plant disagree: each gain and each lag of the nominal model is wrong by up to 1.3.
"""

from __future__ import annotations

import math
import random
import tomllib
from collections import deque
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

from adaptdrive.config import load_configuration
from adaptdrive.config.file import validate_configuration
from adaptdrive.control.signals import Command
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import Enable, Reset, SetSetpoint
from adaptdrive.safety.facts import Reading
from adaptdrive_sim.device import DeviceSettings, build_drive
from adaptdrive_sim.devices.drive import Frame
from tests.integration.faults.by_hand import DaemonByHand

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"
FILES = {
    "motor, CAN": "motor.toml",
    "motor, Modbus": "motor-modbus-tcp.toml",
    "bath, CAN": "bath.toml",
    "bath, Modbus": "bath-modbus-tcp.toml",
    "battery, CAN": "battery.toml",
}
WRONG = {
    "motor": ("gain", "tau_motor_s", "tau_filter_s"),
    "bath": ("resistance_K_per_W", "tau_s"),
    "battery": ("internal_Ohm", "relaxation_Ohm", "relaxation_s"),
}
SETTLE_s = {"motor": 15.0, "bath": 60.0, "battery": 15.0}
AFTER_s = {"motor": 70.0, "bath": 200.0, "battery": 30.0}
"""How long a fault is watched that no bound covers."""

ATTEMPTS = 5
DISCHARGED_V = 300.0
"""Voltage to which an operator discharges a fuller capacitor: it has no resistor across it."""

Sensor = Callable[[float, float], float]


def example_path(name: str) -> Path:
    """Return the file of an example."""
    return EXAMPLES / FILES[name]


def example(name: str) -> dict[str, Any]:
    """Return the tables of an example."""
    return tomllib.loads(example_path(name).read_text())


def honest(_: float, output: float) -> float:
    """What a healthy sensor reads of an output."""
    return output


class Course:
    """A drive under control, and the places where a fault can be put in.

    Attributes:
        load: `motor`, `bath` or `battery`.
        drive: The simulated drive and its plant.
        sensor: What is measured of the output, by the time since the fault.
        lags: Readings by which the output comes late.
        actuator: What the drive makes of a command; None where it hears none.
        frame: What becomes of each frame; None where it is lost.
        highest: The highest output that the plant has had, noise left out.
    """

    def __init__(self, name: str, seed: int, tables: dict[str, Any] | None = None) -> None:
        """Put a load that turns, is warm or is half charged behind a daemon.

        Args:
            name: One of `FILES`.
            seed: Of the errors of the model, the noise and the set-points.
            tables: The daemon's configuration, None for that of the example.
        """
        self.draw = random.Random(f"{name} {seed}")
        path = example_path(name)
        truth = load_configuration(path)
        tables = example(name) if tables is None else deepcopy(tables)
        self.load = tables["load"]["type"]
        for key in WRONG[self.load]:
            tables["load"]["model"][key] *= 1.3 ** self.draw.uniform(-1.0, 1.0)
        self.configuration = validate_configuration(tables, path)
        span = truth.load.reference_max - truth.load.reference_min
        self.sigma = self.draw.choice([0.0, 0.002, 0.01]) * span
        self.drive = build_drive(truth, DeviceSettings(), lambda *_, **__: None)
        self.daemon = DaemonByHand(self.configuration, self._hear, 1000.0)
        self.stride = self.configuration.bus.ticks_per_reading
        self.sensor: Sensor = honest
        self.lags = 0
        self.actuator: Callable[[Command], Command | None] = lambda command: command
        self.frame: Callable[[Reading], Reading | None] = lambda reading: reading
        self.decides = True
        self.fault_s = math.inf
        self.highest = self.highest_V = 0.0
        self.commands: deque[Command] = deque(maxlen=4)
        self._late: deque[float] = deque(maxlen=8)
        self._half_cycles = self.draw.randrange(65536)
        low, high = self.reach
        world = self.drive.world
        world.settle(max(world.boost_voltage_for(low + 0.4 * (high - low)), 201.0))
        world.shut()

    @property
    def reach(self) -> tuple[float, float]:
        """Ends of the set-points that are accepted."""
        load, reach = self.configuration.load, self.daemon.daemon._machine.reach
        if not reach.is_known:
            return load.reference_min, load.reference_max
        return max(load.reference_min, reach.low), min(load.reference_max, reach.high)

    @property
    def span(self) -> float:
        """Range of the set-points."""
        load = self.configuration.load
        return load.reference_max - load.reference_min

    @property
    def off(self) -> bool:
        """Whether the drive itself feeds nothing to the load."""
        return not self.drive.world.bridge and self.drive.world.load_current_A == 0.0

    def step_setpoint(self) -> None:
        """Ask for another set-point, at least a quarter of the reach away."""
        low, high = self.reach
        setpoint = self.daemon.daemon._machine.asked.setpoint
        up = setpoint < 0.5 * (low + high)
        share = self.draw.uniform(0.65, 0.9) if up else self.draw.uniform(0.1, 0.35)
        self.daemon.accepts(SetSetpoint(low + share * (high - low)))

    def begin(self) -> bool:
        """Enable the drive and let it settle; False when it trips before any fault."""
        self.run(0.7 if self.stride == 1 else 3.0)
        low, high = self.reach
        if not self.daemon.accepts(Enable()) or low >= high:
            return False
        self.run(3.0)
        self.daemon.accepts(SetSetpoint(low + 0.4 * (high - low)))
        self.run(SETTLE_s[self.load])
        return self.daemon.state is State.RUNNING

    def recovers(self) -> int:
        """Reset and enable the drive until it runs; how often it was enabled, 0 for in vain."""
        self.discharge()
        for attempt in range(1, ATTEMPTS + 1):
            end_s = self.daemon.now + 10.0
            while self.daemon.now < end_s and not self._is_reset():
                self.run(0.5)
            self.daemon.accepts(Enable())
            self.run(3.0)
            if self.daemon.state is State.RUNNING:
                return attempt
        return 0

    def discharge(self) -> None:
        """Do what an operator does who finds the boost capacitor too full to reset the drive."""
        boost = self.drive.world.boost
        boost.settle(min(boost.voltage_V, DISCHARGED_V), 0.0)

    def _is_reset(self) -> bool:
        return self.daemon.accepts(Reset()) and self.daemon.state is State.STANDBY

    def run(self, seconds: float, *, until_trip: bool = False) -> None:
        """Let time pass."""
        end_s = self.daemon.now + seconds
        while self.daemon.now < end_s:
            self.half_cycle()
            if until_trip and self.daemon.state is State.TRIPPED:
                return

    def half_cycle(self) -> None:
        """Let the drive live for half a line cycle, and the daemon hear of it."""
        now_s = self.daemon.now + self.drive.world.line.half_cycle_s
        frame = self.drive.tick(now_s)
        self._half_cycles += 1
        self.highest = max(self.highest, self.drive.world.true_output)
        self.highest_V = max(self.highest_V, frame.sample.boost_voltage_V)
        self.daemon.wait(now_s)
        if self._half_cycles % self.stride == 0:
            reading = self.frame(self._reading(frame, now_s))
            if reading is not None:
                self.daemon.port.deliver(reading)
        if self.decides:
            self.daemon.decide()

    def _reading(self, frame: Frame, now_s: float) -> Reading:
        sample, age_s = frame.sample, now_s - self.fault_s
        output = self.sensor(age_s, sample.output) if age_s >= 0.0 else sample.output
        self._late.append(output + self.draw.gauss(0.0, self.sigma) if self.sigma else output)
        lags = min(self.lags if age_s >= 0.0 else 0, len(self._late) - 1)
        return Reading(
            arrival_s=now_s,
            oldest_s=now_s,
            counter=self._half_cycles % 65536,
            boost_voltage_V=sample.boost_voltage_V,
            line_voltage_V=sample.line_voltage_V,
            load_power_W=sample.load_power_W,
            output=self._late[-1 - lags],
            fault=frame.fault,
            bridge=frame.bridge,
        )

    def _hear(self, command: Command) -> None:
        self.commands.append(command)
        taken = self.actuator(command)
        if taken is None:
            return
        holds = self.drive.holds_voltage
        value = taken.boost_reference_V if holds else taken.current_scale_S
        self.drive.command(value, taken.bridge, self.daemon.now)


def weaker(share: float) -> Callable[[Command], Command]:
    """A drive that gives a share of the line current, or of V_c, that is commanded."""
    return lambda command: replace(
        command,
        current_scale_S=share * command.current_scale_S,
        boost_reference_V=share * command.boost_reference_V,
    )
