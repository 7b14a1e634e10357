"""A configured drive in virtual time, and what happens to loads outside an experiment."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from adaptdrive.config.file import validate_configuration
from adaptdrive.control.loads.discretise import held_model
from adaptdrive.control.signals import Mode, Shape, Waveform
from adaptdrive.runtime.requests import SetSetpoint, SetWaveform
from adaptdrive_sim.parameters import EXAMPLES, example_tables
from adaptdrive_sim.plants.boost import Sample
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from adaptdrive_sim.site import OperatedDrive
from adaptdrive_sim.world import NoiseParameters, SimulatedLoad, World

LOW, HIGH, CYCLE_S = 3.0, 3.2, 120.0
STEP = HIGH - LOW
TORQUE_20_V_NM = 20.0 * 0.25 * 0.30 / 4.0
"""The torque that takes 20 V of the input: 20 V times N2 K / (R_d + R_f)."""

Event = Callable[[Motor, float], None]


class Sensed(World):
    """A plant behind a sensor with a resolution, such as a 10-bit converter."""

    quantum = 0.0

    def step(
        self, current_scale_S: float, bridge: bool, disturbance: float | None = None
    ) -> Sample:
        sample = super().step(current_scale_S, bridge, disturbance)
        if not self.quantum:
            return sample
        return sample._replace(output=round(sample.output / self.quantum) * self.quantum)


@dataclass
class Rows:
    """One row for each slow period."""

    time_s: list[float] = field(default_factory=list)
    reference: list[float] = field(default_factory=list)
    output: list[float] = field(default_factory=list)
    voltage_V: list[float] = field(default_factory=list)
    adaptive: list[bool] = field(default_factory=list)
    reasons: list[str] = field(default_factory=list)
    estimates: list[dict[str, tuple[float, float]]] = field(default_factory=list)

    def append(self, drive: OperatedDrive, began_s: float) -> None:
        """Add what the last slow period brought."""
        decision = drive.decision
        assert decision is not None
        self.time_s.append(drive.time_s - began_s)
        self.reference.append(drive.reference)
        self.output.append(drive.world.true_output)
        self.voltage_V.append(decision.boost_reference_V)
        self.adaptive.append(decision.controller is Mode.ADAPTIVE)
        self.reasons.append(decision.reason)
        estimates = decision.estimates.items()
        self.estimates.append({name: (one.value, one.std) for name, one in estimates})

    def in_force(self, from_s: float) -> float:
        """Share of the time with the adaptive controller."""
        return float(
            np.mean([a for a, t in zip(self.adaptive, self.time_s, strict=True) if t >= from_s])
        )

    def model_error(self, disks: float, from_s: float, to_s: float = math.inf) -> float:
        """Rms distance from the designed loop, without limits or delays, over the step."""
        times = np.array(self.time_s)
        errors = (np.array(self.output) - ideal(self.reference, disks)) / STEP
        return float(np.sqrt(np.mean(errors[(times >= from_s) & (times < to_s)] ** 2)))


def ideal(reference: list[float], disks: float, pole: float = 0.7) -> NDArray[np.float64]:
    """Response of the design to its reference: four equal poles and the held load's zero."""
    motor_s, filter_s = 11.7 * disks, 10.0
    product = motor_s * filter_s
    _, b = held_model(
        [0.0, 0.0, 0.011 / product],
        [1.0, (motor_s + filter_s) / product, 1.0 / product],
        1.0,
        0.0,
        0.0,
    )
    desired = np.poly([pole] * 4)
    course = np.array(reference)
    answer: NDArray[np.float64] = lfilter(
        np.array(b) * desired.sum() / sum(b), desired, course - course[0]
    )
    course_of_design: NDArray[np.float64] = course[0] + answer
    return course_of_design


SMALL_BATH: dict[str, dict[str, Any]] = {
    "load": {"period_s": 4.0, "samples": 120},
    "load.model": {"tau_s": 40.0},
    "estimator": {"tau_lambda_s": 20.0, "settle_s": 40.0},
    "supervisor": {"warm_up_s": 80.0, "saturated_s": 480.0, "response_s": 120.0},
}
"""Settings of a bath with a fifth of the water, which is five times as fast."""


def change(tables: dict[str, Any], changes: Mapping[str, Mapping[str, Any]]) -> None:
    """Change values of a configuration, by the names of their tables."""
    for section, values in changes.items():
        table = tables
        for name in section.split("."):
            table = table.setdefault(name, {})
        table.update(values)


def started(
    name: str,
    world: World,
    mode: Mode = Mode.FIXED,
    changes: dict[str, dict[str, Any]] | None = None,
) -> OperatedDrive:
    """A drive of an example configuration that has just reached `running`."""
    tables = example_tables(f"{name}.toml")
    change(tables, changes or {})
    drive = OperatedDrive(validate_configuration(tables, EXAMPLES / f"{name}.toml"), world)
    drive.begin(mode)
    return drive


def periods(drive: OperatedDrive, seconds: float) -> Iterator[None]:
    """Run for a while, and stop after each slow period; a trip ends it."""
    end_s = drive.time_s + seconds
    while drive.time_s < end_s - 1e-9 and drive.machine.trip is None:
        if drive.tick():
            yield


def wait(drive: OperatedDrive, seconds: float) -> None:
    """Run for a while."""
    for _ in periods(drive, seconds):
        pass


def settling_s(drive: OperatedDrive, target: float, limit_s: float) -> float:
    """Time until the output stays within 5 % of a step to a target."""
    began_s, began = drive.time_s, drive.world.true_output
    drive.carry_out(SetSetpoint(target))
    last_s = began_s
    for _ in periods(drive, limit_s):
        if abs(drive.world.true_output - target) > 0.05 * abs(target - began):
            last_s = drive.time_s
    return last_s - began_s


@dataclass(frozen=True)
class Motion:
    """A motor under a square wave, and what happens to it.

    Attributes:
        disks: On its shaft at the start.
        noise: σ of each fast sample, in volts of the tachometer.
        seed: Of the noise.
        quantum: Resolution of the tachometer.
        duration_s: Of the wave.
        low: Of the wave.
        high: Of the wave; equal to `low` for a constant reference.
    """

    disks: int = 3
    noise: float = 0.0
    seed: int = 0
    quantum: float = 0.0
    duration_s: float = 1200.0
    low: float = LOW
    high: float = HIGH

    def run(
        self,
        mode: Mode,
        event: Event | None = None,
        changes: dict[str, dict[str, Any]] | None = None,
    ) -> Rows:
        """Let the daemon's controller hold the motor, and say what happened."""
        motor = Motor(MotorParameters(), self.disks)
        noise = NoiseParameters(sigma=self.noise)
        world = Sensed(motor, noise=noise, seed=self.seed)
        world.quantum = self.quantum
        world.settle(world.boost_voltage_for(self.low))
        drive = started("motor", world, mode, changes)
        drive.carry_out(SetSetpoint(self.low))
        wait(drive, 20.0)
        if self.high != self.low:
            wave = Waveform(Shape.SQUARE, self.low, self.high, CYCLE_S)
            drive.carry_out(SetWaveform(wave, preview=False))
        rows, began_s = Rows(), drive.time_s
        for _ in periods(drive, self.duration_s):
            if event is not None:
                event(motor, drive.time_s - began_s)
            rows.append(drive, began_s)
        assert drive.machine.trip is None, drive.machine.trip
        return rows


def torque_steps(motor: Motor, time_s: float) -> None:
    """20 V worth of torque, on and off every 45 s."""
    motor.torque_Nm = TORQUE_20_V_NM if int(time_s // 45.0) % 2 else 0.0


def sinusoidal_torque(motor: Motor, time_s: float) -> None:
    """0 to 20 V worth of torque with a period of 30 s."""
    motor.torque_Nm = TORQUE_20_V_NM * 0.5 * (1.0 + math.sin(2.0 * math.pi * time_s / 30.0))


def swinging_torque(seed: int) -> Event:
    """Return the same, with a phase of its own for each seed."""
    late_s = float(np.random.default_rng(seed).uniform(0.0, 30.0))
    return lambda motor, time_s: sinusoidal_torque(motor, time_s + late_s)


def random_torque(seed: int) -> Event:
    """Torque worth 0 to 24 V that jumps every 20 to 70 s."""
    random = np.random.default_rng(seed)
    times_s = np.cumsum(random.uniform(20.0, 70.0, 60))
    levels_Nm = random.uniform(0.0, 1.2, 60) * TORQUE_20_V_NM

    def event(motor: Motor, time_s: float) -> None:
        motor.torque_Nm = float(levels_Nm[np.searchsorted(times_s, time_s)])

    return event


def disks_at(*changes: tuple[float, int]) -> Event:
    """Disks that fall on the shaft at given times."""

    def event(motor: Motor, time_s: float) -> None:
        wanted = [disks for start_s, disks in changes if time_s >= start_s]
        if wanted and motor.disks != wanted[-1]:
            motor.disks = wanted[-1]

    return event


def load_world(load: SimulatedLoad, noise: float = 0.0, seed: int = 0) -> World:
    """Any load behind the reference drive."""
    return World(load, noise=NoiseParameters(sigma=noise), seed=seed)
