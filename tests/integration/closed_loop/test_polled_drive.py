"""A drive that is polled: what counts in a slow period counts as on a drive that sends each tick.

The controller of the example runs against the plant without a bus: a reading each 12 half cycles.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings, machine_limits
from adaptdrive.config.file import load_configuration
from adaptdrive.control.controller import Controller
from adaptdrive.control.signals import Command, Decision, Measurement, Mode, Order, Snapshot, Stage
from adaptdrive_sim.devices.drive import VoltageHolder
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from adaptdrive_sim.world import World
from tests.integration.closed_loop.bench import STAGE, TICKS

LOW, HIGHEST_V = 3.0, 300.0
"""Set-point to begin with; V_c at which the load draws what the drive may give."""

EXAMPLE = Path(__file__).parents[3] / "deploy" / "examples" / "motor-modbus-tcp.toml"
CONFIGURATION = load_configuration(EXAMPLE)
SETTINGS = controller_settings(CONFIGURATION)


class PolledBench:
    """The motor at rest behind a drive that holds V_c and is read each so many half cycles."""

    def __init__(
        self, stride: int, load_power_max_W: float = 1500.0, motor: MotorParameters | None = None
    ) -> None:
        stage = replace(SETTINGS.stage, load_power_max_W=load_power_max_W)
        self.controller = Controller(replace(SETTINGS, stage=stage), build_load(CONFIGURATION))
        self.world = World(Motor(motor or MotorParameters()))
        self.world.settle(self.world.boost_voltage_for(LOW))
        self.snapshots: list[Snapshot] = []
        self.decisions: list[Decision] = []
        self.tick, self._stride, self._due = 0, stride, -1
        self._holder = VoltageHolder(STAGE.capacitance_F, bidirectional=False)
        self._command = Command(0.0, self.world.boost.voltage_V, bridge=True)
        self._sample = self.world.step(self.world.current_scale_S, bridge=True)

    def poll(
        self, reference: float, mode: Mode = Mode.FIXED, pole: float = 0.7, *, fresh: bool = True
    ) -> None:
        """One reading and its command, and the half cycles until the next."""
        if self.tick == self._due:
            self.controller.apply(self.decisions[-1])
        s = self._sample
        boost_V, line_V, power_W = s.boost_voltage_V, s.line_voltage_V, s.load_power_W
        measured = Measurement(
            self.tick, s.tick_period_s, boost_V, line_V, power_W, s.output, fresh
        )
        command = self.controller.tick(measured, Order(Stage.RUN, reference, mode, pole))
        if (snapshot := self.controller.take_snapshot()) is not None:
            self.snapshots.append(snapshot)
            self.decisions.append(self.controller.decide(snapshot))
            self._due = self.tick + SETTINGS.rates.latency_ticks
        for _ in range(self._stride):
            scale_S = self._holder.scale_S(self._command.boost_reference_V, self._sample)
            self._sample = self.world.step(scale_S, bridge=True)
        self._command = command
        self.tick += self._stride

    def run(
        self, seconds: int, reference: float, mode: Mode = Mode.FIXED, pole: float = 0.7
    ) -> None:
        for _ in range(seconds * TICKS // self._stride):
            self.poll(reference, mode, pole)


def power_W(voltage_V: float) -> float:
    """What the motor draws at rest."""
    world = World(Motor(MotorParameters()))
    world.settle(voltage_V)
    return world.step(world.current_scale_S, bridge=True).load_power_W


@pytest.mark.parametrize("stride", [1, 12])
def test_a_load_that_its_power_limits_winds_nothing_up_and_trips_nothing(stride: int) -> None:
    bench = PolledBench(stride, load_power_max_W=power_W(HIGHEST_V))
    bench.run(60, 3.2, Mode.ADAPTIVE)
    bench.run(200, 3.6, Mode.ADAPTIVE)
    assert not any(snapshot.followed for snapshot in bench.snapshots[-150:])
    assert max(decision.boost_reference_V for decision in bench.decisions[-150:]) < 340.0
    assert not any(decision.fault for decision in bench.decisions)


def test_half_a_period_without_a_reading_of_a_polled_drive_ends_adaptive_control() -> None:
    bench = PolledBench(12)
    bench.run(100, LOW, Mode.ADAPTIVE)
    bench.poll(LOW, Mode.ADAPTIVE)
    for number in range(10):
        bench.poll(LOW, Mode.ADAPTIVE, fresh=number >= 6)
    assert bench.decisions[-1].controller is Mode.FIXED
    assert "measurements" in bench.decisions[-1].reason


@pytest.mark.proof
def test_the_slowest_pole_that_may_be_asked_for_settles_a_load_that_the_model_misses() -> None:
    """With 10 % less gain and lags 10 % longer a pole of 0.98 took V_c from limit to limit."""
    usual = MotorParameters()
    missed = MotorParameters(
        disk_kgm2=1.1 * usual.disk_kgm2,
        filter_s=1.1 * usual.filter_s,
        tachometer_Vs=0.9 * usual.tachometer_Vs,
    )
    slowest = machine_limits(CONFIGURATION).pole_max
    bench = PolledBench(12, motor=missed)
    bench.run(10, LOW, pole=slowest)
    bench.run(600, LOW + 0.3, pole=slowest)
    last_V = [one.boost_reference_V for one in bench.decisions[-200:]]
    assert max(last_V) - min(last_V) < 30.0
    assert bench.snapshots[-1].output == pytest.approx(LOW + 0.3, abs=0.05)
