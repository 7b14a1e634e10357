"""Whole demonstrations: real processes on a real bus, in real time."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import pytest

from adaptdrive.recording.reader import read_session
from tests.support import Process, Spawn, sample

PATIENCE_S = 120.0


@dataclass(frozen=True, slots=True)
class Demo:
    """A demonstration that was started, its folder and what it has said."""

    process: Process
    directory: Path
    output: Path

    def ended(self) -> int:
        return self.process.wait(timeout=PATIENCE_S)

    def succeeds(self) -> None:
        """Wait for an end without fault, on a busy machine too."""
        assert self.ended() == 0, self.output.read_text()

    def wait_for(self, log: str, text: str) -> None:
        """Wait until a log says something."""
        deadline = time.monotonic() + PATIENCE_S
        path = self.directory / f"{log}.log"
        while not path.exists() or text not in path.read_text():
            if self.process.poll() is not None:
                pytest.fail(f"the demonstration ended: {self.output.read_text()}")
            assert time.monotonic() < deadline, f"{text!r} is not in {path}"
            time.sleep(0.05)

    def summary(self) -> dict[str, Any]:
        """The line of JSON."""
        lines = self.output.read_text().splitlines()
        found = [line for line in lines if line.startswith("{")]
        assert len(found) == 1, lines
        summary: dict[str, Any] = json.loads(found[0])
        return summary

    def members(self) -> dict[int, str]:
        """Living processes that belong to this demonstration, by their command lines."""
        settings = self.directory / "motor.toml"
        port = tomllib.loads(settings.read_text())["mqtt"]["port"] if settings.exists() else 0
        marks = (str(self.directory), f"broker_main 127.0.0.1:{port}")
        return {
            pid: line
            for pid, line in _commands().items()
            if any(mark in line for mark in marks) and pid != self.process.pid
        }

    def is_gone(self) -> None:
        """Wait until none of its processes is left."""
        deadline = time.monotonic() + PATIENCE_S
        while self.members():
            assert time.monotonic() < deadline, self.members()
            time.sleep(0.1)

    def pid_of(self, part: str) -> int:
        """The process whose command line has a part."""
        return next(pid for pid, line in self.members().items() if part in line)


def _commands() -> dict[int, str]:
    """Command lines of all living processes of this machine."""
    found = {}
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            found[int(path.parent.name)] = path.read_text().replace("\0", " ")
        except OSError:  # it has just ended
            continue
    return found


class Start(Protocol):
    """Starts a headless demonstration with more options."""

    def __call__(self, *options: str, story: str = "motor") -> Demo: ...


@pytest.fixture
def start(spawn: Spawn, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Start:
    """Start headless demonstrations in an empty folder."""
    empty = tmp_path / "empty"
    empty.mkdir()
    monkeypatch.chdir(empty)
    started: list[Demo] = []

    def begin(*options: str, story: str = "motor") -> Demo:
        directory = tmp_path / f"demo-{len(started)}"
        command = [sys.executable, "-m", "adaptdrive_sim", "demo", story, "--headless"]
        folder = [f"--directory={directory}"] if story == "motor" else []
        process = spawn(*command, *folder, *options)
        demo = Demo(process, directory, tmp_path / f"process-{len(started)}.log")
        started.append(demo)
        return demo

    return begin


def test_the_motor_is_held_recorded_and_summed_up_in_one_line(start: Start) -> None:
    demo = start("--duration=8")
    demo.succeeds()
    assert len(demo.output.read_text().splitlines()) == 1
    summary = demo.summary()
    assert summary["ok"] is True
    assert summary["state"] == "running"
    assert summary["controller"] == "fixed"
    assert summary["truth"]["tau_sum_s"] == pytest.approx(21.7)
    session = read_session(Path(summary["session"]))
    assert session.info.ended == "orderly"
    assert "run" in session.ticks["stage"].to_pylist()
    for log in demo.directory.glob("*.log"):
        assert "Traceback" not in log.read_text()
    assert demo.members() == {}


@pytest.mark.proof
def test_a_killed_daemon_is_told_of_and_takes_all_with_it(start: Start) -> None:
    demo = start("--duration=60")
    demo.wait_for("daemon", "starting to running")
    os.kill(demo.pid_of("adaptdrive.cli run"), signal.SIGKILL)
    assert demo.ended() == 1
    summary = demo.summary()
    assert summary["ok"] is False
    assert summary["reason"].startswith("the daemon was ended by SIGKILL")
    assert "adaptdrive-sim: the daemon was ended by SIGKILL" in demo.output.read_text()
    demo.is_gone()  # the recorder writes the rest first
    assert '"safe"' in (demo.directory / "drive.log").read_text()


@pytest.mark.parametrize("name", sample(["bath", "battery", "braking"], 1))
def test_a_story_in_virtual_time_prints_one_line_of_json(start: Start, name: str) -> None:
    demo = start("--duration=120", "--speed=100000", story=name)
    demo.succeeds()
    assert demo.summary()["demo"] == name
    assert demo.summary()["ok"] is True
    assert demo.summary()["state"] == "running"
    refused = start("--duration=0", story=name)
    assert refused.ended() == 1
    assert "--duration 0" in refused.output.read_text()
    assert "Traceback" not in refused.output.read_text()
