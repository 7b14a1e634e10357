"""What the command line says beside a refusal, and of payloads of another shape."""

from __future__ import annotations

import pytest

from adaptdrive.cli.display import describe, site_table
from adaptdrive.mqtt.client import DriveStatus, decoded

_STATE = (
    "state",
    "trip",
    "trip_kind",
    "last_trip",
    "output",
    "waveform",
    "setpoint",
    "pole",
    "since",
    "program",
)
_LOAD = ("estimates", "reference", "boost_reference_V", "k")
_DRIVE = ("output", "remaining_s", "age_s", "ticks", "load_power_W")


TRIPPED = {
    "state": "tripped",
    "trip": "over-voltage: v_bst = 431 V, limit 430 V",
    "trip_kind": "over-voltage",
    "last_trip": {
        "time": "2026-11-21T02:44:25.472279Z",
        "kind": "over-voltage",
        "text": "over-voltage: v_bst = 431 V, limit 430 V",
        "remedy": "look for a load that feeds back",
    },
}


def test_a_trip_is_shown_with_its_kind_and_its_remedy() -> None:
    lines = describe("motor", DriveStatus("online", TRIPPED, live=True)).splitlines()
    assert f"  trip        {TRIPPED['trip']}  [over-voltage]" in lines
    assert "  remedy      look for a load that feeds back" in lines
    table = site_table({"motor": DriveStatus("online", TRIPPED, live=True)})
    assert "motor: what to do: look for a load that feeds back  [over-voltage]" in table


@pytest.mark.parametrize(("left_s", "left"), [(9200.0, ", 2:33:20 left"), (None, "")])
def test_a_program_is_shown_with_its_step_and_what_is_left(left_s: float | None, left: str) -> None:
    text = "bath running, step 3 of 5: hold for 7200 s"
    state = {"state": "running", "program": {"name": "bath", "text": text}}
    telemetry = {"drive": {"remaining_s": left_s}}
    lines = describe("b", DriveStatus("online", state, telemetry, live=True)).splitlines()
    assert f"  program     {text}{left}" in lines


def test_the_last_trip_is_shown_with_its_kind() -> None:
    state = TRIPPED | {"state": "standby", "trip": None, "trip_kind": None}
    lines = describe("motor", DriveStatus("online", state, live=True)).splitlines()
    assert f"  last trip   2026-11-21T02:44:25Z: {TRIPPED['trip']}  [over-voltage]" in lines
    assert "what to do" not in site_table({"motor": DriveStatus("online", state, live=True)})


@pytest.mark.parametrize(
    "junk", [7, "text", [], [1, "x"], {"a": []}, 10**400, True], ids=lambda one: str(one)[:9]
)
def test_a_drive_with_values_of_another_shape_hides_no_other_drive(junk: object) -> None:
    telemetry = {"load": dict.fromkeys(_LOAD, junk), "drive": dict.fromkeys(_DRIVE, junk)}
    odd = DriveStatus("online", dict.fromkeys(_STATE, junk), telemetry, live=True)
    state = {"state": "running", "output": {"unit": "V"}, "setpoint": 3.0}
    good = DriveStatus("online", state, live=True)
    table = site_table({"odd": odd, "good": good})
    assert "good   running" in table
    assert "3 V" in table
    assert describe("odd", odd).startswith("odd is online")


@pytest.mark.parametrize(
    ("age_s", "output"), [(0.004, "2.84 V"), (2.9, "2.84 V"), (3.1, "-"), (22.9, "-"), (None, "-")]
)
def test_the_list_shows_no_output_that_is_old(age_s: float | None, output: str) -> None:
    state = {"state": "standby", "output": {"unit": "V"}, "setpoint": 3.0}
    telemetry = {"drive": {"output": 2.84, "age_s": age_s}}
    row = site_table({"motor": DriveStatus("online", state, telemetry, live=True)}).splitlines()[1]
    assert row.startswith(f"motor  standby  {output}  ")


@pytest.mark.parametrize(
    "payload", [b"", b"[", b'{"a":"\xff"}', b'{"a":' + 4000 * b"[", b"7", b"\xff"], ids=repr
)
def test_a_payload_that_is_no_json_object_is_nothing(payload: bytes) -> None:
    assert decoded(payload, dict[str, object]) is None


def test_a_gain_has_the_unit_of_the_output_for_each_volt() -> None:
    telemetry = {"load": {"estimates": {"gain": {"value": 0.30715, "std": 0.0066}}}}
    state = {"state": "running", "output": {"name": "speed", "unit": "rad/s"}}
    text = describe("fan", DriveStatus("online", state, telemetry, live=True))
    assert "gain 0.30715 ± 0.0066 (rad/s)/V" in text


def test_no_word_of_a_broker_reaches_the_terminal_as_a_control_character() -> None:
    status = DriveStatus("\x1b[31mred", {}, live=True)
    assert "\x1b" not in describe("motor", status)


@pytest.mark.parametrize(
    ("name", "row"),
    [
        ("speed", "  speed       10.1 K"),
        ("over-temperature", "  over-temperature 10.1 K"),
        ("\x1b[2Jred", "  ?[2Jred     10.1 K"),
    ],
)
def test_the_name_of_an_output_is_apart_from_its_value_and_commands_no_terminal(
    name: str, row: str
) -> None:
    telemetry = {"drive": {"output": 10.1, "output_name": name}}
    state = {"state": "running", "output": {"name": name, "unit": "K"}}
    text = describe("oven", DriveStatus("online", state, telemetry, live=True))
    assert row in text.splitlines()


@pytest.mark.parametrize("word", ["awaited", "missing", "cannot be confirmed"])
def test_a_drive_that_has_not_reported_its_bridge_off_is_not_shown_as_off(word: str) -> None:
    state = {"state": "standby", "stop": word}
    text = describe("oven", DriveStatus("online", state, live=True))
    assert f"  stop        {word}: the drive has not reported its bridge off" in text.splitlines()
    table = site_table({"oven": DriveStatus("online", state, live=True)})
    assert f"oven   standby, stop {word}  " in table


@pytest.mark.parametrize("word", ["confirmed", None])
def test_a_stop_is_shown_only_where_it_is_not_confirmed(word: str | None) -> None:
    state = {"state": "standby", "stop": word}
    text = describe("oven", DriveStatus("online", state, live=True))
    assert "reported its bridge" not in text
    assert "oven   standby  " in site_table({"oven": DriveStatus("online", state, live=True)})
