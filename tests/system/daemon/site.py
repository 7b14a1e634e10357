"""One drive with everything around it, as real processes, and the clients that nobody here wrote.

A site has a bus, a broker and a folder of its own. Broker, simulated drive and daemon are started
and ended one by one, so that a test may take away what it likes.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

import can
import cantools
from cantools.database.can.database import Database

from adaptdrive.config import load_configuration
from adaptdrive.config.bus import CanBus
from adaptdrive.devices.can.bus import open_bus
from adaptdrive.recording.reader import Session, read_session
from tests.support import (
    MosquittoLauncher,
    Process,
    complete_lines,
    logged_events,
    start_process,
    stop_process,
)

T = TypeVar("T")

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"
PATIENCE_S = 120.0
POLL_S = 0.02
PATIENT = {
    "interlocks.stale_s": "2.0",
    "interlocks.start_s": "5.0",
    "interlocks.stop_s": "5.0",
    "interlocks.precharge_timeout_s": "60.0",
    "bus.command_timeout_s": "5.0",
    "voltage_loop.where": '"drive"',
}
"""The longest limits that a file may state, and a drive that holds its own voltage: a machine that
is busy with others trips no drive."""

QUICK_MOTOR = {
    "load.period_s": "0.25",
    "load.samples": "22",
    "load.model.tau_motor_s": "2.925",
    "load.model.tau_filter_s": "2.5",
    "estimator.tau_lambda_s": "2.5",
    "estimator.settle_s": "7.5",
}
"""The motor of the example with a quarter of its inertia, controlled four times as fast."""


def until(find: Callable[[], T | None], what: str, patience_s: float = PATIENCE_S) -> T:
    """Wait until something is found and return it."""
    deadline_s = time.monotonic() + patience_s
    while time.monotonic() < deadline_s:
        if found := find():
            return found
        time.sleep(POLL_S)
    raise AssertionError(f"not within {patience_s:g} s: {what}")


def motor_configuration(
    broker_port: int, bus_port: int, changes: Mapping[str, str], example: str = "motor"
) -> str:
    """An example configuration on other ports, with a drive that is called motor.

    Args:
        broker_port: Where the broker listens.
        bus_port: Port of the bus.
        changes: Values in TOML by `section.key`, empty for a key that keeps its value.
        example: Name of the file, without its suffix.
    """
    text = (EXAMPLES / f"{example}.toml").read_text(encoding="utf-8")
    settings = {"drive.name": '"motor"', "mqtt.port": str(broker_port), **changes}
    for key in ("database", "eds"):
        if found := re.search(rf'^{key} = "(.*)"', text, re.MULTILINE):
            settings.setdefault(f"bus.{key}", f'"{EXAMPLES / found[1]}"')
    if port := re.search(r"^(udp_port|port) = ", text.partition("[mqtt]")[0], re.MULTILINE):
        settings.setdefault(f"bus.{port[1]}", str(bus_port))
    lines = text.splitlines()
    for place, value in settings.items():
        if not value:
            continue
        section, _, key = place.rpartition(".")
        lines = _with_setting(lines, f"[{section}]", key, value)
    return "\n".join(lines) + "\n"


def _with_setting(lines: list[str], header: str, key: str, value: str) -> list[str]:
    """Set a key in a section, which is appended where there is none."""
    if header not in lines:
        return [*lines, "", header, f"{key} = {value}"]
    start = lines.index(header) + 1
    end = next((i for i in range(start, len(lines)) if lines[i].startswith("[")), len(lines))
    kept = [line for line in lines[start:end] if line.partition("=")[0].strip() != key]
    return [*lines[:start], f"{key} = {value}", *kept, *lines[end:]]


@dataclass(frozen=True)
class Heard:
    """One message as mosquitto_sub printed it."""

    topic: str
    payload: str
    retained: bool

    @property
    def content(self) -> dict[str, Any]:
        content = json.loads(self.payload)
        assert isinstance(content, dict)
        return content


class Ear:
    """A mosquitto_sub that writes all it hears into a file."""

    def __init__(self, port: int, log: Path) -> None:
        self._port = port
        self._log = log
        topics = ("-t", "adaptdrive/#", "-t", "tests/ready")
        self._process = start_process(
            ["mosquitto_sub", "-p", str(port), *topics, "-q", "1", "-F", "%r\t%t\t%p"], log
        )
        publish(port, "tests/ready", "now", "-r")
        until(lambda: "tests/ready" in log.read_text(), "mosquitto_sub is subscribed")

    def on(self, name: str) -> list[Heard]:
        """All that was heard on a topic of the drive."""
        return [heard for heard in self.messages() if heard.topic == f"adaptdrive/motor/{name}"]

    def next_on(self, name: str, after: int) -> Heard:
        """Wait for a message after so many others."""
        return until(lambda: self.on(name)[after:], f"a message on {name}")[0]

    def messages(self) -> Iterator[Heard]:
        """All that was heard."""
        for line in complete_lines(self._log):
            parts = line.split("\t", 2)
            if len(parts) == 3:
                yield Heard(parts[1], parts[2], parts[0] == "1")

    def close(self) -> None:
        stop_process(self._process)


def publish(port: int, topic: str, payload: str, *more: str) -> None:
    """Have mosquitto_pub publish one message."""
    command = ["mosquitto_pub", "-p", str(port), "-t", topic, "-q", "1", "-m", payload, *more]
    subprocess.run(command, check=True, timeout=PATIENCE_S)


@dataclass
class Site:
    """One drive and what surrounds it."""

    folder: Path
    launcher: MosquittoLauncher
    broker_port: int
    bus_port: int
    changes: dict[str, str] = field(default_factory=dict)
    example: str = "motor"
    environment: dict[str, str] = field(default_factory=dict)
    broker: Process | None = None
    device: Process | None = None
    daemon: Process | None = None

    def __post_init__(self) -> None:
        self._stack = contextlib.ExitStack()
        self._numbers = itertools.count(1)
        self.config = self.folder / "motor.toml"
        self.write()

    def write(self, changes: Mapping[str, str] | None = None) -> None:
        """Write the configuration, with other changes where they are given."""
        given = self.changes if changes is None else changes
        text = motor_configuration(self.broker_port, self.bus_port, given, self.example)
        self.config.write_text(text, encoding="utf-8")

    # -- processes ---------------------------------------------------------------------------

    def start_broker(self) -> None:
        """Start the broker, and an ear on it."""
        self.broker = self.launcher.start(self.broker_port)
        self._stack.callback(stop_process, self.broker)
        self.ear = Ear(self.broker_port, self.folder / f"heard-{next(self._numbers)}.log")
        self._stack.callback(self.ear.close)

    def start_device(self, *options: str) -> None:
        """Start the simulated drive; it looks for the broker that takes disturbances."""
        broker = ("--broker", f"127.0.0.1:{self.broker_port}")
        self.device = self.start_process(
            "device.log", "-m", "adaptdrive_sim", "device", self.config, *broker, *options
        )
        device = self.device

        def serves() -> bool:
            assert device.poll() is None, self.read("device.log")
            return "simulated drive" in self.read("device.log")

        until(serves, "the drive is on the bus", PATIENCE_S)

    def start_daemon(self, *launcher: str) -> None:
        """Start the daemon and wait until it is on the broker.

        Args:
            launcher: Command that starts it, in front of its own.
        """
        known = len(self.ear.on("availability"))
        words = ("-m", "adaptdrive.cli", "run", self.config)
        self.daemon = self.start_process("daemon.log", *words, launcher=launcher)
        self.await_availability("online", after=known)

    def start(self, *device_options: str) -> None:
        """Start everything."""
        self.start_broker()
        self.start_device(*device_options)
        self.start_daemon()
        self.await_measurement()

    def start_process(self, log: str, *words: str | Path, launcher: Sequence[str] = ()) -> Process:
        environment = os.environ | {"STATE_DIRECTORY": str(self.folder)} | self.environment
        with (self.folder / log).open("ab") as output:
            process = subprocess.Popen(
                [*launcher, sys.executable, *words],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                cwd=self.folder,
                env=environment,
            )
        self._stack.callback(_end, process)
        return process

    def kill(self, process: Process | None) -> float:
        """Kill a process as the kernel does; the monotonic time of it."""
        assert process is not None
        now_s = time.monotonic()
        process.kill()
        process.wait()
        return now_s

    def stop_daemon(self) -> int:
        """Ask the daemon to end; its exit status."""
        assert self.daemon is not None
        self.daemon.terminate()
        return self.daemon.wait(timeout=PATIENCE_S)

    @contextlib.contextmanager
    def stalled(self, process: Process | None) -> Iterator[None]:
        """Keep a process from running meanwhile."""
        assert process is not None
        process.send_signal(signal.SIGSTOP)
        try:
            yield
        finally:
            process.send_signal(signal.SIGCONT)

    def close(self) -> None:
        """End everything that was started."""
        self._stack.close()

    def let_periods_pass(self, count: int) -> None:
        """Wait for some slow periods, as long as each of them comes."""
        known = len(self.ear.on("telemetry/load"))
        for index in range(count):
            self.ear.next_on("telemetry/load", after=known + index)

    # -- operators ---------------------------------------------------------------------------

    def ask(self, verb: str, value: object = None, **fields: object) -> dict[str, Any]:
        """Send a command with mosquitto_pub and return the reply to it."""
        identity = f"{verb}-{next(self._numbers)}"
        payload = json.dumps({"id": identity, "value": value, **fields})
        publish(self.broker_port, f"adaptdrive/motor/command/{verb}", payload)
        return until(lambda: self.reply_to(identity), f"a reply to {payload}")

    def reply_to(self, identity: str) -> dict[str, Any] | None:
        """The reply to a command, None until it comes."""
        replies = [heard.content for heard in self.ear.on("reply")]
        return next((reply for reply in replies if reply["id"] == identity), None)

    def demand(self, verb: str, value: object = None) -> None:
        """Send a command that must be accepted."""
        reply = self.ask(verb, value)
        assert reply["accepted"], reply

    def run_drive(self) -> None:
        """Enable the drive and wait until it runs, with a set-point that V_c can hold."""
        self.demand("enable")
        running = self.await_state(state="running")
        if running["coasting"] and running["mode"] != "manual":  # it was slow before the daemon ran
            self.demand("setpoint", 0.5 * (running["reach"]["low"] + running["reach"]["high"]))
            self.await_state(state="running", coasting=False)

    def disturb(self, *words: str) -> None:
        """Disturb the simulated drive from the command line, once it is back on the broker."""
        broker = ("--broker", f"127.0.0.1:{self.broker_port}")
        command = [sys.executable, "-m", "adaptdrive_sim", "disturb", "motor", *words, *broker]
        until(
            lambda: subprocess.run(command, check=False, timeout=PATIENCE_S).returncode == 0,
            f"the drive is disturbed: {' '.join(words)}",
            PATIENCE_S,
        )

    @property
    def state(self) -> dict[str, Any]:
        """The state as it was published last."""
        return self.ear.on("state")[-1].content

    def await_state(self, patience_s: float = PATIENCE_S, **wanted: object) -> dict[str, Any]:
        """Wait until the state has some values."""

        def find() -> dict[str, Any] | None:
            states = self.ear.on("state")
            if states and wanted.items() <= _hashable(states[-1].content).items():
                return states[-1].content
            return None

        try:
            return until(find, f"state {wanted}", patience_s)
        except AssertionError as late:
            states = self.ear.on("state")
            raise AssertionError(f"{late}; published: {states[-1:]}") from None

    def await_availability(self, wanted: str, after: int = 0) -> None:
        """Wait until the drive is online or offline, by a message after so many others."""

        def find() -> bool:
            heard = self.ear.on("availability")[after:]
            return bool(heard) and heard[-1].payload == wanted

        until(find, wanted, PATIENCE_S)

    def await_measurement(self) -> None:
        """Wait until a report that is still to come has a fresh measurement."""
        known = len(self.ear.on("telemetry/drive"))

        def find() -> bool:
            heard = self.ear.on("telemetry/drive")[known:]
            age_s = heard[-1].content["age_s"] if heard else None
            return age_s is not None and age_s < 1.0

        until(find, "a fresh measurement")

    # -- what is left to read ----------------------------------------------------------------

    def device_events(self, event: str) -> list[dict[str, Any]]:
        """What the simulated drive wrote into its own log."""
        return logged_events(self.folder / "device.log", event)

    @property
    def daemon_log(self) -> str:
        return self.read("daemon.log")

    def session_folder(self, number: int = -1) -> Path:
        """Return a recorded session, by default the last one; of a daemon that ended, all of it."""
        if self.daemon is None or self.daemon.poll() is not None:
            until(lambda: not self.recorders(), "the recorder has written the rest")
        return sorted(self._sessions.glob("[!.]*/"))[number]

    @property
    def _sessions(self) -> Path:
        """Folder of the sessions, in the state folder where a test names one."""
        return Path(self.environment.get("STATE_DIRECTORY") or self.folder) / "sessions"

    def recorders(self) -> list[int]:
        """Processes that write the sessions of this site."""
        mark = os.fsencode(self._sessions)
        found = []
        for words in Path("/proc").glob("[0-9]*/cmdline"):
            with contextlib.suppress(OSError):
                if mark in words.read_bytes().split(b"\0"):
                    found.append(int(words.parent.name))
        return found

    def session(self) -> Session:
        """The last recorded session."""
        return read_session(self.session_folder())

    def replay(self) -> subprocess.CompletedProcess[str]:
        """Have the command line replay the last session."""
        folder = str(self.session_folder())
        command = [sys.executable, "-m", "adaptdrive.cli", "replay", folder]
        return subprocess.run(
            command, check=False, capture_output=True, text=True, timeout=3 * PATIENCE_S
        )

    def read(self, name: str) -> str:
        """What a log of the folder holds by now."""
        path = self.folder / name
        return path.read_text(encoding="utf-8") if path.exists() else ""


def _hashable(content: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in content.items() if not isinstance(value, dict)}


def _end(process: Process) -> None:
    with contextlib.suppress(ProcessLookupError):
        process.send_signal(signal.SIGCONT)
    stop_process(process)


@dataclass(frozen=True)
class Commanded:
    """One command frame."""

    time_s: float
    current_scale_S: float
    bridge: bool

    @property
    def safe(self) -> bool:
        return self.current_scale_S == 0.0 and not self.bridge


class BusEar:
    """Listens to the bus of a site while it is open."""

    def __init__(self, config: Path) -> None:
        bus = load_configuration(config).bus
        assert isinstance(bus, CanBus)
        self._bus = open_bus(bus)
        self._frames: list[tuple[float, can.Message]] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._listen)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        problem: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._ended.set()
        self._thread.join()
        self._bus.shutdown()

    def _listen(self) -> None:
        while not self._ended.is_set():
            frame = self._bus.recv(0.05)
            if frame is not None:
                self._frames.append((time.monotonic(), frame))

    def commands(self) -> list[Commanded]:
        """All commands so far."""
        database = cantools.database.load_file(EXAMPLES / "adaptdrive.dbc")
        assert isinstance(database, Database)
        message = database.get_message_by_name("DriveCommand")
        found = []
        for time_s, frame in list(self._frames):
            if frame.arbitration_id == message.frame_id:
                values = message.decode(bytes(frame.data), decode_choices=False)
                assert isinstance(values, dict)
                scale = float(values["CurrentScale"])  # type: ignore[arg-type]
                found.append(Commanded(time_s, scale, values["BridgeEnable"] == 1))
        return found


class NotifySocket:
    """The service manager's end; notes what it hears and when."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.heard: list[tuple[float, str]] = []
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(path))
        self._socket.settimeout(0.05)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def _listen(self) -> None:
        while not self._ended.is_set():
            try:
                message = self._socket.recv(4096).decode()
            except TimeoutError:
                continue
            self.heard.append((time.monotonic(), message))

    @property
    def messages(self) -> list[str]:
        return [message for _, message in self.heard]

    @property
    def fed(self) -> int:
        return self.messages.count("WATCHDOG=1")

    def catch_up(self) -> None:
        """Wait until all that was sent before has been noted: datagrams keep their order."""
        known = self.messages.count("CAUGHT_UP=1")
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as own:
            own.sendto(b"CAUGHT_UP=1", str(self.path))
        until(lambda: self.messages.count("CAUGHT_UP=1") > known, "the socket has been read")

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        self._socket.close()
