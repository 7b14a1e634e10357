"""A drive on CAN, made of its DBC: `can_drive.py DBC UDP_PORT TACHOMETER_V TIMEOUT_s`."""

from __future__ import annotations

import os
import socket
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[2]))

import can
import cantools

from tests.peers.drive import LINE_V, Drive, HALF_CYCLE_s, say_ready


def crc8(data: bytes) -> int:
    """CRC-8 SAE J1850, bit by bit, as the comment of the DBC describes it."""
    register = 0xFF
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = (register << 1) ^ (0x1D if register & 0x80 else 0)
            register &= 0xFF
    return register ^ 0xFF


class Node:
    """Speaks for a drive, and hears its commands."""

    def __init__(self, drive: Drive, dbc: str, udp_port: int) -> None:
        self._drive = drive
        self._database: Any = cantools.database.load_file(dbc)
        self._alive = {"DriveStatus": 0, "DriveLoad": 0}
        self._commanded: int | None = None
        self._bus = can.Bus(
            interface="udp_multicast",
            channel="239.74.163.2",
            port=udp_port,
            hop_limit=0,
            ignore_config=True,
        )
        loopback = socket.inet_aton("127.0.0.1")
        with socket.socket(fileno=os.dup(self._bus.fileno())) as own:
            own.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, loopback)

    def run(self) -> None:
        """Speak each half cycle, by a clock that drifts from the daemon's, and hear in between."""
        due_s = time.monotonic()
        while True:
            due_s = max(due_s + HALF_CYCLE_s, time.monotonic() - 1.0)
            while (left_s := due_s - time.monotonic()) > 0.0:
                self._hear(self._bus.recv(left_s))
            while (frame := self._bus.recv(0.0)) is not None:
                self._hear(frame)
            self._drive.live()
            self._speak()

    def _speak(self) -> None:
        drive = self._drive
        self._send(
            "DriveStatus",
            "Status",
            BoostVoltage=drive.boost_V,
            LineVoltage=LINE_V,
            LoadPower=drive.power_W,
            BridgeOn=int(drive.bridge),
            Fault=drive.fault,
        )
        motor = drive.motor
        self._send(
            "DriveLoad",
            "Load",
            Tachometer=motor.tachometer_V,
            HalfCycle=drive.half_cycle,
            LoadCurrent=motor.current_A,
        )

    def _send(self, name: str, prefix: str, **values: float) -> None:
        alive = self._alive[name]
        self._alive[name] = (alive + 1) % 16
        proofs = {f"{prefix}Alive": alive, f"{prefix}Crc": 0}
        message = self._database.get_message_by_name(name)
        body = message.encode(values | proofs)[:7]
        data = body + bytes([crc8(body)])
        self._bus.send(
            can.Message(arbitration_id=message.frame_id, data=data, is_extended_id=False)
        )

    def _hear(self, frame: can.Message | None) -> None:
        message = self._database.get_message_by_name("DriveCommand")
        if frame is None or frame.arbitration_id != message.frame_id or len(frame.data) != 8:
            return
        data = bytes(frame.data)
        values = message.decode(data, decode_choices=False)
        repeated = values["CommandAlive"] == self._commanded
        if crc8(data[:7]) != data[7] or repeated:
            return
        self._commanded = values["CommandAlive"]
        self._drive.command(scale_S=values["CurrentScale"], bridge=bool(values["BridgeEnable"]))


if __name__ == "__main__":
    drive = Drive(float(sys.argv[3]), float(sys.argv[4]))
    node = Node(drive, sys.argv[1], int(sys.argv[2]))
    say_ready()
    node.run()
