"""The motor experiment in virtual time: controller and simulated plant in lockstep."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.signal import lfilter

from adaptdrive.control.controller import Controller
from adaptdrive.control.fast import LAG_TICKS
from adaptdrive.control.loads.load import Load
from adaptdrive.control.loads.motor import motor_load
from adaptdrive.control.settings import (
    ControllerSettings,
    EstimatorSettings,
    PowerStage,
    Rates,
    SupervisionLimits,
)
from adaptdrive.control.signals import (
    Command,
    Decision,
    Measurement,
    Mode,
    Order,
    SlowSample,
    Stage,
)
from adaptdrive_sim.plants.boost import Sample
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from adaptdrive_sim.world import NoiseParameters, World
from tests.unit.control.systems import Array, held_polynomials, motor_system

MOTOR: Load = motor_load(0.011, 11.7, 10.0)
TICK_s = 1.0 / 120.0
TICKS = 120
LOW, HIGH = 3.0, 3.2
STEP = HIGH - LOW
CYCLE_s = 120

REST_V = 3.0 / 0.011
AT_REST = SlowSample(
    period_s=1.0,
    output=3.0,
    output_filtered=[3.0, 3.0],
    input_filtered=[REST_V] * 3,
    applied=REST_V,
    followed=True,
    held_share=0.0,
    reference=3.0,
    adaptive=True,
    pole=0.7,
    low=200.0,
    high=400.0,
)
"""A slow sample of the motor at rest at 3 V."""

STAGE = PowerStage(
    capacitance_F=1e-3,
    line_voltage_min_V=60.0,
    current_scale_min_S=0.0,
    current_scale_max_S=0.15,
    boost_reference_min_V=200.0,
    boost_reference_max_V=400.0,
    load_power_max_W=1500.0,
    holds_voltage=False,
)
RATES = Rates(
    ticks_per_period=TICKS, latency_ticks=2, samples=60, lag_ticks=LAG_TICKS, nominal_tick_s=TICK_s
)
PLAIN_LEARNING = EstimatorSettings(
    method="lm-rls",
    forgetting=0.97,
    tau_lambda_s=10.0,
    initial_covariance=1e4,
    settle_periods=0,
    gate=0.0,
    output_scale=1.0,
    input_scale=1.0,
    start_at_nominal=False,
)
SCALED_LEARNING = replace(
    PLAIN_LEARNING,
    gate=2.0,
    output_scale=3.0,
    input_scale=280.0,
    start_at_nominal=True,
)
JACKET = SupervisionLimits(warm_up_periods=90, ratio_min=0.2, ratio_max=8.0, revokes=True)
EXACT = ControllerSettings(
    exact=True, stage=STAGE, rates=RATES, learning=SCALED_LEARNING, supervision=JACKET
)
PAPER = replace(
    EXACT,
    exact=False,
    rates=replace(RATES, samples=1),
    learning=PLAIN_LEARNING,
    supervision=replace(JACKET, revokes=False),
)


def order(
    reference: float = LOW, mode: Mode = Mode.FIXED, stage: Stage = Stage.RUN, pole: float = 0.7
) -> Order:
    return Order(stage, reference, mode, pole)


class Bench:
    """A controller that runs a motor at rest; decisions take effect after the latency."""

    def __init__(
        self,
        settings: ControllerSettings = EXACT,
        *,
        noise: NoiseParameters | None = None,
        seed: int = 0,
        output: float = LOW,
    ) -> None:
        self.motor = Motor(MotorParameters())
        self.world = World(self.motor, noise=noise, seed=seed)
        self.world.settle(self.world.boost_voltage_for(output))
        self.controller = Controller(settings, MOTOR)
        self.latency = settings.rates.latency_ticks
        self.n = -1
        self.decisions: list[Decision] = []
        self.commands: list[Command] = []
        self._due = 0
        self._sample: Sample = self.world.step(self.world.current_scale_S, bridge=True)

    def tick(self, wanted: Order) -> Command:
        if self.decisions and self.n == self._due:
            self.controller.apply(self.decisions[-1])
        command = self.controller.tick(self.measurement(), wanted)
        if (snapshot := self.controller.take_snapshot()) is not None:
            self.decisions.append(self.controller.decide(snapshot))
            self._due = self.n + self.latency
        self._sample = self.drive(command, self._sample)
        self.commands.append(command)
        self.n += 1
        return command

    def drive(self, command: Command, _: Sample) -> Sample:
        """What the drive measures half a cycle after a command."""
        return self.world.step(command.current_scale_S, command.bridge)

    def measurement(self) -> Measurement:
        s = self._sample
        return Measurement(
            self.n, s.tick_period_s, s.boost_voltage_V, s.line_voltage_V, s.load_power_W, s.output
        )

    def run(self, seconds: float, wanted: Order) -> None:
        for _ in range(round(seconds * TICKS)):
            self.tick(wanted)


@dataclass(slots=True)
class Trace:
    """What happened at each slow instant."""

    time_s: list[int] = field(default_factory=list)
    output: list[float] = field(default_factory=list)
    reference: list[float] = field(default_factory=list)
    disks: list[int] = field(default_factory=list)

    def overshoot(self, start_s: int) -> float:
        """The larger one of both half cycles of the cycle that starts then, over the step."""
        half = CYCLE_s // 2
        y = np.array(self.output[start_s : start_s + CYCLE_s])
        return float(max(y[:half].max() - HIGH, LOW - y[half:].min()) / STEP)

    def model_error(self, start_s: int, ideal: Array) -> float:
        """Rms distance from the ideal loop in that cycle, over the step."""
        cycle = slice(start_s, start_s + CYCLE_s)
        return float(np.sqrt(np.mean((np.array(self.output) - ideal)[cycle] ** 2)) / STEP)


def square_wave(time_s: float) -> float:
    return HIGH if math.fmod(time_s, CYCLE_s) < CYCLE_s / 2 else LOW


def experiment(
    settings: ControllerSettings,
    mode: Mode,
    *,
    segment_s: int,
    disks: tuple[int, ...] = (1, 2, 3),
    noise: float = 0.0,
    seed: int = 0,
) -> Trace:
    """The motor under a square wave, with one more disk from segment to segment.

    Args:
        settings: Of the controller.
        mode: Fixed or adaptive.
        segment_s: Length of a segment.
        disks: Disks of each segment.
        noise: Of each fast sample, over the step.
        seed: Of the noise.
    """
    bench = Bench(settings, noise=NoiseParameters(sigma=noise * STEP), seed=seed)
    bench.tick(order(LOW, mode))
    trace = Trace()
    for second in range(segment_s * len(disks)):
        bench.motor.disks = disks[second // segment_s]
        reference = square_wave(second)
        trace.time_s.append(second)
        trace.output.append(bench.world.true_output)
        trace.reference.append(reference)
        trace.disks.append(bench.motor.disks)
        bench.run(1.0, order(reference, mode))
    return trace


def ideal_output(trace: Trace, pole: float = 0.7) -> Array:
    """The loop as designed for the true load: no limits, no delays, one disk throughout."""
    wanted = np.poly([pole] * 4)
    zeros = held_polynomials(motor_system(trace.disks[0]), 1.0)[1]
    filtered = lfilter(sum(wanted) / sum(zeros) * zeros, wanted, np.array(trace.reference) - LOW)
    return np.asarray(LOW + filtered)
