"""What a user would write in an afternoon: `script.py PORT BROKER_PORT TABLE`.

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
from collections.abc import Callable
from pathlib import Path
from typing import Any

import aiomqtt
import can
import cantools
from crccheck.crc import Crc8SaeJ1850

from adaptdrive.devices.can.bus import LoopbackMulticast  # python-can's own, kept on loopback
from tools.benchmarks.tools import GROUP

DBC = Path(__file__).parents[3] / "deploy" / "examples" / "adaptdrive.dbc"
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


class Control:
    """Answers the frames of each half cycle with a command.

    Attributes:
        ticks: Half cycles that were answered.
        measured: The newest values.
    """

    def __init__(
        self, send: Callable[[can.Message], None], write: Callable[[list[Any]], object]
    ) -> None:
        database: Any = cantools.database.load_file(DBC)
        self._status, self._load, self._order = map(
            database.get_message_by_name, ("DriveStatus", "DriveLoad", "DriveCommand")
        )
        self._voltage = Pi(0.001, 0.0001, -MAX_SCALE_S, MAX_SCALE_S)
        self._output = Pi(20.0, 2.0, 210.0, MAX_VOLTAGE_V)
        self._messages = {one.frame_id: one for one in (self._status, self._load)}
        self._alive: dict[int, int] = {}
        self._send, self._write, self._reference_V = send, write, 280.0
        self.ticks, self.measured = 0, dict[str, float]()

    def take(self, frame: can.Message) -> bool:
        """Take a frame; return whether a command has answered it."""
        message = self._messages.get(frame.arbitration_id)
        if message is None:
            return False
        data = bytes(frame.data)
        found = message.decode(data, decode_choices=False)
        count = int(found["StatusAlive" if message is self._status else "LoadAlive"])
        if is_whole(data, count, self._alive.get(frame.arbitration_id)):
            self.measured.update(found)
        self._alive[frame.arbitration_id] = count
        if message is not self._load or "BoostVoltage" not in self.measured:
            return False
        self._answer(frame.timestamp)
        return True

    def _answer(self, time_s: float) -> None:
        measured = self.measured
        if self.ticks % PERIOD_TICKS == 0:
            self._reference_V = self._output.step(OUTPUT_V - measured["Tachometer"])
        scale_S = self._voltage.step(self._reference_V - measured["BoostVoltage"])
        values = {"CurrentScale": scale_S, "BoostReference": self._reference_V, "BridgeEnable": 1}
        data = self._order.encode(values | {"CommandAlive": self.ticks % 16, "CommandCrc": 0})
        data = data[:7] + bytes((Crc8SaeJ1850.calc(data[:7]),))
        self._send(
            can.Message(arbitration_id=self._order.frame_id, data=data, is_extended_id=False)
        )
        self._write([self.ticks, time_s, *measured.values(), self._reference_V, scale_S])
        self.ticks += 1


async def main(port: int, broker_port: int, path: Path) -> None:
    """Run until it is ended."""
    with path.open("w", newline="") as file, LoopbackMulticast(GROUP, port, fd=False) as bus:
        control = Control(bus.send, csv.writer(file).writerow)
        reader = can.AsyncBufferedReader()
        notifier = can.Notifier(bus, [reader], loop=asyncio.get_running_loop())
        try:
            async with aiomqtt.Client("127.0.0.1", broker_port) as client:
                async for frame in reader:
                    if control.take(frame) and control.ticks % PERIOD_TICKS == 1:
                        await client.publish("afternoon/telemetry", json.dumps(control.measured))
        finally:
            notifier.stop()


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3])))
