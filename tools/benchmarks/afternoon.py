"""What a user would write in an afternoon: `afternoon.py PORT BROKER_PORT TABLE`.

It holds the motor of `deploy/examples/motor.toml` with the libraries that one would take:
python-can for the bus, cantools for its frames, aiomqtt for a message a second, csv for the
record. Both frames of each half cycle are checked and decoded, a PI controller holds the boost
voltage and another the output, with limits; one command goes out, and one row to the table. It has
no supervision, no estimator, no state machine and no remedy: the yardstick of what a daemon costs.
"""

from __future__ import annotations

import asyncio
import csv
import json
import sys
from pathlib import Path
from typing import Any

import aiomqtt
import can
import cantools
from crccheck.crc import Crc8SaeJ1850

from adaptdrive.devices.can.bus import LoopbackMulticast  # python-can's own, kept on loopback
from tools.benchmarks.tools import GROUP

DBC = Path(__file__).parents[2] / "deploy" / "examples" / "adaptdrive.dbc"
PERIOD_TICKS = 120
MAX_SCALE_S, MAX_VOLTAGE_V, OUTPUT_V = 0.2, 390.0, 3.0


class Pi:
    """A PI controller with limits and conditional integration."""

    def __init__(self, gain: float, per_step: float, low: float, high: float) -> None:
        self._gain, self._per_step = gain, per_step
        self._low, self._high, self._sum = low, high, 0.0

    def step(self, error: float) -> float:
        """Return the output for an error."""
        wanted = self._gain * error + self._sum + self._per_step * error
        held = min(max(wanted, self._low), self._high)
        if held == wanted:
            self._sum += self._per_step * error
        return held


def is_whole(data: bytes, alive: int, last: int | None) -> bool:
    """Return whether a frame has its checksum, and a counter that has advanced by one."""
    return Crc8SaeJ1850.calc(data[:7]) == data[7] and last in {None, (alive - 1) % 16}


async def control(bus: can.BusABC, table: Any, client: aiomqtt.Client) -> None:
    """Answer the frames of each half cycle with a command."""
    database: Any = cantools.database.load_file(DBC)
    status, load = (
        database.get_message_by_name("DriveStatus"),
        database.get_message_by_name("DriveLoad"),
    )
    order = database.get_message_by_name("DriveCommand")
    voltage, output = (
        Pi(0.001, 0.0001, -MAX_SCALE_S, MAX_SCALE_S),
        Pi(20.0, 2.0, 210.0, MAX_VOLTAGE_V),
    )
    reader = can.AsyncBufferedReader()
    notifier = can.Notifier(bus, [reader], loop=asyncio.get_running_loop())
    alive: dict[int, int | None] = {status.frame_id: None, load.frame_id: None}
    measured: dict[str, float] = {}
    reference_V, ticks = 280.0, 0
    try:
        async for frame in reader:
            message = {status.frame_id: status, load.frame_id: load}.get(frame.arbitration_id)
            if message is None:
                continue
            found = message.decode(bytes(frame.data), decode_choices=False)
            count = int(found["StatusAlive" if message is status else "LoadAlive"])
            if is_whole(bytes(frame.data), count, alive[frame.arbitration_id]):
                measured.update(found)
            alive[frame.arbitration_id] = count
            if message is not load or "BoostVoltage" not in measured:
                continue
            if ticks % PERIOD_TICKS == 0:
                reference_V = output.step(OUTPUT_V - measured["Tachometer"])
                await client.publish("afternoon/telemetry", json.dumps(measured))
            scale_S = voltage.step(reference_V - measured["BoostVoltage"])
            values = {"CurrentScale": scale_S, "BoostReference": reference_V, "BridgeEnable": 1}
            data = order.encode(values | {"CommandAlive": ticks % 16, "CommandCrc": 0})
            data = data[:7] + bytes((Crc8SaeJ1850.calc(data[:7]),))
            bus.send(can.Message(arbitration_id=order.frame_id, data=data, is_extended_id=False))
            table.writerow([ticks, frame.timestamp, *measured.values(), reference_V, scale_S])
            ticks += 1
    finally:
        notifier.stop()


async def main(port: int, broker_port: int, path: Path) -> None:
    """Run until it is ended."""
    with path.open("w", newline="") as file, LoopbackMulticast(GROUP, port, fd=False) as bus:
        async with aiomqtt.Client("127.0.0.1", broker_port) as client:
            await control(bus, csv.writer(file), client)


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3])))
