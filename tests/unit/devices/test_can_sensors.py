"""Sensors on a CAN bus, whose frames a stranger makes: what is used of them, and what is not."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator
from pathlib import Path

import can
import pytest

from adaptdrive.config.root import CanSensorSection as Config
from adaptdrive.devices.can.bus import open_bus
from adaptdrive.devices.can.kind import SensorPort, build_can_sensors
from adaptdrive.util.errors import ConfigurationError
from tests.unit.devices.bench import EXAMPLES, Clock, Drive, SensorEar, until, with_crc

COMMON = {
    "name": "bench",
    "type": "can",
    "interface": "virtual",
    "channel": "sensors",
    "database": str(EXAMPLES / "adaptdrive.dbc"),
    "integrity": {
        "DriveStatus": {"counter": "StatusAlive", "checksum": "StatusCrc"},
        "DriveLoad": {"counter": "LoadAlive", "checksum": "LoadCrc"},
    },
    "cycle_s": 0.05,
    "signals": {
        "speed": {"signal": "DriveLoad.Tachometer", "scale": 1000.0 / 7.0, "unit": "rpm"},
        "power": {"signal": "DriveStatus.LoadPower"},
    },
}


_WIDE_DBC = """VERSION ""
BU_: MODULE
BO_ 801 Wide: 16 MODULE
 SG_ Temperature : 16|16@1- (0.1,0) [-20|120] "degC" Vector__XXX
"""
"""A message of 16 bytes, 0x321."""


class Bench:
    """A port, what it hears on its bus, and what it tells."""

    def __init__(self, **changes: object) -> None:
        config = Config.model_validate(COMMON | changes, strict=False)
        self.drive, self.ear = Drive(open_bus(config)), SensorEar()
        clock = asyncio.get_running_loop().time
        self.port: SensorPort = build_can_sensors(config, "sensor_bus.0", clock)

    async def receives(self, count: int) -> None:
        await until(lambda: self.port.statistics.received >= count)


@contextlib.asynccontextmanager
async def bench(**changes: object) -> AsyncIterator[Bench]:
    one = Bench(**changes)
    task = asyncio.create_task(one.port.run(one.ear))
    await asyncio.sleep(0.0)
    try:
        yield one
    finally:
        task.cancel()
        (outcome,) = await asyncio.gather(task, return_exceptions=True)
        one.drive.bus.shutdown()
    assert isinstance(outcome, asyncio.CancelledError)


async def test_each_frame_gives_its_own_values_in_si_from_its_arrival_on() -> None:
    async with bench() as one:
        sent_s = asyncio.get_running_loop().time()
        one.drive.send_load(Tachometer=7.0)
        await one.ear.hears(1)
        one.drive.send_status(LoadPower=123.4)
        await one.ear.hears(1)
        (speed, taken_s, _), (power, *_) = one.ear.heard
        assert speed == {"speed": pytest.approx(1000.0 * math.pi / 30.0)}
        assert power == {"power": pytest.approx(123.4)}
        assert taken_s == sent_s
        assert one.ear.bus == []


async def test_what_fails_a_check_gives_nothing_and_is_counted() -> None:
    async with bench() as one:
        one.drive.send_load(Tachometer=1.0)
        await one.ear.hears(1)
        damaged = bytearray(one.drive.frame("DriveLoad", Tachometer=2.0))
        damaged[0] ^= 1
        one.drive.put("DriveLoad", bytes(damaged))
        one.drive.put("DriveLoad", bytes(damaged[:7]))
        repeated = one.drive.frame("DriveStatus")
        for _ in range(2):
            one.drive.put("DriveStatus", repeated)
        await one.receives(5)
        assert len(one.ear.heard) == 2
        counts = one.port.statistics
        assert (counts.wrong_checksum, counts.wrong_length, counts.counter_stuck) == (1, 1, 1)


async def test_the_values_beside_a_refused_one_are_used() -> None:
    signals = {
        "power": {"signal": "DriveStatus.LoadPower"},
        "volts": {"signal": "DriveStatus.BoostVoltage"},
    }
    async with bench(signals=signals) as one:
        spoilt = one.drive.frame("DriveStatus", LoadPower=123.4)
        one.drive.put("DriveStatus", with_crc(b"\xff\xff" + spoilt[2:]))
        await one.ear.hears(1)
        assert one.ear.latest == {"power": pytest.approx(123.4)}
        assert one.port.statistics.out_of_range == 1


async def test_silence_and_its_end_are_told() -> None:
    async with bench() as one:
        one.drive.send_load(Tachometer=1.0)
        await one.ear.hears(1)
        await until(lambda: bool(one.ear.bus))
        assert one.ear.bus[0][0] is False
        assert "no good frame for 0.15 s" in one.ear.bus[0][1]
        one.drive.send_load(Tachometer=1.0)
        await until(lambda: len(one.ear.bus) > 1)
        assert one.ear.bus[1][0]


async def test_a_bus_that_cannot_be_opened_is_told_and_tried_again() -> None:
    given = COMMON | {"interface": "socketcan", "channel": "nosuchcan0"}
    clock = asyncio.get_running_loop().time
    port = build_can_sensors(Config.model_validate(given, strict=False), "sensor_bus.0", clock)
    ear = SensorEar()
    task = asyncio.create_task(port.run(ear))
    await until(lambda: bool(ear.bus))
    assert not ear.bus[0][0]
    assert "socketcan nosuchcan0" in ear.bus[0][1]
    await asyncio.sleep(0.3)
    assert not task.done()
    task.cancel()
    await asyncio.wait([task])


def test_what_the_database_does_not_have_is_listed_with_its_place(tmp_path: Path) -> None:
    signals = {"a": {"signal": "DriveLoad.Tacho"}, "b": {"signal": "Nothing.At"}}
    integrity = {"DriveLoad": {"counter": "Alive"}}
    config = Config.model_validate(
        COMMON | {"signals": signals, "integrity": integrity}, strict=False
    )
    with pytest.raises(ConfigurationError) as caught:
        build_can_sensors(config, "sensor_bus.1", Clock())
    assert {flaw.place for flaw in caught.value.flaws} == {
        "sensor_bus.1.signals.a",
        "sensor_bus.1.signals.b",
        "sensor_bus.1.integrity.DriveLoad.counter",
    }
    assert "did you mean 'Tachometer'" in str(caught.value)
    absent = config.model_copy(update={"database": [tmp_path / "none.dbc"]})
    with pytest.raises(ConfigurationError, match=r"sensor_bus\.1\.database"):
        build_can_sensors(absent, "sensor_bus.1", Clock())


async def test_a_sensor_whose_frames_are_those_of_can_fd_is_heard(tmp_path: Path) -> None:
    description = tmp_path / "wide.dbc"
    description.write_text(_WIDE_DBC)
    signals = {"temperature": {"signal": "Wide.Temperature", "unit": "degC"}}
    wide = {"fd": True, "database": str(description), "integrity": {}, "signals": signals}
    async with bench(**wide) as one:
        assert one.drive.bus.protocol is can.CanProtocol.CAN_FD
        data = [0, 0, 250, *13 * [0]]
        frame = can.Message(arbitration_id=0x321, data=data, is_extended_id=False, is_fd=True)
        one.drive.bus.send(frame)
        await one.ear.hears(1)
        assert one.ear.latest == {"temperature": pytest.approx(25.0 + 273.15)}
