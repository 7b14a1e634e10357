"""The live view of a given record: what it says, and that it fits the terminal."""

from __future__ import annotations

from dataclasses import replace

import pytest
from rich.console import Console

from adaptdrive_sim.demo.record import DemoRecord
from adaptdrive_sim.demo.view import ViewContext, screen
from tests.demo.stories import BEGAN, Clock, event, state, steady_record

AROUND = ViewContext(
    bus="udp_multicast 239.74.163.2:41000",
    broker="127.0.0.1:42000",
    program=".venv/bin/adaptdrive",
    duration_s=None,
    longest_window_s=120.0,
)
SIZES = [(80, 24), (120, 40)]


def shown(record: DemoRecord, size: tuple[int, int], around: ViewContext = AROUND) -> list[str]:
    console = Console(width=size[0], height=size[1], force_terminal=True, color_system=None)
    with console.capture() as capture:
        console.print(screen(record, around, size))
    return capture.get().splitlines()


@pytest.mark.parametrize("size", SIZES)
def test_fills_the_terminal_and_not_more(size: tuple[int, int]) -> None:
    lines = shown(steady_record(100), size)
    assert len(lines) == size[1]
    assert max(map(len, lines)) <= size[0]


@pytest.mark.parametrize("size", SIZES)
def test_shows_control_in_figures(size: tuple[int, int]) -> None:
    text = "\n".join(shown(steady_record(100, output=3.0125), size))
    for expected in ("running", "3.013 V", "3.000 V", "281 / 280 V", "1:40"):
        assert expected in text
    assert "fixed controller in force" in text


def test_shows_lateness_and_losses() -> None:
    text = " ".join("\n".join(shown(steady_record(50), (120, 40))).split())
    assert "late p50/p99/max, ms 0.1/1.5/1.5" in text
    assert "ticks missed/held 0/0 of 6000" in text


@pytest.mark.parametrize("size", SIZES)
def test_compares_estimates_with_the_truth(size: tuple[int, int]) -> None:
    text = "\n".join(shown(steady_record(10), size))
    assert "33.4" in text  # τm + τf of two disks: 2 * 11.7 s + 10 s
    assert "+0.0%" in text
    assert "2.00" in text  # disks that the estimates amount to


@pytest.mark.parametrize("size", SIZES)
def test_says_where_it_is_and_how_to_operate(size: tuple[int, int]) -> None:
    text = "\n".join(shown(steady_record(10), size))
    assert "bus udp_multicast 239.74.163.2:41000" in text
    assert ".venv/bin/adaptdrive mode motor adaptive --broker 127.0.0.1:42000" in text
    assert "Ctrl-C" in text


def test_a_tall_terminal_shows_the_plain_mqtt_command_too() -> None:
    text = "\n".join(shown(steady_record(10), (120, 40)))
    assert "mosquitto_pub -h 127.0.0.1 -p 42000 -t adaptdrive/motor/command/setpoint" in text


@pytest.mark.parametrize("size", SIZES)
def test_says_why_the_other_controller_is_in_force(size: tuple[int, int]) -> None:
    record = steady_record(10)
    record.hear_state(state(mode="adaptive", reason="warming up"))
    text = "\n".join(shown(record, size))
    assert "fixed controller in force, adaptive asked for: warming up" in text
    assert "mode motor fixed" in text  # the hint offers the other mode


@pytest.mark.parametrize("size", SIZES)
def test_shows_a_trip_with_its_cause(size: tuple[int, int]) -> None:
    record = steady_record(10)
    record.hear_state(state(state="tripped", trip="stale: no measurement for 61 ms"))
    record.hear_event(event("stale: no measurement for 61 ms", "trip", "alarm"))
    text = "\n".join(shown(record, size))
    assert "tripped" in text
    assert text.count("stale: no measurement for 61 ms") == 2  # above, and among the events
    assert "adaptdrive reset motor" in text
    assert "What to do: " in text


def test_shows_the_last_events_only() -> None:
    record = steady_record(5)
    for number in range(20):
        record.hear_event(event(f"event number {number}"))
    text = "\n".join(shown(record, (120, 40)))
    assert "event number 19" in text
    assert "event number 15" in text
    assert "event number 1 " not in text


def test_shows_that_the_broker_is_lost() -> None:
    record = steady_record(5)
    record.connected = False
    assert "broker not heard" in shown(record, (80, 24))[0]


@pytest.mark.parametrize("size", [*SIZES, (40, 12), (20, 5)])
def test_knows_nothing_yet_and_has_no_room(size: tuple[int, int]) -> None:
    lines = shown(DemoRecord(BEGAN, Clock()), size)
    assert len(lines) == size[1]
    assert "starting" in lines[0]


@pytest.mark.parametrize("size", SIZES)
def test_shows_the_address_of_the_panel(size: tuple[int, int]) -> None:
    around = replace(AROUND, panel="http://127.0.0.1:8088/?broker=ws://127.0.0.1:8083/mqtt")
    lines = shown(steady_record(10), size, around)
    assert len(lines) == size[1]
    assert any("http://127.0.0.1:8088/?broker=ws://127.0.0.1:8083/mqtt" in line for line in lines)
