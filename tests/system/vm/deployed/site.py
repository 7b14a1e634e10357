"""A deployed drive in the virtual machine: the broker, the service, and what goes over the bus.

Nothing here imports adaptdrive: what is checked is what an operator and a stranger on the bus see.
"""

from __future__ import annotations

import itertools
import json
import re
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")

ROOT = Path(__file__).parents[4]
SHARED = Path("/run/vm")
UNIT = "adaptdrive@motor.service"
PATIENCE_S = 180.0
"""The machine is slow, and what emulates it may be busy."""

_TOPICS = ("state", "event", "reply", "telemetry/load")
DEAD_MAN_S = 1.0
_PATIENT_DRIVE = ("--initial-voltage", "280", "--command-timeout", str(DEAD_MAN_S))
_BROKER = ("-h", "localhost", "-p", "8883")
_AUTHORITY = "/etc/mosquitto/ca_certificates/adaptdrive.crt"
_PASSWORD = Path("/etc/adaptdrive/operator.password")
_AGAIN = 'until "$@"; do sleep 1; done'
"""mosquitto_sub ends at an error of TLS, such as a broker that restarts during the handshake."""


def until(find: Callable[[], T | None], what: str, patience_s: float = PATIENCE_S) -> T:
    """Wait until something is found and return it."""
    deadline_s = time.monotonic() + patience_s
    while time.monotonic() < deadline_s:
        if found := find():
            return found
        time.sleep(0.2)
    raise AssertionError(f"not within {patience_s:g} s: {what}")


def call(*words: str) -> str:
    """Run a command that must succeed; what it printed."""
    done = subprocess.run(words, check=False, capture_output=True, text=True)
    assert done.returncode == 0, f"{words}: {done.stdout}{done.stderr}"
    return done.stdout.strip()


def unit_says(name: str) -> str:
    """One property of the daemon's unit."""
    return call("systemctl", "show", "--value", "--property", name, UNIT)


def _lines(path: Path) -> list[str]:
    """The lines of a file that is being written, without one that is half written."""
    whole = path.read_text(encoding="utf-8").rpartition("\n")[0] if path.exists() else ""
    return whole.splitlines()


@dataclass(frozen=True, slots=True)
class CommandSignal:
    """Where a signal of the drive's command lies in its frame, little-endian."""

    start: int
    length: int

    def raw(self, data: bytes) -> int:
        """The bits in a frame."""
        return int.from_bytes(data, "little") >> self.start & ((1 << self.length) - 1)


def command_signal(name: str) -> CommandSignal:
    """Read from the shipped DBC where a signal of the command lies."""
    text = (ROOT / "deploy/examples/adaptdrive.dbc").read_text(encoding="cp1252")
    found = re.search(rf"SG_ {name} : (\d+)\|(\d+)@1", text)
    assert found, name
    return CommandSignal(int(found[1]), int(found[2]))


@dataclass
class Bus:
    """Every command on the bus, as candump heard it, and what the simulated drive did."""

    log: Path = SHARED / "commands"
    device: Path = SHARED / "device"
    _scale: CommandSignal = field(default_factory=lambda: command_signal("CurrentScale"))
    _bridge: CommandSignal = field(default_factory=lambda: command_signal("BridgeEnable"))
    _heard: list[bool] = field(default_factory=list)
    _read: int = 0

    def listen(self) -> None:
        """Have candump write down every command."""
        with self.log.open("ab") as log:
            subprocess.Popen(["candump", "-L", "-D", "vcan0,080:7FF"], stdout=log)

    def commands(self) -> list[bool]:
        """All commands so far: whether each one energises."""
        with self.log.open(encoding="ascii") as log:
            log.seek(self._read)
            for line in iter(log.readline, ""):
                if not line.endswith("\n"):
                    break
                data = bytes.fromhex(line.split("#")[1])
                self._heard.append(bool(self._scale.raw(data) or self._bridge.raw(data)))
                self._read += len(line)
        return self._heard

    def start_drive(self, config: Path) -> None:
        """Start the simulated drive."""
        program = ROOT / ".venv/bin/adaptdrive-sim"
        with self.device.open("ab") as log:
            subprocess.Popen(
                [program, "device", config, *_PATIENT_DRIVE],
                stdout=log,
                stderr=subprocess.STDOUT,
            )

    def safe_events(self) -> list[dict[str, Any]]:
        """Each time the drive went to its safe state because nobody commanded it."""
        events = (json.loads(line) for line in _lines(self.device) if line.startswith("{"))
        return [event for event in events if event["event"] == "safe"]


class Operator:
    """Somebody with mosquitto's own clients and the operator's password."""

    def __init__(self) -> None:
        password = _PASSWORD.read_text(encoding="utf-8").strip()
        self._identity = ("--cafile", _AUTHORITY, "-u", "operator", "-P", password)
        self._numbers = itertools.count()

    def listen(self, log: Path) -> None:
        """Write down all that the drive says from now on."""
        self._log = log
        topics = [word for name in _TOPICS for word in ("-t", f"adaptdrive/motor/{name}")]
        words = (*topics, "-q", "1", "-F", "%t\t%p")
        with log.open("ab") as output:
            command = ["mosquitto_sub", *_BROKER, *self._identity, *words]
            subprocess.Popen(["bash", "-c", _AGAIN, "bash", *command], stdout=output)

    def heard(self, name: str) -> list[dict[str, Any]]:
        """All that was heard on a topic."""
        messages = (line.split("\t", 1) for line in _lines(self._log) if line.endswith("}"))
        return [json.loads(text) for topic, text in messages if topic == f"adaptdrive/motor/{name}"]

    def ask(self, verb: str, value: object = None) -> dict[str, Any]:
        """Send a command; the reply to it."""
        identity = f"{time.monotonic()}-{next(self._numbers)}"
        topic = f"adaptdrive/motor/command/{verb}"
        payload = json.dumps({"id": identity, "value": value})
        call("mosquitto_pub", *_BROKER, *self._identity, "-t", topic, "-q", "1", "-m", payload)

        def reply() -> dict[str, Any] | None:
            return next((one for one in self.heard("reply") if one["id"] == identity), None)

        return until(reply, f"a reply to {verb}")

    def await_accepted(self, verb: str, value: object = None) -> None:
        """Send a command until it is accepted: what stood against it may take time to go."""

        def accepted() -> bool:
            return bool(self.ask(verb, value)["accepted"])

        until(accepted, f"{verb} is accepted")

    def await_state(self, **wanted: object) -> dict[str, Any]:
        """Wait until the state that was told last has some values."""

        def find() -> dict[str, Any] | None:
            states = self.heard("state")[-1:]
            return next((one for one in states if wanted.items() <= _plain(one).items()), None)

        return until(find, f"state {wanted}; the last is {self.heard('state')[-1:]}")

    def run_drive(self) -> None:
        """Enable the drive and give it a set-point, without which a motor at rest coasts."""
        self.await_accepted("enable")
        self.await_state(state="running")
        assert self.ask("setpoint", 3.0)["accepted"]
        self.await_state(state="running", setpoint=3.0)


def _plain(content: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in content.items() if not isinstance(value, dict | list)}
