"""Supplies on SCPI whose descriptions come with the package, against fakes by their manuals."""

from __future__ import annotations

import asyncio

import pytest

from adaptdrive.control.signals import SAFE_COMMAND, Command
from tests.unit.described.described import described, running, sensed
from tests.unit.described.modbus_node import ModbusNode
from tests.unit.described.scpi_node import ScpiNode

pytestmark = pytest.mark.usefixtures("memory")


class KeysightN5700(ScpiNode):
    """Reads back what it was given, and has a voltage at its terminals while the output is on."""

    SETTINGS = ("VOLT", "CURR", "VOLT:PROT:LEV", "CURR:PROT:STAT", "OUTP", "OUTP:PROT:CLE")

    def __init__(self) -> None:
        super().__init__(self.SETTINGS)
        self.replies |= {f"{one}?": "0" for one in self.SETTINGS}
        self.replies |= {"MEAS:VOLT?": "0.000", "MEAS:CURR?": "0.000", "STAT:QUES:COND?": "0"}
        self.on_command = self._obey

    def _obey(self, header: str, value: str) -> None:
        self.replies[f"{header}?"] = {"ON": "1", "OFF": "0"}.get(value, value)
        volts = float(self.replies["VOLT?"]) if self.replies["OUTP?"] == "1" else 0.0
        self.replies["MEAS:VOLT?"] = f"{volts:.3f}"
        self.replies["MEAS:CURR?"] = f"{volts / 2.0:.3f}"


async def test_the_keysight_n5700() -> None:
    node = KeysightN5700()
    async with node.served():
        known = described("keysight-n5700").bus.model_dump(exclude_unset=True)
        link = known | {"host": "127.0.0.1", "port": node.port}
        async with running(described("keysight-n5700", **link)) as bench:
            reading = await bench.reading()
            assert (reading.bridge, reading.fault) == (False, 0)
            assert node.commands[:3] == [
                "VOLT:PROT:LEV 44.00",
                "CURR 22.00",
                "CURR:PROT:STAT ON",
            ]
            command = Command(current_scale_S=0.0, boost_reference_V=30.0, bridge=True)
            await bench.commands(command, lambda: bench.ear.readings[-1].bridge)
            await bench.commands(command, lambda: bench.ear.readings[-1].boost_voltage_V > 0.0)
            reading = bench.ear.readings[-1]
            order = node.commands
            assert order.index("VOLT 30.000") < order.index("OUTP ON")
            assert reading.boost_voltage_V == pytest.approx(30.0)
            assert reading.other["supply_current"] == pytest.approx(15.0)
            await bench.commands(SAFE_COMMAND, lambda: not bench.ear.readings[-1].bridge)
            assert (node.replies["OUTP?"], node.replies["VOLT?"]) == ("0", "0.000")
            node.replies["STAT:QUES:COND?"] = "1040"  # unregulated too, which is no fault
            await bench.reading()
            reading = await bench.reading()
            assert (reading.fault, reading.fault_name) == (16, "status bit 4 over-temperature")
            assert "OUTP:PROT:CLE" not in node.commands
            reset = asyncio.create_task(bench.port.reset_fault())
            await bench.commands(SAFE_COMMAND, reset.done)
            assert node.commands.count("OUTP:PROT:CLE") == 1
    assert node.errors == []


async def test_the_thermocouple_of_the_bath() -> None:
    module = ModbusNode((3,), framing="tcp")
    module.put("holding", 0, 652)
    async with module.served():
        ear = await sensed("keysight-n5700", module.port, 1)
    assert ear.values["output"] == pytest.approx(45.2)  # 65.2 degC in a room of 20 degC
