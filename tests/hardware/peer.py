"""A drive in a process of its own: `peer.py UDP_PORT REPORT` runs 200 half cycles and reports.

Its frames are made and checked by cantools and crccheck; it fails on the first command that is
missing or that a stranger would refuse.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))

from adaptdrive.hardware.link.bus import open_bus
from tests.hardware.bench import (
    Drive,
    motor_bus,
    reference_database,
    with_crc,
)

_COMMAND_ID = 0x080


def main(udp_port: int, report: Path) -> None:
    """Run the drive."""
    bus = open_bus(motor_bus(udp_port=udp_port))
    try:
        drive = Drive(bus)
        report.write_text(json.dumps([half_cycle(drive, number) for number in range(200)]))
    finally:
        bus.shutdown()


def half_cycle(drive: Drive, number: int) -> dict[str, float]:
    """Send both frames and wait for the command that answers them."""
    drive.send_status()
    drive.send_load(Tachometer=0.01 * number)
    data = command(drive)
    if data != with_crc(data):
        raise ValueError(f"wrong checksum: {data.hex()}")
    message = reference_database().get_message_by_name("DriveCommand")
    heard = message.decode_simple(data, decode_choices=False)
    return {
        "half_cycle": number,
        "scale_S": float(str(heard["CurrentScale"])),
        "reference_V": float(str(heard["BoostReference"])),
        "alive": int(str(heard["CommandAlive"])),
    }


def command(drive: Drive) -> bytes:
    """The next command on the bus."""
    while True:
        frame = drive.bus.recv(10.0)
        if frame is None:
            raise TimeoutError("no command within ten seconds")
        if frame.arbitration_id == _COMMAND_ID:
            return bytes(frame.data)


if __name__ == "__main__":
    main(int(sys.argv[1]), Path(sys.argv[2]))
