"""A drive whose slave is pyModbusTCP's: `pymodbustcp_drive.py PORT TACHOMETER_V TIMEOUT_s`.

The register map is that of `modbus_drive.py`; who frames, parses and serves is another library,
with a thread for each master.
"""

from __future__ import annotations

import importlib
import sys
import threading
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[3]))

from tests.scenes.peers.drive import Drive, HALF_CYCLE_s, say_ready
from tests.scenes.peers.modbus_drive import COMMANDS, MEASURED, REGISTERS, measured, obey

library: Any = importlib.import_module("pyModbusTCP.server")  # not installed everywhere


class Bank(library.DataBank):  # type: ignore[misc] # its package has no types
    """The registers of the drive; the measured ones are renewed when they are read."""

    def __init__(self, drive: Drive, lock: threading.Lock) -> None:
        """Hold as many registers as the map has.

        Args:
            drive: The drive.
            lock: Is held where the drive lives.
        """
        super().__init__(h_regs_size=len(REGISTERS))
        self._drive = drive
        self._lock = lock

    def get_holding_registers(self, address: int, number: int = 1, srv_info: Any = None) -> Any:
        """Return registers as they are now; the library chooses the arguments."""
        with self._lock:
            super().set_holding_registers(MEASURED.start, measured(self._drive))
        return super().get_holding_registers(address, number, srv_info)

    def set_holding_registers(
        self, address: int, word_list: list[int], srv_info: Any = None
    ) -> Any:
        """Take registers; None, an illegal address, for all but the commands."""
        if address not in COMMANDS or address + len(word_list) > COMMANDS.stop:
            return None
        before = super().get_holding_registers(COMMANDS.start, len(COMMANDS))
        done = super().set_holding_registers(address, word_list, srv_info)
        after = super().get_holding_registers(COMMANDS.start, len(COMMANDS))
        with self._lock:
            obey(self._drive, before, after)
        return done


def main(port: int, drive: Drive) -> None:
    """Serve until killed."""
    lock = threading.Lock()
    server = library.ModbusServer("127.0.0.1", port, no_block=True, data_bank=Bank(drive, lock))
    server.start()
    say_ready()
    due_s = time.monotonic()
    while True:
        due_s = max(due_s + HALF_CYCLE_s, time.monotonic() - 1.0)
        time.sleep(max(0.0, due_s - time.monotonic()))
        with lock:
            drive.live()


if __name__ == "__main__":
    main(int(sys.argv[1]), Drive(float(sys.argv[2]), float(sys.argv[3])))
