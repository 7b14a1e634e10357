"""docs/own-drive.md, followed word by word: with the simulator, and with a foreign drive."""

from __future__ import annotations

import json
import os
import re
import shlex
import socket
import subprocess
import sys
from pathlib import Path

import pytest
import tomlkit

from tests.peers import fan_drive
from tests.peers.motor import TACHOMETER_Vs
from tests.support import Broker, Process, Spawn, complete_lines, free_port, stop_process
from tests.system.daemon.site import until
from tools.pages.first_hour import PAGE, page_with, walk

pytestmark = pytest.mark.proof

REPLACED = ("heartbeat", "registers", "signals", "command")
LONGEST_S = 900.0
BUSY = {"interlocks": {"stale_s": 1.0}}
"""What a machine needs that runs other tests besides."""


def section() -> str:
    """The part of the page on register maps."""
    text = PAGE.read_text(encoding="utf-8")
    return text[text.index("## A register map") : text.index("## When it stops here")]


def blocks(kind: str) -> list[str]:
    return re.findall(rf"```{kind}\n(.*?)```", section(), flags=re.DOTALL)


def commands() -> list[list[str]]:
    """The commands of the page, in their order."""
    lines = "".join(blocks("console")).splitlines()
    return [shlex.split(line.removeprefix("$ adaptdrive ")) for line in lines]


def edit(document: object, changes: object) -> None:
    """Carry out what the page says: some tables are replaced, of others a key is changed."""
    assert isinstance(document, dict)
    assert isinstance(changes, dict)
    for key, value in changes.items():
        if isinstance(value, dict) and key not in REPLACED:
            edit(document[key], value)
        else:
            document[key] = value


class Reader:
    """A reader of the page in a folder, with a drive and a broker."""

    def __init__(self, folder: Path, broker: Broker, spawn: Spawn) -> None:
        self.folder = folder
        self.broker = broker
        self._spawn = spawn
        self._daemon: Process | None = None

    @property
    def config(self) -> Path:
        return self.folder / "fan.toml"

    def follow(self, words: list[str]) -> str:
        """Enter a command of the page; what it prints."""
        if words[0] == "run":
            self._run(words)
            return ""
        done = subprocess.run(
            [sys.executable, "-m", "adaptdrive.cli", *words],
            cwd=self.folder,
            env=self._environment(),
            capture_output=True,
            text=True,
            timeout=LONGEST_S,
            check=False,
        )
        assert done.returncode == 0, f"{words}: {done.stdout}{done.stderr}"
        return done.stdout

    def _run(self, words: list[str]) -> None:
        """Start the daemon in a terminal of its own, in place of the one before."""
        if self._daemon is not None:
            stop_process(self._daemon)
        program = [sys.executable, "-m", "adaptdrive.cli", words[0], str(self.config)]
        self._daemon = self._spawn("env", *self._assignments(), *program)
        until(self._measures, "a measurement", 120.0)

    def _measures(self) -> bool:
        done = subprocess.run(
            [sys.executable, "-m", "adaptdrive.cli", "status", "fan", "--json"],
            env=self._environment(),
            capture_output=True,
            check=False,
        )
        return done.returncode == 0 and b'"output":null' not in done.stdout.replace(b" ", b"")

    def _environment(self) -> dict[str, str]:
        return os.environ | dict(one.split("=", 1) for one in self._assignments())

    def _assignments(self) -> list[str]:
        host, port = self.broker.host, self.broker.port
        return [f"ADAPTDRIVE_BROKER={host}:{port}", f"STATE_DIRECTORY={self.folder}"]


def drive_events(folder: Path, name: str) -> list[dict[str, float]]:
    lines = [line for log in folder.glob("process-*.log") for line in complete_lines(log)]
    found = [json.loads(line) for line in lines if line.startswith('{"event"')]
    return [event for event in found if event["event"] == name]


@pytest.mark.timeout(1500)
def test_a_register_map_that_is_not_ours_leads_to_adaptive_control(
    tmp_path: Path, spawn: Spawn, mosquitto: Broker
) -> None:
    port = free_port(socket.SOCK_STREAM)
    spawn(sys.executable, fan_drive.__file__, str(port), "2.0")
    until(lambda: drive_events(tmp_path, "ready"), "the drive", 60.0)
    reader = Reader(tmp_path, mosquitto, spawn)
    first, *others = commands()
    reader.follow(first)
    document = tomlkit.parse(reader.config.read_text(encoding="utf-8"))
    for block in blocks("toml"):
        edit(document, tomlkit.parse(block).unwrap())
    edit(document, {"bus": {"port": port}, "mqtt": {"port": mosquitto.port}} | BUSY)
    reader.config.write_text(tomlkit.dumps(document), encoding="utf-8")
    for words in others:
        reader.follow(words)

    def is_adaptive() -> bool:
        state = json.loads(reader.follow(["status", "fan", "--json"]))
        return json.dumps(state).count('"controller": "adaptive"') > 0

    volts = 160.0 * TACHOMETER_Vs

    def is_held() -> bool:
        return abs(drive_events(tmp_path, "state")[-1]["tachometer_V"] - volts) < 0.02 * volts

    until(is_held, "the set-point")
    until(is_adaptive, "adaptive control", 240.0)
    assert is_held()


def labels(page: str) -> list[list[str]]:
    """First word of each line of a recorded text that does not depend on what is measured."""
    blocks = re.findall(r"```console\n\$ adaptdrive (.*?)```", page, re.DOTALL)
    steady = [one for one in blocks if one.startswith(("init", "check", "status"))]
    return [[line.split()[0] for line in one.splitlines() if line.strip()] for one in steady]


@pytest.mark.timeout(1500)
def test_the_commands_of_the_page_lead_to_adaptive_control(tmp_path: Path) -> None:
    page = PAGE.read_text(encoding="utf-8")
    recorded = walk(tmp_path.resolve(), "--patience", "1")
    anew = page_with(recorded, page)
    assert re.search(r"pump holds [\d.]+ rad/s in mode adaptive, in force after [\d.]+ s", anew)
    assert "controller  adaptive (asked for adaptive)" in anew
    assert labels(anew) == labels(page)
    assert (tmp_path / "commission.png").read_bytes().startswith(b"\x89PNG")
