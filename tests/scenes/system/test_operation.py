"""An operator with mosquitto_pub and mosquitto_sub, and a drive that does what it is told."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from datetime import datetime

import pytest

from adaptdrive.runtime.statistics import BINS
from tests.operation.contract import validators
from tests.scenes.system.conftest import MakeSite
from tests.scenes.system.site import PATIENT_DRIVE, Site, publish, until

STATE_KEYS = {
    "state",
    "mode",
    "controller",
    "reason",
    "enabled",
    "setpoint",
    "waveform",
    "trip",
}
LOAD_KEYS = {
    "time",
    "k",
    "reference",
    "output",
    "boost_reference_V",
    "applied_V",
    "estimates",
    "gains",
    "excitation",
    "accepted",
    "reason",
}
DRIVE_KEYS = {
    "time",
    "boost_voltage_V",
    "load_power_W",
    "command",
    "ticks",
    "missed",
    "lateness_us",
}
SQUARE = {"shape": "square", "low": 2.8, "high": 3.2, "period_s": 10.0}


@pytest.fixture(scope="module")
def running_site(make_shared_site: MakeSite) -> Site:
    site = make_shared_site()
    site.start("--initial-voltage", "280", *PATIENT_DRIVE)
    return site


@pytest.fixture
def site(running_site: Site) -> Iterator[Site]:
    """The site in standby, mode fixed."""
    yield running_site
    running_site.demand("disable")
    until(lambda: running_site.ask("reset")["accepted"], "the trip is reset")
    running_site.demand("mode", "fixed")
    running_site.await_state(state="standby", mode="fixed")


def ordered(site: Site) -> dict[str, object]:
    """What the operator has ordered, by the last state."""
    return {name: site.state[name] for name in ("mode", "enabled", "setpoint", "waveform", "pole")}


def utc(text: str) -> datetime:
    assert text.endswith("Z")
    return datetime.fromisoformat(text)


def test_every_verb_is_answered_and_the_state_follows(site: Site) -> None:
    assert site.state["state"] == "standby"
    turning = site.ear.on("telemetry/drive")[-1].content["output"]
    site.demand("enable")
    running = site.await_state(state="running", enabled=True)
    assert 0.8 * turning < running["setpoint"] <= turning + 0.01  # it slows down until enabled
    site.demand("setpoint", 3.0)
    site.await_state(setpoint=3.0)
    site.demand("waveform", SQUARE)
    until(lambda: site.state["waveform"] == SQUARE, "the waveform is in the state")
    site.demand("waveform", "off")
    until(lambda: site.state["waveform"] is None, "the waveform is off")
    site.demand("mode", "adaptive")
    adaptive = site.await_state(mode="adaptive")
    assert adaptive["controller"] == "fixed"
    assert adaptive["reason"]
    site.demand("pole", 0.8)
    site.await_state(pole=0.8)
    site.demand("pole", 0.7)
    reply = site.ask("disable")
    assert (reply["accepted"], reply["reason"]) == (True, "")
    assert reply["state"] in {"stopping", "standby"}
    site.await_state(state="standby", enabled=False)
    site.demand("reset")


def test_state_and_telemetry_have_the_keys_of_the_contract(site: Site) -> None:
    site.run_drive()
    site.demand("setpoint", 3.0)
    load = site.ear.next_on("telemetry/load", after=len(site.ear.on("telemetry/load")))
    drive = site.ear.on("telemetry/drive")[-1]
    assert site.state.keys() >= STATE_KEYS
    assert load.content.keys() >= LOAD_KEYS
    assert drive.content.keys() >= DRIVE_KEYS
    assert not drive.retained
    assert load.content["gains"]
    assert load.content["estimates"]
    assert all(set(one) == {"value", "std"} for one in load.content["estimates"].values())
    assert drive.content["lateness_us"].keys() == {"p50", "p99", "max"}
    counted = site.ear.next_on("telemetry/histograms", after=0)
    assert len(counted.content["tick_us"]) == BINS
    later = site.ear.next_on("telemetry/drive", after=len(site.ear.on("telemetry/drive")))
    assert sum(counted.content["tick_us"]) <= later.content["ticks"]
    assert drive.content["command"]["bridge"] is True
    assert 195.0 < drive.content["boost_voltage_V"] < 405.0
    apart = utc(load.content["time"]) - utc(drive.content["time"])
    assert abs(apart.total_seconds()) < 10.0


def test_the_fast_loop_is_told_at_most_ten_times_a_second(site: Site) -> None:
    first = len(site.ear.on("telemetry/drive"))
    site.ear.next_on("telemetry/drive", after=first + 15)
    times = [utc(heard.content["time"]) for heard in site.ear.on("telemetry/drive")[first:]]
    assert (times[-1] - times[0]).total_seconds() >= 0.09 * (len(times) - 1)


@pytest.mark.parametrize(
    ("verb", "value", "reason"),
    [
        ("setpoint", 4.6, "is outside 0…4.5 V"),
        ("setpoint", "fast", "Expected `float`"),
        ("waveform", SQUARE | {"period_s": 0.1}, "period_s = 0.1 s is below"),
        ("pole", 1.2, "is outside"),
        ("mode", "clever", "Invalid enum value"),
        ("explode", None, "unknown verb"),
    ],
)
def test_a_refused_command_changes_nothing(
    site: Site, verb: str, value: object, reason: str
) -> None:
    site.run_drive()
    before = ordered(site)
    reply = site.ask(verb, value)
    assert not reply["accepted"]
    assert reason in reply["reason"]
    assert reply["verb"] == verb
    assert ordered(site) == before


def test_a_retained_command_is_refused(site: Site) -> None:
    topic = "adaptdrive/motor/command/enable"
    publish(site.broker_port, topic, json.dumps({"id": "kept"}), "-r")
    reply = until(lambda: site._reply("kept"), "a reply")
    publish(site.broker_port, topic, "", "-r")
    assert not reply["accepted"]
    assert site.state["state"] == "standby"


def test_a_fault_of_the_drive_trips_until_it_is_gone_and_reset(site: Site) -> None:
    site.run_drive()
    site.disturb("fault", "3")
    tripped = site.await_state(state="tripped")
    assert (
        tripped["trip"] == "drive fault: Fault bit 0 Overcurrent, bit 1 Overtemperature (word 0x3)"
    )
    assert not tripped["enabled"]
    refusal = site.ask("reset")
    assert (refusal["accepted"], refusal["state"]) == (False, "tripped")
    assert (
        "drive fault: Fault bit 0 Overcurrent, bit 1 Overtemperature (word 0x3)"
        in refusal["reason"]
    )
    assert not site.ask("enable")["accepted"]
    alarms = [heard.content for heard in site.ear.on("event")]
    assert ("trip", "alarm") in [(alarm["kind"], alarm["severity"]) for alarm in alarms]
    site.disturb("fault", "0")
    until(lambda: site.ask("reset")["accepted"], "the reset is accepted")
    site.await_state(state="standby", trip=None)
    site.run_drive()


def test_over_speed_trips(site: Site) -> None:
    """A tachometer that goes wild looks like a motor that does."""
    site.run_drive()
    site.disturb("noise", "3")
    tripped = site.await_state(state="tripped")
    assert tripped["trip"].startswith("output above its limit: speed = ")
    assert " V, limit 5 V: " in tripped["trip"]
    site.disturb("noise", "0")


def test_every_message_of_a_running_daemon_fits_its_schema(site: Site) -> None:
    site.run_drive()
    site.ear.next_on("telemetry/load", after=len(site.ear.on("telemetry/load")))
    publish(site.broker_port, "adaptdrive/motor/ask/history", "")
    site.ear.next_on("history", after=0)
    for name, validator in validators().items():
        if name.partition("/")[0] not in {"command", "ask", "availability"}:
            for message in site.ear.on(name):
                validator.validate(message.content)
    assert site.ear.on("history")[0].content["rows"]


def test_a_command_that_was_given_up_is_not_carried_out_later(site: Site) -> None:
    broker = ("--broker", f"127.0.0.1:{site.broker_port}")
    command = [sys.executable, "-m", "adaptdrive.cli", "enable", "motor", "--timeout", "2", *broker]
    known = len(site.ear.on("reply"))
    with site.stalled(site.daemon):
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=site.folder)
    assert done.returncode == 3, done.stderr
    reply = site.ear.next_on("reply", after=known).content
    assert not reply["accepted"]
    assert "expired at" in reply["reason"]
    assert site.state["state"] in ("standby", "tripped")
