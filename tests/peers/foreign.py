"""A foreign drive as a process: started, disturbed by signals, and read from its own log."""

from __future__ import annotations

import json
import signal
import socket
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.integration.wire.rig import EXAMPLES
from tests.support import Process, Spawn, complete_lines, free_port

START_V = 3.1
PATIENT_s = 5.0
"""Time-out of a drive that must not stop by itself while the machine runs others."""

_START_s = 120.0
_CHANGES = {
    "can": {"udp_port = 43113": "udp_port = {port}", "stale_s = 0.05 ": "stale_s = 2.0 "},
    "modbus": {"port = 5020": "port = {port}", "stale_s = 0.35 ": "stale_s = 2.0 "},
}
_FILES = {"can": "motor.toml", "modbus": "motor-modbus-tcp.toml"}
_SOCKETS = {"can": socket.SOCK_DGRAM, "modbus": socket.SOCK_STREAM}


def configuration(bus: str, port: int) -> str:
    """The example configuration of a bus, on a port of its own and for a busy machine."""
    text = (EXAMPLES / _FILES[bus]).read_text()
    for old, new in _CHANGES[bus].items():
        assert old in text
        text = text.replace(old, new.format(port=port))
    return text.replace('"adaptdrive.dbc"', f'"{EXAMPLES / "adaptdrive.dbc"}"')


@dataclass
class Foreign:
    """The drive's process, its description for the daemon, and its log.

    Attributes:
        bus: `can` or `modbus`.
        port: Where it is reached.
        folder: Holds the configuration, and the logs of all processes.
        spawn: Starts processes.
        process: The drive that was started last.
    """

    bus: str
    port: int
    folder: Path
    spawn: Spawn
    process: Process | None = None

    @classmethod
    def build(cls, bus: str, folder: Path, spawn: Spawn) -> Foreign:
        """Describe a drive on a bus."""
        drive = cls(bus, free_port(_SOCKETS[bus]), folder, spawn)
        drive.config.write_text(configuration(bus, drive.port))
        return drive

    @property
    def config(self) -> Path:
        """The daemon's configuration."""
        return self.folder / "foreign.toml"

    def start(self, timeout_s: float = PATIENT_s) -> None:
        """Start the drive, turning as if it had been driven until just now.

        Args:
            timeout_s: Time without a command after which it stops by itself.
        """
        words = [str(self.port), str(START_V), str(timeout_s)]
        if self.bus == "can":
            words.insert(0, str(EXAMPLES / "adaptdrive.dbc"))
        known = len(self.events("ready"))
        program = Path(__file__).with_name(f"{self.bus}_drive.py")
        self.process = self.spawn(sys.executable, program, *words)
        deadline_s = time.monotonic() + _START_s
        while len(self.events("ready")) == known:
            assert time.monotonic() < deadline_s
            time.sleep(0.02)

    def send(self, number: signal.Signals) -> float:
        """Send a signal to the drive; the monotonic time of it."""
        assert self.process is not None
        now_s = time.monotonic()
        self.process.send_signal(number)
        return now_s

    def events(self, name: str) -> list[dict[str, Any]]:
        """The events of a name, of all drives that were started, in the order of their times."""
        logs = self.folder.glob("process-*.log")
        lines = [line for log in logs for line in complete_lines(log) if line.startswith("{")]
        found = [event for event in map(json.loads, lines) if event["event"] == name]
        return sorted(found, key=lambda event: float(event["at_s"]))

    @property
    def energised(self) -> bool:
        """Whether the drive has its bridge on, by its own log."""
        switched = self.events("bridge")
        return bool(switched) and bool(switched[-1]["on"])

    def reads_V(self) -> float:
        """What the tachometer reads, by the log of the drive."""
        return float(self.events("state")[-1]["tachometer_V"])
