"""One drive with everything around it, as real processes, and the clients that nobody here wrote.

A site has a bus, a broker and a folder of its own. Broker, simulated drive and daemon are started
and ended one by one, so that a test may take away what it likes.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from adaptdrive.recording.reader import Session, read_session
from tests.support import (
    MosquittoLauncher,
    Process,
    complete_lines,
    logged_events,
    prefer,
    serve_promptly,
    start_process,
    stop_process,
)

T = TypeVar("T")

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"
PATIENCE_S = 120.0
START_PATIENCE_S = 240.0
"""Interpreter and numeric libraries of a process, where five others start at the same time."""

PATIENT_DRIVE = ("--command-timeout", "1.0")
"""Options of a simulated drive that must not stop by itself while the machine runs others."""
POLL_S = 0.02

QUICK_MOTOR = {
    "load.period_s": "0.25",
    "load.samples": "22",
    "load.model.tau_motor_s": "2.925",
    "load.model.tau_filter_s": "2.5",
    "estimator.tau_lambda_s": "2.5",
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


def motor_configuration(broker_port: int, bus_port: int, changes: Mapping[str, str]) -> str:
    """The example configuration on other ports.

    Args:
        broker_port: Where the broker listens.
        bus_port: Port of the bus.
        changes: Values in TOML by `section.key`.
    """
    settings = {
        "bus.udp_port": str(bus_port),
        "bus.database": f'"{EXAMPLES / "adaptdrive.dbc"}"',
        "mqtt.port": str(broker_port),
        **changes,
    }
    lines = (EXAMPLES / "motor.toml").read_text(encoding="utf-8").splitlines()
    for place, value in settings.items():
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
        return [heard for heard in self._messages() if heard.topic == f"adaptdrive/motor/{name}"]

    def next_on(self, name: str, after: int) -> Heard:
        """Wait for a message after so many others."""
        return until(lambda: self.on(name)[after:], f"a message on {name}")[0]

    def _messages(self) -> Iterator[Heard]:
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
    environment: dict[str, str] = field(default_factory=dict)
    broker: Process | None = None
    device: Process | None = None
    daemon: Process | None = None

    def __post_init__(self) -> None:
        self._stack = contextlib.ExitStack()
        self._numbers = itertools.count(1)
        self.config = self.folder / "motor.toml"
        text = motor_configuration(self.broker_port, self.bus_port, self.changes)
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
        self.device = self._start(
            "device.log", "-m", "adaptdrive_sim", "device", self.config, *broker, *options
        )
        device = self.device

        def serves() -> bool:
            assert device.poll() is None, self._read("device.log")
            return "simulated drive" in self._read("device.log")

        until(serves, "the drive is on the bus", START_PATIENCE_S)
        prefer(device)

    def start_daemon(self, *launcher: str) -> None:
        """Start the daemon and wait until it is on the broker.

        Args:
            launcher: Command that starts it, in front of its own.
        """
        known = len(self.ear.on("availability"))
        words = ("-m", "adaptdrive.cli", "run", self.config)
        self.daemon = self._start("daemon.log", *words, launcher=launcher)
        self.await_availability("online", after=known)
        prefer(self.daemon)
        self._prefer_recorders()

    def start(self, *device_options: str) -> None:
        """Start everything."""
        self.start_broker()
        self.start_device(*device_options)
        self.start_daemon()
        self.await_measurement()

    def _start(self, log: str, *words: str | Path, launcher: Sequence[str] = ()) -> Process:
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
        self._prefer_recorders()  # again: they step aside when they have started
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
        return until(lambda: self._reply(identity), f"a reply to {payload}")

    def _reply(self, identity: str) -> dict[str, Any] | None:
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
            lambda: subprocess.run(command, check=False, timeout=START_PATIENCE_S).returncode == 0,
            f"the drive is disturbed: {' '.join(words)}",
            START_PATIENCE_S,
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

        until(find, wanted, START_PATIENCE_S)

    def await_measurement(self) -> None:
        """Wait until a report that is still to come has a fresh measurement."""
        known = len(self.ear.on("telemetry/drive"))

        def find() -> bool:
            heard = self.ear.on("telemetry/drive")[known:]
            return bool(heard) and (heard[-1].content["age_s"] or 1.0) < 0.05

        until(find, "a fresh measurement")

    # -- what is left to read ----------------------------------------------------------------

    def device_events(self, event: str) -> list[dict[str, Any]]:
        """What the simulated drive wrote into its own log."""
        return logged_events(self.folder / "device.log", event)

    @property
    def daemon_log(self) -> str:
        return self._read("daemon.log")

    def session_folder(self, number: int = -1) -> Path:
        """Return a recorded session, by default the last one; of a daemon that ended, all of it."""
        if self.daemon is None or self.daemon.poll() is not None:
            until(lambda: not self._recorders(), "the recorder has written the rest")
        return sorted(self._sessions.glob("[!.]*"))[number]

    @property
    def _sessions(self) -> Path:
        """Folder of the sessions, in the state folder where a test names one."""
        return Path(self.environment.get("STATE_DIRECTORY") or self.folder) / "sessions"

    def _prefer_recorders(self) -> None:
        """Let the recorder write what is left within the 2 s that the daemon waits at its end."""
        for recorder in self._recorders():
            serve_promptly(int(recorder.name))

    def _recorders(self) -> list[Path]:
        """Processes that write the sessions of this site."""
        mark = os.fsencode(self._sessions)
        found = []
        for words in Path("/proc").glob("[0-9]*/cmdline"):
            with contextlib.suppress(OSError):
                if mark in words.read_bytes().split(b"\0"):
                    found.append(words.parent)
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

    def _read(self, name: str) -> str:
        path = self.folder / name
        return path.read_text(encoding="utf-8") if path.exists() else ""


def _hashable(content: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in content.items() if not isinstance(value, dict)}


def _end(process: Process) -> None:
    with contextlib.suppress(ProcessLookupError):
        process.send_signal(signal.SIGCONT)
    stop_process(process)
