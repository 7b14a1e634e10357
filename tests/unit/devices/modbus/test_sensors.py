"""Sensors on Modbus, whose wire a test spoils: nothing is used that was not measured."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import struct
from collections.abc import AsyncIterator, Mapping
from collections.abc import Set as AbstractSet
from typing import Any

import pytest

from adaptdrive.config.root import ModbusRtuSensors, ModbusTcpSensors
from adaptdrive.devices.description import NO_DEMANDS, Demands
from adaptdrive.devices.modbus import SELDOM_CYCLES, SensorPort, build_modbus_sensors
from adaptdrive.util.errors import ConfigurationError
from tests.unit.devices.bench import SensorEar, until
from tests.unit.devices.modbus.bench import Peer, untouched

pytestmark = pytest.mark.usefixtures("memory")
KINDS = pytest.mark.parametrize("kind", ["tcp", "rtu"])
CYCLE_s = 0.1
COMMON = {
    "name": "bench",
    "cycle_s": CYCLE_s,
    "timeout_s": 0.08,
    "turnaround_s": 0.001,
    "registers": {
        "speed": {"address": 3, "table": "input", "type": "float32"},
        "number": {"address": 2, "table": "input"},
        "voltage": {
            "address": 0,
            "table": "input",
            "scale": 0.01,
            "range": {"low": 0.0, "high": 600.0},
        },
    },
    "signals": {
        "speed": {"signal": "speed", "unit": "rpm"},
        "number": {"signal": "number"},
        "voltage": {"signal": "voltage"},
    },
}
RPM = 0.10471975511965977
TCP = {"type": "modbus-tcp", "host": "127.0.0.1"}
RTU = {"type": "modbus-rtu", "device": "/dev/drive.tty", "baud": 115200, "form": "8N1"}


def build(given: Mapping[str, object], demands: Demands | None = None) -> SensorPort:
    """Build the port of sensors."""
    kind = ModbusTcpSensors if given["type"] == "modbus-tcp" else ModbusRtuSensors
    config = kind.model_validate(COMMON | dict(given))
    clock = asyncio.get_running_loop().time
    return build_modbus_sensors(config, "sensor_bus.2", clock, demands=demands or NO_DEMANDS)


class Bench:
    def __init__(self, peer: Peer, port: SensorPort, ear: SensorEar) -> None:
        self.peer = peer
        self.port = port
        self.ear = ear

    def check_honesty(self) -> None:
        """No value is said to be younger than it is, and none was never measured."""
        for values, taken_s, heard_s in self.ear.heard:
            if "number" in values:
                assert taken_s <= self.peer.taken[round(values["number"])] <= heard_s
            if "speed" in values:
                assert values["speed"] == pytest.approx(3.25 * RPM)


@contextlib.asynccontextmanager
async def bench(
    kind: str, *, there: bool = True, dead: AbstractSet[int] = frozenset(), **changes: object
) -> AsyncIterator[Bench]:
    peer, ear = Peer(kind), SensorEar()
    link = TCP | {"port": peer.address} if kind == "tcp" else RTU
    port = build(link | changes)
    peer.devices, peer.dead = {1, 2, 3, 4}, set(dead)
    if there:
        peer.start()
    task = asyncio.create_task(port.run(ear))
    try:
        yield Bench(peer, port, ear)
    finally:
        task.cancel()
        (outcome,) = await asyncio.gather(task, return_exceptions=True)
        peer.stop()
    assert isinstance(outcome, asyncio.CancelledError)


@KINDS
async def test_values_come_in_si_and_as_old_as_their_request(kind: str) -> None:
    async with bench(kind) as one:
        await one.ear.hears(10)
        assert one.ear.latest["voltage"] == pytest.approx(300.12)
        one.check_honesty()
        assert one.ear.bus == []
        assert one.peer.writes == []


@pytest.mark.parametrize("speed", [float("nan"), float("inf"), -float("inf")])
async def test_a_value_that_is_none_is_left_out_alone(speed: float) -> None:
    async with bench("tcp") as one:
        one.peer.speed = speed
        await one.ear.hears(3)
        assert set(one.ear.latest) == {"number", "voltage"}
        one.peer.speed, one.peer.voltage = 3.25, 60001
        await one.ear.hears(3)
        assert set(one.ear.latest) == {"number", "speed"}
        assert one.port.statistics.out_of_range >= 3
        one.check_honesty()


@KINDS
async def test_a_bus_that_is_not_there_is_told_waited_for_and_found_again(kind: str) -> None:
    async with bench(kind, there=False) as one:
        await until(lambda: bool(one.ear.bus))
        reason = "no connection" if kind == "tcp" else "no such serial port"
        assert reason in one.ear.bus[0][1]
        one.peer.start()
        await one.ear.hears(3)
        one.peer.stop()
        await until(lambda: len(one.ear.bus) == 3)
        one.peer.start()
        await one.ear.hears(3)
        assert [up for up, _ in one.ear.bus] == [False, True, False, True]
        assert one.port.statistics.reconnects >= 1
        one.check_honesty()


THREE_BLOCKS = {"voltage": 0, "number": 2, "state": 5}
ONE_BLOCK = {"number": 2}


def modules(*devices: int, blocks: Mapping[str, int] = THREE_BLOCKS) -> dict[str, Any]:
    """Modules with a block of one register each; `number` of device 2 is `number_2`."""
    registers = {
        f"{name}_{device}": {"address": address, "table": "input", "device_id": device}
        for device in devices
        for name, address in blocks.items()
    }
    signals = {name: {"signal": name} for name in registers}
    return {"registers": registers, "signals": signals, "max_gap": 0}


def hears_of(one: Bench, device: int) -> int:
    """How many samples of a device have come."""
    return sum(f"number_{device}" in values for values, *_ in one.ear.heard)


@pytest.mark.parametrize("timeout_s", [0.08, 0.02])
@pytest.mark.parametrize("living", [1, 2, 4])
async def test_silent_modules_behind_a_gateway_leave_the_living_one_and_the_link_alone(
    living: int, timeout_s: float
) -> None:
    given = modules(1, 2, 3, 4) | {"timeout_s": timeout_s}
    async with bench("tcp", dead={1, 2, 3, 4} - {living}, **given) as one:
        await until(lambda: hears_of(one, living) >= 30 or len(one.ear.bus) > 0)
        assert one.ear.bus == []
        assert one.peer.connections == 1


async def test_a_gateway_behind_which_no_module_answers_is_connected_anew() -> None:
    async with bench("tcp", **modules(1, 2)) as one:
        await until(lambda: hears_of(one, 1) >= 3)
        one.peer.dead = {1, 2}
        await until(lambda: bool(one.ear.bus))
        assert "requests in a row" in one.ear.bus[0][1]
        one.peer.dead = set()
        await until(lambda: one.ear.bus[-1][0])
        assert one.port.statistics.reconnects >= 1


async def test_a_missing_reply_of_a_silent_module_keeps_no_living_one_waiting_for_another() -> None:
    async with bench("rtu", **modules(1, 2)) as one:
        await until(lambda: hears_of(one, 1) >= 3)
        one.peer.dead = {2}
        first = len(one.peer.asked)
        await until(lambda: one.peer.asked[first:].count(2) >= 11)
        asked = one.peer.asked[first:]
        assert (2, 2) not in list(itertools.pairwise(asked[asked.index(2) :]))


async def test_a_silent_module_is_asked_seldom_and_found_again() -> None:
    given = modules(1, 2, blocks=ONE_BLOCK)
    async with bench("rtu", dead={1}, **given) as one:
        await until(lambda: one.peer.asked.count(1) >= 5)
        asked = one.peer.asked
        last = len(asked) - 1 - asked[::-1].index(1)
        before = last - 1 - asked[:last][::-1].index(1)
        assert asked[before + 1 : last].count(2) == SELDOM_CYCLES
        assert hears_of(one, 1) == 0
        one.peer.dead = set()
        start = hears_of(one, 2)
        await until(lambda: hears_of(one, 1) > 0)
        assert hears_of(one, 2) - start <= SELDOM_CYCLES + 1
        known = hears_of(one, 1)
        await until(lambda: hears_of(one, 2) >= start + SELDOM_CYCLES + 6)
        assert hears_of(one, 1) >= known + 3


async def test_a_silent_module_for_which_there_is_time_is_asked_in_every_cycle() -> None:
    given = modules(1, 2) | {"timeout_s": 0.02}
    async with bench("tcp", dead={1}, **given) as one:
        await until(lambda: one.peer.asked.count(1) >= 12)
        asked = len(one.peer.asked)
        await until(lambda: hears_of(one, 2) >= 30)
        assert one.peer.asked[asked:].count(1) >= 10


async def test_a_module_that_stays_silent_to_one_block_gives_its_others() -> None:
    async with bench("rtu", **modules(1)) as one:
        one.peer.spoil = lambda reply: (
            [] if one.peer.requests[-1][1:3] == bytes(2) else untouched(reply)
        )
        await one.ear.hears(4)
        start = hears_of(one, 1)
        await until(lambda: hears_of(one, 1) >= start + 15)
        later = [values for values, *_ in one.ear.heard]
        assert sum("state_1" in values for values in later) >= hears_of(one, 1) - 3
        assert one.ear.bus == []


async def test_a_value_that_waited_for_a_silent_line_is_as_old_as_its_request_on_the_wire() -> None:
    given = modules(1, 2, blocks=ONE_BLOCK) | {"cycle_s": 0.25, "timeout_s": 0.2}
    async with bench("rtu", dead={2}, **given) as one:
        await until(lambda: one.port.statistics.timeouts >= 3 and hears_of(one, 1) >= 4)
        for values, taken_s, _ in one.ear.heard:
            assert 0.0 <= one.peer.taken[round(values["number_1"])] - taken_s < 0.01


async def test_the_end_does_not_wait_for_a_line_that_is_never_silent() -> None:
    async with bench("rtu") as one:
        one.peer.spoil = lambda reply: [(0.02, reply)] * 1000
        await asyncio.sleep(1.0)
        loop = asyncio.get_running_loop()
        began_s = loop.time()
    assert loop.time() - began_s < 0.16


async def test_each_device_on_the_line_is_asked_for_its_own_registers() -> None:
    registers = {
        name: {"address": address, "table": "input", "device_id": device}
        for name, address, device in (("a", 0, 7), ("b", 0, None), ("c", 2, 7))
    }
    signals = {name: {"signal": name} for name in registers}
    port = build(TCP | {"registers": registers, "signals": signals, "device_id": 3})
    asked = [(one.device_id, one.read.count) for one in port._blocks]  # type: ignore[union-attr]
    assert asked == [(3, 1), (7, 3)]


async def test_a_sensor_is_held_against_unit_and_trip_as_a_drive_is() -> None:
    registers = {"a": {"address": 0, "table": "input", "unit": "rpm"}}
    signals = {"output": {"signal": "a"}, "load_power_W": {"signal": "a", "scale": 0.001}}
    demands = Demands("K", trips={"load_power_W": ("load_power_max_W", 66.0)})
    with pytest.raises(ConfigurationError) as caught:
        build(TCP | {"registers": registers, "signals": signals}, demands)
    found = {flaw.place: flaw.message for flaw in caught.value.flaws}
    assert "is in rpm, the quantity in K" in found["sensor_bus.2.signals.output"]
    assert "can never trip" in found["sensor_bus.2.signals.load_power_W"]


async def test_a_cycle_that_the_line_cannot_carry_is_refused_with_its_figures() -> None:
    with pytest.raises(ConfigurationError) as caught:
        build(RTU | {"baud": 4800, "cycle_s": 0.03})
    place, message = caught.value.flaws[0].place, caught.value.flaws[0].message
    assert place == "sensor_bus.2.cycle_s"
    assert "23 bytes of 10 bits at 4800 baud" in message
    assert struct.calcsize(">5H") + 13 == 23  # five registers; 8 bytes ask, 5 frame the reply
