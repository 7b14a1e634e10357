"""What the simulated drive does by itself."""

import pytest

from adaptdrive.config import Configuration
from adaptdrive_sim.device import DeviceSettings, build_drive
from tests.unit.config import modbus_documents
from tests.unit.config.documents import parse


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
