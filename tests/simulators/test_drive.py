"""What the simulated drive does by itself."""

from typing import Any

import pytest

from adaptdrive.config import Configuration
from adaptdrive_sim.device_main import build_drive
from adaptdrive_sim.device_settings import DeviceSettings
from adaptdrive_sim.devices.drive import Frame, SimulatedDrive
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from adaptdrive_sim.world import World
from tests.config import modbus_documents
from tests.config.documents import parse

HALF_CYCLE_s = 1.0 / 120.0


class Bench:
    """A drive under a clock of our own."""

    def __init__(self, boost_voltage_V: float = 300.0) -> None:
        self.events: list[tuple[str, dict[str, Any]]] = []
        self.world = World(Motor(MotorParameters()))
        self.world.settle(boost_voltage_V)
        self.holding_S = self.world.current_scale_S
        self.drive = SimulatedDrive(
            self.world, lambda event, **data: self.events.append((event, data))
        )
        self.now_s = 1000.0

    def commanded(self, ticks: int, scale_S: float, *, bridge: bool = True) -> Frame:
        for _ in range(ticks):
            self.drive.command(scale_S, bridge, self.now_s)
            frame = self.silent(1)
        return frame

    def silent(self, ticks: int) -> Frame:
        for _ in range(ticks):
            self.now_s += HALF_CYCLE_s
            frame = self.drive.tick(self.now_s)
        return frame

    def named(self, name: str) -> list[dict[str, Any]]:
        return [data for event, data in self.events if event == name]


def test_over_voltage_stops_the_line_current_and_leaves_the_bridge() -> None:
    bench = Bench(400.0)
    highest_V = 0.0
    for _ in range(120):
        frame = bench.commanded(1, 0.15)
        highest_V = max(highest_V, frame.sample.boost_voltage_V)
    assert 450.0 < highest_V < 500.0
    assert frame.fault == 4
    assert frame.bridge
    assert frame.sample.boost_voltage_V < 450.0
    assert len(bench.named("over-voltage")) == 1


def test_over_voltage_with_the_bridge_off_ends_as_the_capacitor_discharges() -> None:
    bench = Bench(400.0)
    assert bench.commanded(120, 0.15, bridge=False).fault == 4
    assert bench.commanded(120, 0.0, bridge=False).fault == 4
    frame = bench.commanded(120 * 30, 0.0, bridge=False)
    assert (frame.fault, frame.bridge) == (0, False)


@pytest.mark.parametrize(("start_V", "end_V"), [(449.0, 400.0), (399.0, 399.0)])
def test_a_capacitor_is_discharged_to_the_highest_reference(start_V: float, end_V: float) -> None:
    frame = Bench(start_V).silent(120 * 30)
    assert frame.sample.boost_voltage_V == pytest.approx(end_V)


@pytest.mark.parametrize(
    ("reference_V", "daemon_V", "safe_V", "tripped_V"),
    [(400.0, 430.0, 449.0, 451.0), (700.0, 750.0, 760.0, 800.0)],
)
def test_a_drive_protects_itself_above_the_voltages_of_its_configuration(
    reference_V: float, daemon_V: float, safe_V: float, tripped_V: float
) -> None:
    configuration = parse(
        drive__limits__boost_reference_max_V=str(reference_V),
        interlocks__boost_voltage_max_V=str(daemon_V),
    )
    for voltage_V, fault in ((safe_V, 0), (tripped_V, 4)):
        settings = DeviceSettings(initial_voltage_V=voltage_V)
        drive = build_drive(configuration, settings, lambda *_, **__: None)
        assert drive.tick(1000.0).fault == fault


@pytest.mark.parametrize(
    ("configuration", "stated_s", "timeout_s"),
    [
        (parse(), None, 0.1),
        (parse(bus__command_timeout_s="0.3"), None, 0.3),
        (parse(bus__command_timeout_s="0.3"), 0.2, 0.2),
        (modbus_documents.parse(), None, 0.4),
        (modbus_documents.parse(bus__command_timeout_s="0.3"), None, 0.3),
    ],
)
def test_a_drive_shuts_down_after_the_time_out_of_its_configuration(
    configuration: Configuration, stated_s: float | None, timeout_s: float
) -> None:
    settings = DeviceSettings(initial_voltage_V=300.0, command_timeout_s=stated_s)
    drive = build_drive(configuration, settings, lambda *_, **__: None)
    drive.command(0.0, True, 1000.0)
    assert drive.tick(1000.0 + timeout_s - 0.001).bridge
    assert not drive.tick(1000.0 + timeout_s + 0.001).bridge


def test_an_injected_fault_shuts_the_drive_down_until_it_is_cleared() -> None:
    bench = Bench()
    bench.commanded(20, bench.holding_S)
    bench.drive.inject(16)
    frame = bench.commanded(1, bench.holding_S)
    assert (frame.fault, frame.bridge, frame.sample.load_current_A) == (16, False, 0.0)
    bench.drive.inject(0)
    frame = bench.commanded(3, bench.holding_S)
    assert (frame.fault, frame.bridge) == (0, True)


def test_a_lost_line_is_reported_while_it_lasts_and_a_sag_is_not() -> None:
    bench = Bench()
    bench.world.line.sag(0.3, 0.1)
    assert bench.commanded(1, bench.holding_S).fault == 0
    bench.world.line.sag(1.0, 0.1)
    assert bench.commanded(1, bench.holding_S).fault == 8
    assert bench.commanded(20, bench.holding_S).fault == 0
