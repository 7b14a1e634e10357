"""Thermocouples on a serial line beside a drive on CAN, as processes."""

from __future__ import annotations

import pytest

from adaptdrive.recording.reader import read_session
from tests.system.conftest import MakeSite
from tests.system.daemon.site import Site, until

pytestmark = pytest.mark.proof

EXAMPLE = "bath-thermocouples"


def sensors(site: Site) -> dict[str, object]:
    heard = site.ear.on("telemetry/drive")
    found = heard[-1].content["sensors"] if heard else {}
    assert isinstance(found, dict)
    values = found.get("thermocouples", {})
    assert isinstance(values, dict)
    return values


@pytest.mark.parametrize("fault", ["1", "3"], ids=["broken wire", "unplugged"])
def test_a_sensor_that_fails_trips_the_drive_and_its_return_lets_it_be_reset(
    make_site: MakeSite, fault: str
) -> None:
    site = make_site(example=EXAMPLE)
    site.start("--initial-voltage", "300")
    until(lambda: sensors(site).get("values"), "values of the thermocouples")
    site.run_drive()
    site.disturb("sensor-fault", fault)
    tripped = site.await_state(state="tripped")
    assert tripped["trip"].startswith("stale: thermocouples.bath_temperature is")
    assert not site.ask("reset")["accepted"]
    site.await_measurement()  # the drive itself is fresh
    site.disturb("sensor-fault", "0")
    until(lambda: site.ask("reset")["accepted"], "the trip is reset")
    site.run_drive()
    if fault == "3":
        told = [heard.content["detail"] for heard in site.ear.on("event")]
        assert any(detail.startswith("sensor bus thermocouples: modbus-rtu") for detail in told)
    assert site.stop_daemon() == 0
    assert read_session(site.session_folder()).table("sensors").num_rows > 10


def test_without_its_sensors_the_daemon_starts_waits_and_does_not_enable(
    make_site: MakeSite,
) -> None:
    site = make_site(example=EXAMPLE)
    text = site.config.read_text()
    site.config.write_text(text.replace("thermocouples.tty", "elsewhere.tty"))
    site.start_broker()
    site.start_device()
    site.config.write_text(text)
    site.start_daemon()
    site.await_measurement()
    reply = site.ask("enable")
    assert not reply["accepted"]
    assert "thermocouples.bath_temperature: no measurement yet" in reply["reason"]
    assert "there is no such serial port" in reply["reason"]
    until(lambda: sensors(site).get("up") is False, "telemetry tells that the bus is down")
