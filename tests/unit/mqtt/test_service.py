"""The MQTT contract of a service, in virtual time; scenes hold it against mosquitto."""

from __future__ import annotations

import asyncio
import json
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.config.services import Mqtt
from adaptdrive.control.signals import Mode, Shape, Waveform
from adaptdrive.mqtt.contract import Synchronisation
from adaptdrive.mqtt.service import MqttService, OperatorLog
from adaptdrive.runtime.reports import Event, Severity, State
from adaptdrive.runtime.requests import (
    Disable,
    Enable,
    Request,
    Reset,
    SetMode,
    SetPole,
    SetSetpoint,
    SetVoltage,
    SetWaveform,
)
from adaptdrive.safety.trips import Trip, TripKind
from tests.unit.mqtt.memory_broker import MemoryBroker
from tests.unit.mqtt.peers import (
    OVER_VOLTAGE,
    STANDBY,
    Bench,
    Heard,
    RememberingHost,
    ask,
    drive_report,
    expect_retained,
    listening,
    load_report,
    profile,
    publish,
    serving,
)
from tests.virtual_time import virtual_time

SQUARE = {"shape": "square", "low": 3.0, "high": 3.2, "period_s": 120}


@pytest.mark.parametrize(
    ("verb", "value", "request_"),
    [
        ("setpoint", 3, SetSetpoint(3.0)),
        ("setpoint", 2.5, SetSetpoint(2.5)),
        ("waveform", SQUARE, SetWaveform(Waveform(Shape.SQUARE, 3.0, 3.2, 120.0))),
        ("waveform", None, SetWaveform(None)),
        ("waveform", "off", SetWaveform(None)),
        ("mode", "adaptive", SetMode(Mode.ADAPTIVE)),
        ("mode", "manual", SetMode(Mode.MANUAL)),
        ("voltage", 280, SetVoltage(280.0)),
        ("pole", 0.8, SetPole(0.8)),
        ("enable", None, Enable()),
        ("disable", None, Disable()),
        ("reset", None, Reset()),
    ],
)
async def test_a_command_acts_and_is_answered(
    bench: Bench, verb: str, value: object, request_: Request
) -> None:
    reply = await ask(bench, verb, json.dumps({"id": "a", "value": value}))
    state = "running" if verb == "enable" else "standby"
    told = {"id": "a", "verb": verb, "accepted": True, "reason": "", "state": state}
    assert reply == told | {"trip_kind": None}
    assert bench.host.asked == [request_]


@pytest.mark.parametrize(
    ("verb", "payload", "reason"),
    [
        ("setpoint", '{"id": "x", "value": NaN}', "not a finite number"),
        ("setpoint", '{"id": "x", "value": -Infinity}', "not a finite number"),
        ("setpoint", '{"id": "x", "value": 1e999}', "not a finite number"),
        ("setpoint", '{"id": "x", "value": 1%s}' % ("0" * 400), "out of range"),
        ("setpoint", '{"id": "x", "value": "3"}', "Expected `float`, got `str` - at `value`"),
        ("setpoint", '{"id": "x", "value": true}', "got `bool`"),
        ("setpoint", '{"id": "x", "value": null}', "got `null`"),
        ("setpoint", '{"id": "x"}', "missing required field `value`"),
        ("setpoint", '{"id": "x", "value": 3, "speed": 4}', "unknown field `speed`"),
        ("setpoint", '{"id": "x", "value": 9.0}', "setpoint 9.0 is outside 0…4.0"),
        ("setpoint", '{"id": "x", "value": 3, "expires": "2001-01-01T00:00:00Z"}', "expired"),
        ("setpoint", '{"id": "x", "value": 3, "expires": "2099-01-01T00:00:00"}', "timezone"),
        ("setpoint", '{"id": "x", "value": 3, "expires": "tomorrow"}', "RFC3339"),
        ("setpoint", '{"id": "x", "value": 3, "expires": 4102444800}', "got `int`"),
        ("setpoint", '{"id": "x", value: 3}', "not JSON"),
        ("setpoint", '{"id": "x", "value": 3, "value": 4}', "the key 'value' is there twice"),
        ("setpoint", '{"id": "x", "value": ', "not JSON"),
        ("setpoint", b'{"id": "x", "value": "\xff"}', "not JSON"),
        ("setpoint", '{"id": "x", "value": %s' % ("[" * 5000), "not JSON"),
        ("setpoint", '{"id": "x", "value": "%s"}' % ("v" * 17_000), "at most 16384"),
        ("mode", '{"id": "x", "value": "\\u001b[2J"}', r"'\x1b[2J'"),
        ("mode", '{"id": "x", "\\u001b": 1, "value": "fixed"}', "unknown field `?`"),
        ("setpoint", '{"id": "x", "value": {"\\ud800": "\\u001b[2J"}}', "got `object`"),
        ("setpoint", '{"id": "x", "\\ud800\\u001b": 1, "value": 1}', "lone surrogate"),
        ("mode", '{"id": "x", "value": "wild"}', "Invalid enum value 'wild'"),
        ("pole", '{"id": "x", "value": [0.7]}', "got `array`"),
        ("enable", '{"id": "x", "value": 1}', "Expected `null`"),
        ("waveform", '{"id": "x", "value": {"shape": "square"}}', "missing required field"),
        ("waveform", '{"id": "x", "value": {"shape": "saw"}}', "Invalid enum value 'saw'"),
        ("waveform", json.dumps({"id": "x", "value": SQUARE | {"duty": 1}}), "unknown field"),
        ("waveform", json.dumps({"id": "x", "value": SQUARE | {"low": float("nan")}}), "value.low"),
        ("waveform", '{"id": "x", "value": "on"}', "Invalid enum value 'on'"),
        ("explode", '{"id": "x"}', "unknown verb 'explode'; known are setpoint"),
        ("Ping", '{"id": "x"}', "reset, ping"),
        ("setpoint/more", '{"id": "x", "value": 3}', "unknown verb 'setpoint/more'"),
        ("", '{"id": "x", "value": 3}', "unknown verb ''"),
    ],
)
async def test_a_command_that_breaks_a_rule_is_refused_and_changes_nothing(
    bench: Bench, verb: str, payload: str | bytes, reason: str
) -> None:
    reply = await ask(bench, verb, payload)
    assert reason in reply.pop("reason")
    told = {"id": "x", "verb": verb, "accepted": False, "state": "standby"}
    assert reply == told | {"trip_kind": None}
    assert bench.host.asked == []


async def test_a_repeat_acts_once_and_hears_the_first_reply(bench: Bench) -> None:
    first = await ask(bench, "setpoint", '{"id": "a", "value": 1}')
    bench.host.show(replace(bench.host.report, state=State.RUNNING))
    assert await ask(bench, "setpoint", '{"id": "a", "value": 1}') == first
    assert bench.host.asked == [SetSetpoint(1.0)]


async def test_ids_are_remembered_across_restarts(broker: MemoryBroker, tmp_path: Path) -> None:
    async with serving(broker, "memory", tmp_path) as bench:
        accepted = await ask(bench, "setpoint", '{"id": "a", "value": 1}')
        refused = await ask(bench, "setpoint", '{"id": "b", "value": 99}')
    async with serving(broker, "memory", tmp_path) as bench:
        bench.host.highest = 100.0
        assert await ask(bench, "setpoint", '{"id": "a", "value": 1}') == accepted
        assert await ask(bench, "setpoint", '{"id": "b", "value": 99}') == refused
        assert bench.host.asked == []


async def test_the_state_is_retained_and_follows_every_change(bench: Bench) -> None:
    async with listening(bench.broker, bench.topic("state")) as ear:
        first = await ear.on(bench.topic("state"))
        assert first.retained
        assert first.qos == 1
        wave = Waveform(Shape.SQUARE, 3.0, 3.2, 120.0)
        bench.host.show(replace(STANDBY, trip="stale", waveform=wave, setpoint=float("nan")))
        second = (await ear.on(bench.topic("state"))).content
    assert second["output"] == {"name": "speed", "unit": "V", "display": None}
    assert second["limits"] == {"setpoint": [0.0, 4.0], "power_W": [None, 900.0]}
    assert second["modes"] == [mode.value for mode in Mode]
    assert (second["drive"], second["version"]) == (bench.drive, "9")
    assert second["waveform"] == SQUARE
    assert second["setpoint"] is None
    assert second["trip"] == "stale"
    assert datetime.fromisoformat(second["time"]) >= datetime.fromisoformat(first.content["time"])
    assert second["time"].endswith("Z")


@pytest.mark.parametrize("word", list(Synchronisation))
async def test_the_state_says_whether_the_clock_can_be_trusted(
    broker: MemoryBroker, tmp_path: Path, word: Synchronisation
) -> None:
    async with (
        serving(broker, f"clock-{word}", tmp_path, synchronisation=lambda: word) as bench,
        listening(broker, bench.topic("state")) as ear,
    ):
        await ear.until(lambda message: message.content["clock"] == word.value)


async def test_telemetry_is_json_with_name_and_unit_of_the_output(bench: Bench) -> None:
    async with listening(bench.broker, bench.topic("telemetry/+")) as ear:
        bench.hub.publish(load_report(7))
        bench.hub.publish(drive_report(840))
        load = await ear.on(bench.topic("telemetry/load"))
        drive = await ear.on(bench.topic("telemetry/drive"))
    assert not drive.retained
    assert (load.qos, drive.qos) == (0, 0)
    assert (load.content["output_name"], load.content["output_unit"]) == ("speed", "V")
    assert drive.content["sensors"] == {
        "thermocouples": {
            "up": False,
            "detail": "unplugged",
            "values": {"hot": 310.0},
            "age_s": {"hot": 1.5},
            "bus": {"timeouts": 3},
        }
    }
    assert load.content["estimates"] == {"gain": {"value": 0.0111, "std": None}}
    assert drive.content["lateness_us"] == {"p50": 10.0, "p99": 20.0, "max": 30.0}
    assert drive.content["turnaround_us"] == {"p50": None, "p99": None, "max": None}
    assert drive.content["command"] == {
        "current_scale_S": 0.0,
        "boost_reference_V": 0.0,
        "bridge": False,
    }


async def test_a_late_listener_receives_the_last_slow_step_and_the_histograms(bench: Bench) -> None:
    async with listening(bench.broker, bench.topic("telemetry/#")) as ear:
        bench.hub.publish(load_report(7))
        bench.hub.publish(drive_report(840))
        await ear.on(bench.topic("telemetry/load"))
        await ear.on(bench.topic("telemetry/histograms"))
    async with listening(bench.broker, bench.topic("telemetry/#")) as late:
        load = await late.on(bench.topic("telemetry/load"))
        late.start_over("none")
        histograms = await late.on(bench.topic("telemetry/histograms"))
    assert (load.retained, load.content["k"]) == (True, 7)
    assert histograms.retained
    assert histograms.content["tick_us"] == [0, 2, 1]


async def test_since_is_the_time_of_the_state_not_of_any_change(
    broker: MemoryBroker, tmp_path: Path
) -> None:
    start, passed_s = datetime(2026, 1, 1, tzinfo=UTC), 0.0
    wall = lambda: start + timedelta(seconds=passed_s)  # noqa: E731
    async with (
        serving(broker, "since", tmp_path, wall=wall) as bench,
        listening(broker, bench.topic("state")) as ear,
    ):
        passed_s = 10.0
        bench.host.show(replace(STANDBY, state=State.RUNNING))
        await ear.until(lambda message: message.content["state"] == "running")
        passed_s = 20.0
        bench.host.show(replace(STANDBY, state=State.RUNNING, setpoint=2.0))
        state = (await ear.until(lambda message: message.content["setpoint"] == 2.0)).content
    assert datetime.fromisoformat(state["since"]) == start + timedelta(seconds=10)
    assert datetime.fromisoformat(state["time"]) == start + timedelta(seconds=20)


async def test_the_last_trip_stays_with_its_remedy_after_a_reset(bench: Bench) -> None:
    async with listening(bench.broker, bench.topic("state")) as ear:
        first = (await ear.on(bench.topic("state"))).content
        bench.host.trip(OVER_VOLTAGE)
        tripped = (await ear.until(lambda message: message.content["trip"])).content
        bench.host.show(STANDBY)
        reset = (await ear.until(lambda message: not message.content["trip"])).content
    assert first["last_trip"] is None
    assert tripped["last_trip"] == reset["last_trip"]
    assert (first["trip_kind"], tripped["trip_kind"]) == (None, "over-voltage")
    assert tripped["last_trip"]["text"] == OVER_VOLTAGE.text
    assert tripped["last_trip"]["kind"] == "over-voltage"
    assert "wrong capacitance" in tripped["last_trip"]["remedy"]
    assert tripped["last_trip"]["time"] == tripped["since"]


async def test_the_last_trip_survives_a_restart(broker: MemoryBroker, tmp_path: Path) -> None:
    trip = Event("trip", Severity.ALARM, OVER_VOLTAGE.text, 1, OVER_VOLTAGE.kind)

    def tripped(message: Heard) -> bool:
        return message.content["last_trip"] is not None

    async with (
        serving(broker, "tripped", tmp_path) as bench,
        listening(bench.broker, bench.topic("state")) as ear,
    ):
        bench.host.trip(OVER_VOLTAGE)
        bench.hub.publish(trip)  # as the runtime does
        before = (await ear.until(tripped)).content["last_trip"]
    async with (
        serving(broker, "tripped", tmp_path) as bench,
        listening(bench.broker, bench.topic("state")) as ear,
    ):
        first = (await ear.until(tripped)).content
        for key in ("kind", "text", "remedy"):
            assert first["last_trip"][key] == before[key]
        assert first["state"] == "standby"
        bench.host.trip(Trip(TripKind.STALE, "stale: measurement is 54 ms old, limit 50 ms"))
        second = await ear.until(lambda message: message.content["trip"])
        assert second.content["last_trip"]["text"].startswith("stale")
        assert second.content["last_trip"]["kind"] == "stale"


async def test_telemetry_names_the_kind_of_the_latched_trip_until_it_is_reset(bench: Bench) -> None:
    async with listening(bench.broker, bench.topic("telemetry/drive")) as ear:

        async def kind_at(ticks: int) -> object:
            bench.hub.publish(drive_report(ticks))
            told = await ear.until(lambda message: message.content["ticks"] == ticks)
            return told.content["trip_kind"]

        before = await kind_at(1)
        bench.host.trip(OVER_VOLTAGE)
        tripped = await kind_at(2)
        bench.host.show(STANDBY)
        after = await kind_at(3)
    assert (before, tripped, after) == ("none", "over-voltage", "none")


async def test_the_event_of_a_trip_names_its_kind_and_its_remedy(bench: Bench) -> None:
    async with listening(bench.broker, bench.topic("event")) as ear:
        bench.hub.publish(
            Event("trip", Severity.ALARM, "over-voltage: 431 V", 1, OVER_VOLTAGE.kind)
        )
        bench.hub.publish(Event("bus", Severity.WARNING, "over-voltage: 431 V", 1))
        trip = await ear.until(lambda message: message.content["kind"] == "trip")
        other = await ear.until(lambda message: message.content["kind"] == "bus")
    assert trip.content["trip_kind"] == "over-voltage"
    assert "wrong capacitance" in trip.content["remedy"]
    assert (other.content["trip_kind"], other.content["remedy"]) == (None, "")


async def test_the_fast_loop_is_heard_at_most_ten_times_a_second(bench: Bench) -> None:
    loop = asyncio.get_running_loop()
    async with listening(bench.broker, bench.topic("telemetry/drive")) as ear:
        start = loop.time()
        for ticks in range(100):
            bench.hub.publish(drive_report(ticks))
            await asyncio.sleep(0.01)
        bench.hub.publish(drive_report(1000))
        await ear.until(lambda message: message.content["ticks"] == 1000)
        assert 2 <= len(ear.heard) <= 2 + 10 * (loop.time() - start)


async def test_every_slow_period_is_heard(bench: Bench) -> None:
    async with listening(bench.broker, bench.topic("telemetry/load")) as ear:
        for k in range(10):
            bench.hub.publish(load_report(k))
        await ear.until(lambda message: message.content["k"] == 9)
    assert [message.content["k"] for message in ear.heard] == list(range(10))


async def test_an_orderly_stop_sends_what_is_left_and_says_offline(
    broker: MemoryBroker, tmp_path: Path
) -> None:
    async with listening(broker, "adaptdrive/stop/#") as ear:
        async with serving(broker, "stop", tmp_path) as bench:
            bench.hub.publish(Event("stop", Severity.INFO, "told to stop", 1))
            bench.host.show(replace(STANDBY, reason="told to stop"))
        await ear.until(lambda message: message.payload == "offline")
    topics = [message.topic.rpartition("/")[2] for message in ear.heard]
    assert topics[-1] == "availability"
    assert "event" in topics
    states = [message for message in ear.heard if message.topic.endswith("state")]
    assert states[-1].content["reason"] == "told to stop"
    await expect_retained(bench, "availability", "offline")


def _junk() -> st.SearchStrategy[bytes]:
    scalars = st.none() | st.booleans() | st.integers() | st.floats() | st.text()
    keys = st.sampled_from(["id", "value", "expires", "shape", "low"]) | st.text()
    documents = st.recursive(scalars, lambda some: st.lists(some) | st.dictionaries(keys, some))
    return st.binary() | documents.map(lambda document: json.dumps(document).encode())


@given(st.lists(st.tuples(st.sampled_from(["setpoint", "waveform", "mode", "x"]), _junk())))
def test_junk_never_stops_the_service(junk: list[tuple[str, bytes]]) -> None:
    async def scenario() -> None:
        broker, host = MemoryBroker(), RememberingHost(highest=-1.0)
        service = MqttService(profile("junk"), Mqtt(), host, host.hub, OperatorLog())
        with broker.joined():
            running = asyncio.create_task(service.run())
            await asyncio.sleep(1.0)
            for verb, payload in junk:
                await publish(broker, f"adaptdrive/junk/command/{verb}", payload)
            await publish(broker, "adaptdrive/junk/command/reset", '{"id": "still here"}')
            await asyncio.sleep(1.0)
            assert not running.done()
            running.cancel()
            await asyncio.wait([running])
        assert Reset() in host.asked

    with virtual_time() as runner:
        runner.run(scenario())
