"""A daemon at 120 Hz whose processes are killed at random moments; what its sessions then lack.

Each life of the daemon ends with `kill -9` of the daemon, or of daemon and archiver in either
order; before that its archiver alone may be killed. Commands change the mode ten times a second.
Witnesses of a loss are the clock of the killer, a client of the broker and the log of the daemon:
an event or an answered command that one of them has is recorded, or lost.
"""

from __future__ import annotations

import itertools
import json
import math
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import paho.mqtt.client as paho
from paho.mqtt.enums import CallbackAPIVersion

from adaptdrive.recording.reader import read_session
from adaptdrive.recording.session import Ending, session_directories
from tests.support import Process, children, stop_process
from tests.system.daemon.site import BusEar, motor_configuration, until
from tools.benchmarks.rows import Extent, Row, quantile
from tools.benchmarks.site import broker
from tools.benchmarks.tools import BUSY, bus_ports, process

LONGEST_PAUSE_s = 3.0
PATIENCE_s = 300.0
SETTLED_s = 15.0
"""From a start to its last report about earlier sessions, and past the record of a trip."""
COMMANDS_per_s = 10.0

LONGEST_LOSS_s = 0.25
"""Ticks that a kill may cost: one flush, and the time to write it."""

UNREPORTED_s = 0.25
"""Shortest loss that the next start could report: one flush."""

Witnessed = Counter[tuple[int, str, str]]
"""Tick, kind and text of events."""


@dataclass(frozen=True)
class Death:
    """One `kill -9`.

    Attributes:
        victim: daemon, archiver, or both.
        time_s: When, monotonic.
        session: The newest session then, None before the first.
        commanded_s: When the daemon's last command before it was on the bus, NaN without one: it
            ran no tick after that, however long it then waited for a processor.
        lost_s: Time from the last recorded tick to that; 0 for an archiver alone.
        reported: Whether the next start names the session.
    """

    victim: str
    time_s: float
    session: Path | None
    commanded_s: float = math.nan
    lost_s: float = 0.0
    reported: bool = True


@dataclass
class Drive:
    """One drive whose daemon lives several times."""

    name: str
    folder: Path
    bus_port: int
    broker_port: int
    chance: random.Random
    deaths: list[Death] = field(default_factory=list)
    heard: Witnessed = field(default_factory=Counter)
    answered: set[str] = field(default_factory=set)
    lives: int = 0

    def live(self) -> None:
        """Start the daemon, command it, and kill it and perhaps its archiver before."""
        daemon, log = self._started()
        with _ended(daemon):
            if self.deaths:
                self.deaths[-1] = self._judged(self.deaths[-1], log)
            with self._operator(), BusEar(self.folder / "motor.toml") as ear:
                if self.chance.random() < 0.5:
                    self._pause()
                    self._kill("archiver", daemon)
                self._pause()
                self._kill(self.chance.choice(("daemon", "both")), daemon)
                self.deaths[-1] = replace(self.deaths[-1], commanded_s=_last_command_s(ear))

    def rest(self) -> None:
        """Start a last time, and end in order."""
        daemon, log = self._started()
        with _ended(daemon):
            self.deaths[-1] = self._judged(self.deaths[-1], log)
            time.sleep(SETTLED_s)

    def events_lost(self) -> Witnessed:
        """Return the events that a witness has and no session."""
        recorded: Witnessed = Counter()
        for directory in session_directories(self.folder / "sessions"):
            events = read_session(directory).events
            recorded.update((one.tick, one.kind, one.detail) for one in events)
        return (self.logged() | self.heard) - recorded

    def commands_lost(self) -> set[str]:
        """Return the ids of the commands that were answered and are in no session."""
        recorded: set[str] = set()
        for directory in session_directories(self.folder / "sessions"):
            recorded.update(one.id for one in read_session(directory).commands)
        return self.answered - recorded

    def ticks_missing(self) -> int:
        """Return the ticks that sessions lack between their first and their last."""
        missing = 0
        for directory in session_directories(self.folder / "sessions"):
            numbers = read_session(directory).ticks["sequence"].to_pylist()
            missing += numbers[-1] + 1 - len(numbers) if numbers else 0
        return missing

    def _started(self) -> tuple[Process, Path]:
        self.lives += 1
        config, log = self.folder / "motor.toml", self.folder / f"daemon-{self.lives:04}.log"
        changes = {"drive.name": f'"{self.name}"', "interlocks.stale_s": "0.5"}
        config.write_text(motor_configuration(self.broker_port, self.bus_port, changes))
        command = [sys.executable, "-m", "adaptdrive.cli", "run", str(config)]
        with log.open("wb") as output:
            daemon = subprocess.Popen(
                command, stdout=output, stderr=output, cwd=self.folder, env=BUSY
            )
        before = len(self._sessions())
        try:
            until(lambda: len(self._sessions()) > before, "a session begins", PATIENCE_s)
        except AssertionError as problem:
            stop_process(daemon)
            raise RuntimeError(f"{problem}: {log.read_text(encoding='utf-8')[-2000:]}") from None
        return daemon, log

    def _sessions(self) -> list[Path]:
        return list(session_directories(self.folder / "sessions"))

    def _pause(self) -> None:
        time.sleep(self.chance.uniform(0.0, LONGEST_PAUSE_s))

    def _kill(self, victim: str, daemon: Process) -> None:
        archivers = [one for one in children(daemon.pid) if _archives(one)]
        victims = {"daemon": [daemon.pid], "archiver": archivers}
        pids = victims.get(victim, [daemon.pid, *archivers])
        self.chance.shuffle(pids)
        now_s = time.monotonic()
        for pid in pids:
            os.kill(pid, signal.SIGKILL)
        if victim != "archiver":
            daemon.wait()
        self.deaths.append(Death(victim, now_s, self._sessions()[-1]))

    def _judged(self, death: Death, log: Path) -> Death:
        """Add what was lost, once the next daemon has closed the session."""
        if death.victim == "archiver" or death.session is None:
            return death
        session = death.session
        until(lambda: read_session(session).info.ended is not Ending.OPEN, "a close", PATIENCE_s)
        lost_s = _lost_s(session, death.commanded_s)
        reported = lost_s < UNREPORTED_s or _appears(session.name, log)
        return replace(death, lost_s=lost_s, reported=reported)

    def _operator(self) -> Operator:
        return Operator(self.name, self.broker_port, self.heard, self.answered)

    def logged(self) -> Witnessed:
        """Return the events that the logs of all lives have."""
        found: Witnessed = Counter()
        for log in sorted(self.folder.glob("daemon-*.log")):
            whole, _, _ = log.read_text(encoding="utf-8").rpartition("\n")
            entries = [json.loads(line) for line in whole.splitlines() if line.startswith("{")]
            found.update((e["tick"], e["kind"], e["event"]) for e in entries if "kind" in e)
        return found


@contextmanager
def _ended(daemon: Process) -> Iterator[None]:
    """Leave neither daemon nor archiver behind that writes into a folder which is removed."""
    try:
        yield
    finally:
        archivers = [one for one in children(daemon.pid) if _archives(one)]
        stop_process(daemon)
        until(lambda: not any(map(_archives, archivers)), "the archiver ends", PATIENCE_s)


class Operator:
    """A client that changes the mode again and again, and notes each event and each answer."""

    def __init__(self, drive: str, port: int, heard: Witnessed, answered: set[str]) -> None:
        self._topic = f"adaptdrive/{drive}"
        self._heard = heard
        self._answered = answered
        self._ended = threading.Event()
        self._client = paho.Client(CallbackAPIVersion.VERSION2)
        self._client.on_message = self._note
        self._client.connect("127.0.0.1", port)
        self._client.subscribe([(f"{self._topic}/{name}", 1) for name in ("event", "reply")])
        self._thread = threading.Thread(target=self._command)

    def __enter__(self) -> None:
        self._client.loop_start()
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        self._client.disconnect()
        self._client.loop_stop()

    def _note(self, _client: object, _data: object, message: paho.MQTTMessage) -> None:
        event = json.loads(message.payload)
        if message.topic.endswith("/reply"):
            self._answered.add(event["id"])
            return
        self._heard[event["tick"], event["kind"], event["detail"]] = 1  # may come again

    def _command(self) -> None:
        for mode in itertools.cycle(("adaptive", "fixed")):
            payload = {"id": f"{mode}-{time.monotonic_ns()}", "value": mode}
            self._client.publish(f"{self._topic}/command/mode", json.dumps(payload), qos=1)
            if self._ended.wait(1.0 / COMMANDS_per_s):
                return


def rows(extent: Extent) -> Iterator[Row]:
    """All rows of this file."""
    kills = extent.pick(int(os.environ.get("KILLS", "200")), 12, 2)
    with TemporaryDirectory() as name:
        yield from _judged(run(Path(name), kills, seed=int(time.time())))


def run(folder: Path, kills: int, seed: int) -> Drive:
    """Kill so often; the drive with what is left on disk.

    Args:
        folder: Takes everything.
        kills: How often.
        seed: Of the random moments.
    """
    with ExitStack() as stack:
        _, broker_port = stack.enter_context(broker(folder))
        (port,) = bus_ports(1)
        drive = Drive("d0", folder / "d0", port, broker_port, random.Random(seed))
        drive.folder.mkdir()
        words = [str(port), "1", str(folder / "late")]
        stack.enter_context(process([sys.executable, "-m", "tools.benchmarks.player", *words]))
        until((folder / "late").exists, "the drive sends", PATIENCE_s)
        while len(drive.deaths) < kills:
            drive.live()
        drive.rest()
        return drive


def _judged(drive: Drive) -> Iterator[Row]:
    deaths = drive.deaths
    lost_s = [death.lost_s for death in deaths if death.victim != "archiver"]
    counts = ", ".join(f"{n} {victim}" for victim, n in Counter(d.victim for d in deaths).items())
    yield Row(
        f"longest loss of ticks in {len(deaths)} kills",
        max(lost_s),
        "s",
        target=f"at most {LONGEST_LOSS_s:g} s",
        met=max(lost_s) <= LONGEST_LOSS_s,
        note=f"{counts}; median {quantile(lost_s, 0.5):.2f} s",
    )
    missing = drive.ticks_missing()
    yield Row("ticks missing within sessions", missing, "", target="none", met=not missing)
    witnessed = (drive.heard | drive.logged()).total()
    lost = list(drive.events_lost().elements())
    note = f"of {witnessed} witnessed; " + "; ".join(map(str, lost[:5]))
    yield Row("events lost", len(lost), "", target="none", met=not lost, note=note)
    unrecorded = sorted(drive.commands_lost())
    note = f"of {len(drive.answered)} answered; " + "; ".join(unrecorded[:5])
    name = "answered commands lost"
    yield Row(name, len(unrecorded), "", target="none", met=not unrecorded, note=note)
    silent = [death for death in deaths if not death.reported]
    note = "; ".join(f"{one.victim} {one.lost_s:.2f} s of {one.session}" for one in silent[:5])
    name = "losses that the next start did not report"
    yield Row(name, len(silent), "", target="none", met=not silent, note=note)


def _lost_s(session: Path, commanded_s: float) -> float:
    """Return the time from the last tick of a session, or else from its first event, to another."""
    if math.isnan(commanded_s):
        return 0.0
    read = read_session(session)
    if read.ticks.num_rows:
        return max(0.0, commanded_s - float(read.ticks["monotonic_s"][-1].as_py()))
    return max((commanded_s - one.monotonic_s for one in read.events if one.tick > 0), default=0.0)


def _last_command_s(ear: BusEar) -> float:
    """Return when the last command was heard, monotonic; NaN without one."""
    return max((one.time_s for one in ear.commands()), default=math.nan)


def _archives(pid: int) -> bool:
    try:
        return b"recording.archiver" in Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return False


def _appears(text: str, log: Path) -> bool:
    try:
        return bool(until(lambda: text in log.read_text(encoding="utf-8"), text, 10.0))
    except AssertionError:
        return False
