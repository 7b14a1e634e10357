"""Devices on Modbus whose descriptions come with the package, against fakes by their manuals."""

from __future__ import annotations

import asyncio
import math

import pytest

from adaptdrive.control.signals import SAFE_COMMAND, Command
from tests.unit.described.described import described, over_tcp, running, sensed
from tests.unit.described.modbus_node import ILLEGAL_VALUE, ModbusNode, RefusalError

pytestmark = pytest.mark.usefixtures("memory")


def command(value: float) -> Command:
    return Command(current_scale_S=0.0, boost_reference_V=value, bridge=True)


def rtu(*functions: int, most: int = 125) -> ModbusNode:
    return ModbusNode(functions, framing="rtu", most=most)


async def test_the_siemens_v20() -> None:
    node = rtu(3, 6, 16)
    node.put("holding", 99, 0, 0)
    node.put("holding", 109, 0xED37 & ~0x08 | 0x04, 8192)
    async with node.served(), running(described("siemens-v20", **over_tcp(node.port))) as bench:
        reading = await bench.reading()
        assert reading.boost_voltage_V == 25.0
        assert reading.output == pytest.approx(25.0 * math.pi)
        assert reading.bridge
        held = node.tables["holding"]
        await bench.commands(command(48.2), lambda: (held[99], held[100]) == (0x0C7F, 15794))
        await bench.commands(SAFE_COMMAND, lambda: (held[99], held[100]) == (0x0C7E, 0))
        assert node.functions.issuperset(node.asked)
        assert 16 not in node.asked  # function 6, as its users write it
        node.put("holding", 109, held[109] | 0x08)
        assert (await bench.reading()).fault == 0x08
        assert (await bench.reading()).fault_name == "status bit 3 drive fault"
        reset = asyncio.create_task(bench.port.reset_fault())
        await bench.commands(SAFE_COMMAND, lambda: held[99] == 0x0CFE)
        await bench.commands(command(48.2), lambda: held[99] == 0x0C7F)  # no reset while it runs
        await bench.commands(SAFE_COMMAND, lambda: reset.done() and held[99] == 0x0C7E)


async def test_the_delta_ms300() -> None:
    node = rtu(3, 6, 16)
    node.put("holding", 0x2000, 0, 0)
    node.put("holding", 0x2100, 0x0500, 0x0103, 5000, 4820, 312)
    async with node.served(), running(described("delta-ms300", **over_tcp(node.port))) as bench:
        reading = await bench.reading()
        assert reading.boost_voltage_V == pytest.approx(48.2)
        assert reading.other["motor_current"] == pytest.approx(3.12)
        assert (reading.bridge, reading.fault) == (True, 0)  # a warning is no fault
        assert reading.warning == "warning CE10"
        held = node.tables["holding"]
        await bench.commands(command(30.0), lambda: (held[0x2000], held[0x2001]) == (0x12, 3000))
        await bench.commands(SAFE_COMMAND, lambda: (held[0x2000], held[0x2001]) == (0x01, 0))
        node.put("holding", 0x2100, 0x0507, 0x0100)
        reading = await bench.reading()
        reading = await bench.reading()
        assert (reading.bridge, reading.fault) == (False, 7)


async def test_the_hitachi_wj200() -> None:
    node = rtu(1, 3, 5, 6, 16)
    node.put("coil", 0, *([0] * 0x20))
    node.put("coil", 0x0E, 1)
    node.put("holding", 0x0000, 0, 0)
    node.put("holding", 0x1000, 0, 4820, 312)
    async with node.served(), running(described("hitachi-wj200", **over_tcp(node.port))) as bench:
        reading = await bench.reading()
        assert reading.boost_voltage_V == pytest.approx(48.2)
        assert (reading.bridge, reading.fault) == (True, 0)
        coils, held = node.tables["coil"], node.tables["holding"]
        await bench.commands(command(30.0), lambda: (coils[0], held[1]) == (0xFF00, 3000))
        await bench.commands(SAFE_COMMAND, lambda: (coils[0], held[1]) == (0, 0))
        node.put("coil", 0x17, 1)
        await bench.reading()
        assert (await bench.reading()).fault == 1


async def test_the_pixsys_atr421() -> None:
    node = rtu(3, 4, 6, 16)
    node.put("holding", 1000, 854, 0, 0, 0, 0, 0, 2500, 0, 250, 0, 25, 0, 0, 0, 230)
    node.put("holding", 1200, 1, 0, 0, 0, 0, 0, 0, 0)
    node.put("holding", 1210, 0)
    async with node.served(), running(described("pixsys-atr421", **over_tcp(node.port))) as bench:
        reading = await bench.reading()
        held = node.tables["holding"]
        assert (held[1200], held[1210]) == (17, 3000)  # manual output, and its own watch
        assert reading.output == pytest.approx(65.4)  # 85.4 degC, above 20
        assert reading.boost_voltage_V == pytest.approx(25.0)
        await bench.commands(command(60.0), lambda: (held[1201], held[1206]) == (1, 6000))
        await bench.commands(SAFE_COMMAND, lambda: (held[1201], held[1206]) == (0, 0))
        node.put("holding", 1013, 0x0008)
        await bench.reading()
        assert (await bench.reading()).fault_name == "errors bit 3 sensor 1"


class DeltaDtb(ModbusNode):
    """Takes nothing before communication write-in is on, and an output in manual mode only."""

    def __init__(self) -> None:
        super().__init__({2, 3, 5, 6}, framing="rtu", most=8)
        self.put("holding", 0x1000, 854, 500, 0, 0, 0, 0)
        self.put("holding", 0x1012, 0)
        self.put("coil", 0x0810, 0)
        self.put("coil", 0x0814, 0)
        self.put("discrete", 0x080E, 0, 0, 0, 0, 0, 0, 0)
        self.on_write = self._judge

    def _judge(self, table: str, address: int, word: int) -> None:
        if table == "coil":
            self.put("discrete", address, int(word == 0xFF00))
            return
        manual = self.tables["holding"][0x1005] == 2
        if not (self.tables["coil"][0x0810] and (address != 0x1012 or manual)):
            raise RefusalError(ILLEGAL_VALUE)


async def test_the_delta_dtb() -> None:
    node = DeltaDtb()
    async with node.served(), running(described("delta-dtb", **over_tcp(node.port))) as bench:
        reading = await bench.reading()
        assert node.writes[:2] == [(0x0810, 0xFF00), (0x1005, 2)]
        assert reading.output == pytest.approx(65.4)
        coils, held = node.tables["coil"], node.tables["holding"]
        await bench.commands(command(60.0), lambda: (coils[0x0814], held[0x1012]) == (0xFF00, 600))
        assert (await bench.reading()).boost_voltage_V == pytest.approx(60.0)
        await bench.commands(SAFE_COMMAND, lambda: (coils[0x0814], held[0x1012]) == (0, 0))
        assert bench.port.trip_cause is None
        node.put("holding", 0x1000, 0x8003)  # the sensor is not connected
        await bench.commands(
            SAFE_COMMAND, lambda: "output: holding 4096" in str(bench.port.explain_age())
        )


async def test_the_riden_rd6006() -> None:
    node = rtu(3, 6, 16)
    node.put("holding", 8, 0, 0, 4812, 1500, 0, 7218, 6010, 0, 0, 0, 0)
    async with node.served(), running(described("riden-rd6006", **over_tcp(node.port))) as bench:
        reading = await bench.reading()
        assert reading.boost_voltage_V == pytest.approx(48.12)
        assert reading.output == pytest.approx(1.5)
        assert reading.load_power_W == pytest.approx(72.18)
        held = node.tables["holding"]
        on = (4950, 6000, 1)
        await bench.commands(command(49.5), lambda: (held[8], held[9], held[18]) == on)
        await bench.commands(SAFE_COMMAND, lambda: (held[8], held[18]) == (0, 0))
        node.put("holding", 16, 1)
        reading = await bench.reading()
        assert (await bench.reading()).fault_name == "protection bit 0 over-voltage"


@pytest.mark.parametrize(("name", "degree"), [("exemys-rme1-tc", 10.0), ("omega-iserver2", None)])
async def test_thermocouple_modules(name: str, degree: float | None) -> None:
    node = ModbusNode({3}, framing="tcp")
    if degree is not None:
        node.put("holding", 0, 854, 201, *([0] * 6))
    else:
        node.put_float("holding", 0, 85.4)
        node.put_float("holding", 2, 20.1)
    async with node.served():
        found = (await sensed(name, node.port, 2)).values
        assert found["bath_temperature"] == pytest.approx(85.4 + 273.15, abs=1e-4)
        assert found["inflow_temperature"] == pytest.approx(20.1 + 273.15, abs=1e-4)
        if degree is not None:
            node.put("holding", 0, 32767)
        else:
            node.put_float("holding", 0, math.nan)
        broken = (await sensed(name, node.port, 1)).values
        assert set(broken) == {"inflow_temperature"}
