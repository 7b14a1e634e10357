"""Thermocouples on a serial line beside a drive on CAN, as processes: mbpoll, and the daemon."""

from __future__ import annotations

import subprocess
import sys

import pytest

from adaptdrive.recording.reader import read_session
from tests.scenes.system.conftest import MakeSite
from tests.scenes.system.sensor_site import bath_site, mbpoll
from tests.scenes.system.site import PATIENT_DRIVE, Site, until

pytestmark = pytest.mark.slow

INPUT, HOLDING = "3", "4"
INFLOW_C = 11.85
NO_VALUE = {0x8000, -0x8000}


def temperatures(site: Site) -> tuple[float, float]:
    """Bath and inflow in degrees, as the documented map says that mbpoll's registers mean."""

    def measured() -> tuple[float, float] | None:
        words = mbpoll(site, INPUT, 0)
        if set(words.values()) & NO_VALUE:
            return None
        return words[0] * 0.01, words[1] * 0.01

    return until(measured, "the modules have measured")


def test_mbpoll_reads_and_writes_the_documented_map(make_site: MakeSite) -> None:
    site = bath_site(make_site)
    site.start_broker()
    site.start_device("--initial-voltage", "300")
    bath_C, inflow_C = temperatures(site)
    assert inflow_C == pytest.approx(INFLOW_C, abs=0.006)
    assert bath_C - inflow_C == pytest.approx(11.8, abs=0.3)  # (0.25 · 300 / 8.87)² · 7.87 · R
    mbpoll(site, HOLDING, 0, values=(15, 14))
    assert mbpoll(site, HOLDING, 0) == {0: 15, 1: 14}
    site.disturb("sensor-fault", "1")
    assert set(mbpoll(site, INPUT, 0).values()) <= NO_VALUE
    site.disturb("sensor-fault", "0")
    assert temperatures(site)[1] == pytest.approx(INFLOW_C, abs=0.006)


def sensors(site: Site) -> dict[str, object]:
    heard = site.ear.on("telemetry/drive")
    found = heard[-1].content["sensors"] if heard else {}
    assert isinstance(found, dict)
    values = found.get("thermocouples", {})
    assert isinstance(values, dict)
    return values


@pytest.mark.parametrize(
    ("fault", "words"),
    [("1", "bath_temperature is"), ("3", "bath_temperature is")],
    ids=["broken wire", "unplugged"],
)
def test_a_sensor_that_fails_trips_the_drive_and_its_return_lets_it_be_reset(
    make_site: MakeSite, fault: str, words: str
) -> None:
    site = bath_site(make_site)
    site.start("--initial-voltage", "300", *PATIENT_DRIVE)
    until(lambda: sensors(site).get("values"), "values of the thermocouples")
    site.run_drive()
    site.disturb("sensor-fault", fault)
    tripped = site.await_state(state="tripped")
    assert tripped["trip"].startswith(f"stale: thermocouples.{words}")
    assert not site.ask("reset")["accepted"]
    site.await_measurement()  # the drive itself is fresh
    site.disturb("sensor-fault", "0")
    until(lambda: site.ask("reset")["accepted"], "the trip is reset")
    site.run_drive()
    if fault == "3":
        told = [heard.content["detail"] for heard in site.ear.on("event")]
        assert any(detail.startswith("sensor bus thermocouples: modbus-rtu") for detail in told)
    assert_each_reply_is_recorded(site)


def assert_each_reply_is_recorded(site: Site) -> None:
    """Each reply of the module has a row of its own, besides those of `telemetry/drive`."""
    until(lambda: len(recorded_replies(site)) > 10, "eleven recorded replies")
    assert site.stop_daemon() == 0
    rows = read_session(site.session_folder()).sensors.num_rows
    asked = len(recorded_replies(site))
    assert rows > len(site.ear.on("telemetry/drive")) + 0.5 * asked


def recorded_replies(site: Site) -> set[float]:
    """Return the times of the replies that the session of a running daemon holds by now."""
    age = "thermocouples.bath_temperature.age_s"
    rows = read_session(site.session_folder()).sensors.to_pylist()
    return {round(row["monotonic_s"] - row[age], 3) for row in rows if row[age] is not None}


def test_without_its_sensors_the_daemon_starts_waits_and_does_not_enable(
    make_site: MakeSite,
) -> None:
    site = bath_site(make_site)
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


def test_probe_and_check_show_the_sensors(make_site: MakeSite) -> None:
    site = bath_site(make_site)
    site.start_broker()
    site.start_device("--initial-voltage", "300")
    probe = site._start("probe.log", "-m", "adaptdrive.cli", "probe", site.config)

    def shown() -> bool:
        lines = site._read("probe.log").splitlines()
        return any("thermocouples: bath_temperature 29" in line for line in lines)

    until(shown, "probe shows the thermocouples")
    probe.terminate()
    lines = [line for line in site._read("probe.log").splitlines() if "temperature  1" in line]
    assert lines, site._read("probe.log")
    text = site.config.read_text().replace("cycle_s = 0.25", "cycle_s = 0.05")
    text = text.replace("stale_s = 1.0 ", "stale_s = 0.5 ")
    site.config.write_text(text.replace("timeout_s = 0.06", "timeout_s = 0.01"))
    done = subprocess.run(
        [sys.executable, "-m", "adaptdrive.cli", "check", site.config],
        check=False,
        capture_output=True,
        text=True,
        timeout=240.0,
    )
    assert done.returncode == 2
    assert "sensor_bus.0.timeout_s: 0.01 s must be above the slowest exchange" in done.stderr
