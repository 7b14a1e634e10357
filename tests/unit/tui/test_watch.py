"""The live view: what it shows of given messages, its keys, and all of it in a real terminal."""

from __future__ import annotations

import asyncio
import os
import pty
import re
import sys
import termios
from datetime import UTC, datetime, timedelta
from typing import Any

import msgspec
import pytest
from rich.console import Console

from adaptdrive.mqtt.client import LIVE_S
from adaptdrive.mqtt.contract import Output, drive_message, encode, load_message
from adaptdrive.mqtt.publisher import KEYS
from adaptdrive.tui import view
from adaptdrive.tui.record import PlotPoint, WatchRecord, plot
from adaptdrive.tui.terminal import CONFIRM_S, DELIBERATE_S, KeyCommand, KeyReader, pressed_keys
from adaptdrive.tui.view import screen
from tests.unit.mqtt.peers import drive_report, load_report

NOW = datetime(2026, 1, 1, tzinfo=UTC)
SPEED = Output("speed", "V")
STATE = {
    "state": "running",
    "mode": "adaptive",
    "controller": "fixed",
    "reason": "warming up",
    "setpoint": 3.0,
    "waveform": None,
    "trip": None,
    "last_trip": None,
    "output": {"name": "speed", "unit": "V"},
    "limits": {"setpoint": [0.0, 4.0]},
}


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def received(payload: Any) -> dict[str, Any]:
    content = msgspec.json.decode(encode(payload))
    assert isinstance(content, dict)
    return content


def live_record(clock: Clock, **state: Any) -> WatchRecord:
    record = WatchRecord("motor", clock)
    record.take("availability", {"availability": "online"})
    record.take("state", STATE | state)
    record.take("telemetry/load", received(load_message(load_report(7), NOW, SPEED)))
    record.take("telemetry/drive", received(drive_message(drive_report(840), NOW, SPEED)))
    return record


def shown(record: WatchRecord, size: tuple[int, int] = (120, 40)) -> list[str]:
    console = Console(width=size[0], height=size[1], force_terminal=True, color_system=None)
    with console.capture() as capture:
        console.print(screen(record, size))
    return capture.get().splitlines()


@pytest.mark.parametrize("size", [(80, 24), (120, 40)])
def test_a_program_has_a_line(size: tuple[int, int]) -> None:
    text = "bath paused, step 3 of 5: hold for 7200 s"
    record = live_record(Clock(), program={"name": "bath", "text": text})
    record.take("telemetry/drive", record.fast | {"remaining_s": 9200.0})
    lines = shown(record, size)
    assert lines[1].rstrip() == f" program {text}, 2:33:20 left"
    assert len(lines) == size[1]


@pytest.mark.parametrize("size", [(80, 24), (120, 40)])
def test_the_view_fills_the_terminal_and_shows_units(size: tuple[int, int]) -> None:
    lines = shown(live_record(Clock()), size)
    text = "\n".join(lines)
    assert len(lines) == size[1]
    assert max(map(len, lines)) <= size[0]
    for expected in ("running", "speed in V", "3.10 V", "3.00 V", "0…4", "gain", "0.0111", "STOP"):
        assert expected in text
    assert "fixed controller in force, adaptive asked for" in text
    assert "OLD DATA" not in text


def test_a_gain_has_the_unit_of_the_output_for_each_volt() -> None:
    record = live_record(Clock(), output={"name": "speed", "unit": "rad/s"})
    assert "gain, (rad/s)/V" in "\n".join(shown(record))


def test_what_is_not_known_is_not_shown_as_a_value() -> None:
    """An estimate may be accepted because the loop hardly depends on one of its parameters."""
    record = live_record(Clock())
    load = {
        "gain": {"value": 116.9, "std": 0.1},
        "tau_product_s2": {"value": 45.1, "std": 201.0},
        "input_offset": {"value": 0.5, "std": None},
    }
    record.take("telemetry/load", record.load | {"estimates": load, "response_spread": 0.031})
    text = "\n".join(shown(record))
    assert re.search(r"gain.* 117 +0\.20", text)
    assert re.search(r"tau product.* not known", text)
    assert "45.1" not in text
    assert "402" not in text
    assert re.search(r"input offset.* 0\.500 +–", text)
    assert re.search(r"response +± 3\.1 %", text)


def test_80_columns_cut_no_label_no_value_and_no_key() -> None:
    record = live_record(Clock(), limits={"setpoint": [0.0, 4.5], "boost_V": [200.0, 400.0]})
    names = ("gain", "tau_sum_s", "tau_product_s2", "input_offset")
    load = {name: {"value": 116.939768, "std": 0.0976} for name in names}
    record.take("telemetry/load", record.load | {"estimates": load})
    record.take("simulator", dict.fromkeys(names, 117.01))
    record.take("telemetry/drive", record.fast | {"ticks": 1234567, "missed": 1234, "held": 12345})
    text = "\n".join(shown(record, (80, 24)))
    assert "…" not in text.replace("0…4.5", "").replace("200…400", "")
    for name in ("gain", "tau sum", "tau product", "input offset", "learned", "± 2 σ", "truth"):
        assert name in text
    assert text.count("117") == 8  # learned and true
    assert "missed 1234  held 12345 of 1234567" in text
    for key in view.KEYS:
        assert key in text
    assert "now" in text


def test_the_plot_goes_on_while_the_drive_is_off_and_while_nothing_is_heard() -> None:
    clock = Clock()
    record = live_record(clock, state="standby", setpoint=None)
    clock.now_s += 1.0
    later = (NOW + timedelta(seconds=1.0)).isoformat()
    record.take("telemetry/drive", record.fast | {"time": later, "output": 2.5})
    assert [point.controller for point in record.points] == ["off", "off"]
    clock.now_s += 20.0
    assert record.now_s == pytest.approx(NOW.timestamp() + 21.0)


def test_the_scale_follows_what_is_shown() -> None:
    old = [PlotPoint(1.0 * k, 100.0, 100.0, "fixed") for k in range(10)]
    new = [PlotPoint(100.0 + k, 3.0, 3.1, "fixed") for k in range(30)]
    assert (
        plot(old + new, (), 130.0, 30.0, (80, 12)).plain
        == plot(new, (), 130.0, 30.0, (80, 12)).plain
    )


def test_a_trip_is_shown_with_its_remedy() -> None:
    last = {"time": "x", "text": "over-voltage", "remedy": "look for a load that feeds back"}
    tripped = live_record(Clock(), trip="v = 9", trip_kind="over-voltage", last_trip=last)
    text = "\n".join(shown(tripped))
    assert "trip [over-voltage]: v = 9" in text
    cause = (
        "stale: measurement is 1005 ms old, limit 1000 ms; the oldest value is the voltage: mute"
    )
    lines = shown(live_record(Clock(), trip=cause, last_trip=last), (80, 24))
    assert cause in " ".join(line.strip() for line in lines[1:3])
    assert len(lines) == 24
    assert "remedy: look for a load that feeds back" in text


@pytest.mark.parametrize(
    ("stop", "words"), [("awaited", "standby   stop awaited"), ("confirmed", "standby   fixed")]
)
def test_a_drive_that_has_not_confirmed_its_stop_is_not_shown_as_off(stop: str, words: str) -> None:
    assert words in "\n".join(shown(live_record(Clock(), state="standby", stop=stop)))


def test_old_data_are_unmistakable() -> None:
    clock = Clock()
    record = live_record(clock)
    clock.now_s = LIVE_S + 0.1
    assert "OLD DATA" in shown(record, (80, 24))[0]
    record = live_record(Clock(), stop="missing")
    record.take("availability", {"availability": "offline"})
    assert "OLD DATA" in shown(record, (80, 24))[0]


@pytest.mark.parametrize(
    ("held_s", "passed_s", "old"),
    [(2.0, 0.5, False), (2.0, 1.5, True), (22.9, 0.0, True), (None, 0.0, False)],
)
def test_the_last_value_of_a_silent_drive_is_old(
    held_s: float | None, passed_s: float, old: bool
) -> None:
    clock = Clock()
    record = live_record(clock)
    record.take("telemetry/drive", record.fast | {"age_s": held_s})
    clock.now_s += passed_s
    assert ("OLD DATA" in "\n".join(shown(record))) is old


@pytest.mark.parametrize("hostile", ["\x1b[2J\x1b]0;x\x07", "[bold red]x[/]", "a\nb\nc"])
def test_text_of_a_payload_commands_no_terminal_and_no_markup(hostile: str) -> None:
    named = {"name": hostile, "unit": hostile}
    record = live_record(Clock(), trip=hostile, reason=hostile, controller=hostile, output=named)
    record.take("event", dict.fromkeys(("kind", "detail", "severity", "time"), hostile))
    record.take("telemetry/load", {"estimates": {hostile: {"value": 1.0, "std": None}}})
    lines = shown(record)
    assert len(lines) == 40
    assert "\x1b[2J" not in "".join(lines)
    assert "\x07" not in "".join(lines)
    assert ("bold red" in "".join(lines)) is ("bold" in hostile)


def test_messages_without_their_keys_do_no_harm() -> None:
    record = WatchRecord("motor", Clock())
    for name in ("state", "telemetry/load", "telemetry/drive", "event", "history", "other"):
        record.take(name, {})
    assert len(shown(record)) == 40


@pytest.mark.parametrize(
    "junk",
    [7, -1.7e308, "[/red]", [], [1, "x"], {"a": []}, 10**400, True],
    ids=lambda one: str(one)[:9],
)
def test_values_of_another_shape_do_no_harm(junk: Any) -> None:
    clock = Clock()
    clean = live_record(clock)
    record = WatchRecord("motor", clock)
    for name, content in (
        ("state", clean.state),
        ("telemetry/load", clean.load),
        ("telemetry/drive", clean.fast),
    ):
        record.take(name, dict.fromkeys([*content, "limits", "output", "last_trip"], junk))
    record.take("history", {"rows": [dict.fromkeys(KEYS, junk)]})
    assert len(shown(record)) == 40
    assert KeyReader(record).press("+") is None


def test_the_history_comes_before_what_is_known() -> None:
    record = live_record(Clock())
    rows = []
    for k in range(3):
        message = load_message(load_report(k), NOW - timedelta(seconds=30 - 10 * k), SPEED)
        rows.append({key: message[key] for key in KEYS})
    record.take("history", received({"rows": rows}))
    record.take("history", {"rows": [{"time": "never"}, 7, {"output": 1.0}]})
    times = [point.time_s - NOW.timestamp() for point in record.points]
    assert times == [-30.0, -20.0, -10.0, 0.0]


def test_keys_send_commands_and_enable_needs_two() -> None:
    clock = Clock()
    reader = KeyReader(live_record(clock))
    assert reader.press("s") == KeyCommand("disable")
    assert reader.press("S") == KeyCommand("disable")
    assert reader.press("m") == KeyCommand("mode", "manual")
    assert reader.press("+") == KeyCommand("setpoint", pytest.approx(3.04))
    assert reader.press("e") is None
    assert reader.press("x") is None
    assert reader.press("e") is None
    clock.now_s += DELIBERATE_S
    assert reader.press("e") == KeyCommand("enable")
    assert reader.press("e") is None
    clock.now_s += CONFIRM_S + 0.1
    assert reader.press("e") is None


@pytest.mark.parametrize("delay_s", [0.25, 0.66])
def test_a_key_that_is_held_is_one_press(delay_s: float) -> None:
    clock = Clock()
    reader = KeyReader(live_record(clock))
    assert reader.press("e") is None
    clock.now_s += delay_s
    for _ in range(100):
        assert reader.press("e") is None
        clock.now_s += 0.03
    clock.now_s += DELIBERATE_S
    assert reader.press("e") == KeyCommand("enable")


def test_keys_that_come_together_confirm_nothing() -> None:
    clock = Clock()
    reader = KeyReader(live_record(clock))
    assert reader.press("e") is None
    clock.now_s += DELIBERATE_S
    assert [reader.press(key, alone=False) for key in "ee"] == [None, None]
    assert reader.press("s", alone=False) == KeyCommand("disable")


async def test_a_key_without_a_letter_is_no_key_with_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """F4 comes as ESC O S, and `S` stops."""
    master, slave = pty.openpty()
    heard: list[str] = []
    with os.fdopen(slave) as terminal, monkeypatch.context() as process:
        process.setattr(sys, "stdin", terminal)
        with pressed_keys(heard.append):
            for keys in (b"\x1bOS", b"\x1b[15~", b"\x1b[A\x1b[As", b"q"):
                os.write(master, keys)
                known = len(heard)
                while len(heard) == known:  # noqa: ASYNC110 - a terminal sets no event
                    await asyncio.sleep(0.001)
    os.close(master)
    assert heard == ["", "", "s", "q"]


async def test_ctrl_z_is_a_key_while_a_view_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """After `fg` a shell would have each key, the one that stops among them, wait for an Enter."""
    master, slave = pty.openpty()

    def suspends() -> bool:
        return bool(termios.tcgetattr(slave)[6][termios.VSUSP] == b"\x1a")

    with os.fdopen(slave) as file, monkeypatch.context() as process:
        process.setattr(sys, "stdin", file)
        assert suspends()
        with pressed_keys(lambda _: None):
            assert not suspends()
        assert suspends()
    os.close(master)


def test_a_simulated_device_is_disturbed_by_the_digits_that_it_offers() -> None:
    record = live_record(Clock())
    add = {"text": "add a disk", "request": {"disks": 1}}
    reader = KeyReader(record)
    assert reader.press("1") is None
    assert "simulated plant" not in "\n".join(shown(record))
    record.take("simulator", {"features": [add, 7, {"text": "no request"}]})
    assert "simulated plant: 1 add a disk" in "\n".join(shown(record))
    assert reader.press("1") == KeyCommand("add a disk", disturbance={"disks": 1})
    assert reader.press("2") is None
    record.take("simulator", {})  # the device went away
    assert reader.press("1") is None


@pytest.mark.parametrize("key", ["+", "-"])
def test_a_waveform_is_not_left_for_a_set_point_of_before_it(key: str) -> None:
    wave = {"shape": "square", "low": 2.3, "high": 2.6, "period_s": 60.0}
    record = live_record(Clock(), setpoint=3.9, waveform=wave)
    assert KeyReader(record).press(key) is None
    assert "a waveform runs" in record.answer


def test_a_step_of_the_set_point_stays_in_its_range() -> None:
    record = live_record(Clock(), setpoint=3.99)
    assert KeyReader(record).press("+") == KeyCommand("setpoint", 4.0)
    record.state["limits"] = {}
    assert KeyReader(record).press("-") is None
