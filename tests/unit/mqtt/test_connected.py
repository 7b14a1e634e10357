"""A drive as an object: its values have names and units, and none that is old passes for fresh."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from adaptdrive.connected import ConnectedDrive, Published, Value, accepted
from adaptdrive.mqtt import contract
from adaptdrive.mqtt.client import NoAnswerError
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import REQUESTS
from adaptdrive.util.errors import RefusedError
from tests.unit.mqtt.peers import STANDBY, drive_report, load_report, profile

NOW = datetime(2026, 11, 21, 1, 22, 9, tzinfo=UTC)
STANDING = contract.Standing(NOW, None, contract.Synchronisation.SYNCHRONISED, NOW)


def decoded(payload: contract.Payload) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(contract.encode(payload))
    return found


class Clock:
    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def measure(published: Published, at: datetime = NOW) -> None:
    about = profile("pump").output
    message = contract.drive_message(drive_report(600), at, about)
    published.take("telemetry/drive", decoded(message))


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def published(clock: Clock) -> Published:
    """All that a drive publishes, as its daemon encodes it."""
    about = profile("pump")
    made = Published("pump", clock)
    made.take("availability", {"availability": "online"})
    state = replace(STANDBY, setpoint=3.0, trip="stale: 54 ms")
    made.take("state", decoded(contract.state_message(state, STANDING, about)))
    made.take("telemetry/load", decoded(contract.load_message(load_report(7), NOW, about.output)))
    measure(made)
    return made


def test_each_field_of_telemetry_and_state_is_a_value(published: Published) -> None:
    about = profile("pump")
    fields = [
        *contract.drive_message(drive_report(600), NOW, about.output),
        *contract.state_message(STANDBY, STANDING, about),
        *contract.load_message(load_report(7), NOW, about.output),
    ]
    assert len(published.names) == len(fields)
    assert not set(published.names) & {*dir(ConnectedDrive), *REQUESTS}
    for name in published.names:
        published.value(name)


def test_a_value_is_a_number_with_a_unit(published: Published) -> None:
    output, voltage = published.value("output"), published.value("boost_voltage_V")
    assert (repr(output), repr(voltage)) == ("3.1 V", "300.5 V")
    assert abs(output - 3.0) == pytest.approx(0.1)
    assert f"{output:.2f}" == "3.10"
    assert str(published.value("setpoint_asked")) == "3 V"
    assert repr(published.value("period_s")) == "1 s"
    assert published.value("ticks") == 600
    assert published.value("output_load") == 2.9
    assert math.isnan(published.value("rounding") - published.value("reach_low"))
    gain = published.value("estimates")["gain"]
    assert (repr(gain), math.isnan(gain.std)) == ("0.0111 V/V", True)
    assert repr(Value(1.0, "rad/s", 0.034)) == "1 ± 0.034 rad/s"


def test_each_command_is_a_method_with_its_description(published: Published) -> None:
    drive = object.__new__(ConnectedDrive)
    drive.__dict__.update(_name="pump", _published=published)
    assert {*REQUESTS, *published.names} <= set(dir(drive))
    for verb, request in REQUESTS.items():
        method = getattr(drive, verb)
        assert callable(method)
        assert verb in {"setpoint", "waveform"} or method.__doc__ == request.__doc__


def test_an_old_value_is_refused(published: Published, clock: Clock) -> None:
    clock.now_s += 2.9
    assert published.value("output") == 3.1
    clock.now_s += 0.2
    published.problem = "connection refused"
    for name in ("output", "setpoint_asked", "reference"):
        with pytest.raises(NoAnswerError, match=r"pump: .* 3\.1 s old \(connection refused\)"):
            published.value(name)
    assert published.names == []
    published.problem = ""
    measure(published)
    assert published.value("output") == 3.1


def test_a_daemon_that_is_offline_has_no_values(published: Published) -> None:
    published.take("availability", {"availability": "offline"})
    with pytest.raises(NoAnswerError, match="its daemon is offline"):
        published.value("state")


@pytest.mark.parametrize(("behind_s", "fresh"), [(2.9, True), (3.2, False), (-3.2, False)])
def test_a_slow_period_of_an_earlier_run_is_old(
    published: Published, behind_s: float, fresh: bool
) -> None:
    """The broker keeps the last one; both times are by the clock of the drive."""
    measure(published, NOW + timedelta(seconds=behind_s))
    assert ("reference" in published.names) is fresh
    assert published.value("output") == 3.1
    if not fresh:
        with pytest.raises(NoAnswerError, match=r"-?3\.2 s ago: it does not run"):
            published.value("reference")


def test_a_slow_period_that_is_still_to_come_is_no_unknown_name(clock: Clock) -> None:
    made = Published("pump", clock)
    made.take("availability", {"availability": "online"})
    measure(made)
    for name in ("estimates", "output_load"):
        with pytest.raises(NoAnswerError, match="no slow period has passed yet"):
            made.value(name)
    with pytest.raises(KeyError):
        made.value("speeed")


def test_whatever_a_client_publishes_is_shown_without_harm(published: Published) -> None:
    state = {"state": "\x1b[2J", "output": {"unit": "\x07V"}, "manipulated": 3}
    published.take("state", state)
    now = {"time": NOW.isoformat()}
    content = {"estimates": {"gain": 7}, "reference": 10**400, "innovation": "<b>"}
    published.take("telemetry/load", now | content)
    published.take("telemetry/drive", now | {"output": 3.0, "output_name": "\x1b[2J"})
    drive = object.__new__(ConnectedDrive)
    drive.__dict__.update(_name="pump", _published=published)
    assert repr(drive) == "pump: ?[2J, ?[2J 3 ?V"
    assert repr(drive.estimates["gain"]) == "nan ?V/V"
    assert math.isnan(drive.reference)
    table = drive._repr_html_()
    assert table.isprintable()
    assert "<b>" not in table


def test_a_refusal_has_reason_kind_and_remedy() -> None:
    reply = contract.Reply("7", "enable", False, "it is tripped", State.TRIPPED, "over-voltage")
    with pytest.raises(RefusedError, match=r"it is tripped\nwhat to do: \w") as refused:
        accepted(reply)
    assert refused.value.kind == "over-voltage"
    assert refused.value.remedy in str(refused.value)
    later = contract.Reply("7", "enable", False, "no", None, "of-a-later-version")
    with pytest.raises(RefusedError, match=r"^no$"):
        accepted(later)
