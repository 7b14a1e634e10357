"""An operator with mosquitto_pub and mosquitto_sub, and a drive on each bus that obeys."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from adaptdrive.recording.session import Ending
from tests.system.conftest import MakeSite
from tests.system.daemon.site import Site, publish, until
from tests.unit.mqtt.contract import validators

VCAN = Path("/sys/class/net/vcan0").exists()
ON_VCAN = {"bus.interface": '"socketcan"', "bus.channel": '"vcan0"'}
FAULT = "drive fault: Fault bit 0 Overcurrent, bit 1 Overtemperature (word 0x3)"


@pytest.mark.parametrize(
    ("example", "changes", "named"),
    [
        pytest.param("motor", ON_VCAN if VCAN else {}, FAULT, id="vcan" if VCAN else "multicast"),
        pytest.param("motor-modbus-tcp", {}, "drive fault: ", id="modbus-tcp"),
        pytest.param("motor-modbus-rtu", {}, "drive ", id="modbus-rtu"),
    ],
)
def test_a_drive_is_run_tripped_reset_and_recorded(
    make_site: MakeSite, example: str, changes: dict[str, str], named: str
) -> None:
    site = make_site(changes, example)
    site.start("--initial-voltage", "280")
    assert site.state["state"] == "standby"
    site.run_drive()
    site.demand("setpoint", 3.0)
    site.await_state(state="running", setpoint=3.0, coasting=False)
    refused = site.ask("setpoint", 4.6)
    assert not refused["accepted"]
    assert "is outside 0…4.5 V" in refused["reason"]
    site.let_periods_pass(2)
    trips_until_its_fault_is_gone(site, named)
    site.run_drive()
    fits_its_schema(site)
    site.demand("disable")
    site.await_state(state="standby", enabled=False)
    gives_up(site)
    assert site.stop_daemon() == 0
    site.await_availability("offline")
    session = site.session()
    assert session.info.ended is Ending.ORDERLY
    assert {"state", "trip"} <= {event.kind for event in session.events}
    replayed = site.replay()
    assert replayed.returncode == 0, replayed.stdout + replayed.stderr
    assert replayed.stdout.splitlines()[1:] == ["every command is bit-equal"]


def trips_until_its_fault_is_gone(site: Site, named: str) -> None:
    """On a busy line the bridge that the fault has opened may be read before the fault itself."""
    site.disturb("fault", "3")
    tripped = site.await_state(state="tripped", enabled=False)
    assert tripped["trip"].startswith(named)
    assert tripped["last_trip"]["remedy"]
    for verb in ("reset", "enable"):
        assert not site.ask(verb)["accepted"]
    alarms = [heard.content for heard in site.ear.on("event")]
    assert ("trip", "alarm") in [(alarm["kind"], alarm["severity"]) for alarm in alarms]
    site.disturb("fault", "0")
    until(lambda: site.ask("reset")["accepted"], "the reset is accepted")
    site.await_state(state="standby", trip=None)


def fits_its_schema(site: Site) -> None:
    """Every message that the drive has published."""
    publish(site.broker_port, "adaptdrive/motor/ask/history", "")
    assert site.ear.next_on("history", after=0).content["rows"]
    for name, validator in validators().items():
        if name.partition("/")[0] not in {"command", "ask", "availability"}:
            for message in site.ear.on(name):
                validator.validate(message.content)


def gives_up(site: Site) -> None:
    """A command that its sender has given up, to a frozen daemon, is not carried out later."""
    expires = datetime.now(UTC) + timedelta(seconds=1.0)
    payload = json.dumps({"id": "given up", "expires": f"{expires:%Y-%m-%dT%H:%M:%SZ}"})
    with site.stalled(site.daemon):
        publish(site.broker_port, "adaptdrive/motor/command/enable", payload)
        until(lambda: datetime.now(UTC) > expires, "the sender has given up")
    reply = until(lambda: site.reply_to("given up"), "a reply")
    assert not reply["accepted"]
    assert "expired at" in reply["reason"]
    assert site.state["state"] in ("standby", "tripped")
