"""The end of an experiment that its operator ends: a drive whose stop is confirmed, or named."""

from __future__ import annotations

import asyncio
import os
import shutil
import subprocess
import sys
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.pseudo_terminal import Screen
from tests.support import Broker
from tests.unit.commissioning.answering_drive import answering_drive

pytestmark = pytest.mark.proof

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"
PATIENCE_S = 120.0
HELD_S = 1.0
"""Time for which an answer is kept back after the operator asked for the end again."""

Command = subprocess.Popen[bytes]


@pytest.fixture
def motor(tmp_path: Path) -> Path:
    """The configuration of a motor drive in a folder of its own."""
    shutil.copy(EXAMPLES / "adaptdrive.dbc", tmp_path)
    name = f"motor-{uuid.uuid4()}"
    text = (EXAMPLES / "motor.toml").read_text(encoding="utf-8")
    file = tmp_path / f"{name}.toml"
    file.write_text(text.replace('"motor"  ', f'"{name}"  ', 1), encoding="utf-8")
    return file


@contextmanager
def commissioning(
    broker: Broker,
    motor: Path,
    terminal: int | None = None,
    around: Mapping[str, str] | None = None,
) -> Iterator[Command]:
    """Run the command on a drive; it ends with the test."""
    words = ["commission", motor.stem, "--config", str(motor), "--yes"]
    process = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "adaptdrive.cli",
            *words,
            "--broker",
            f"{broker.host}:{broker.port}",
        ],
        cwd=motor.parent,
        env=os.environ | {"TERM": "xterm", "LINES": "24", "COLUMNS": "80"} | dict(around or {}),
        stdin=subprocess.DEVNULL if terminal is None else terminal,
        stdout=subprocess.DEVNULL if terminal is None else terminal,
        stderr=subprocess.STDOUT,
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()


async def until(find: Callable[[], object]) -> None:
    """Wait until something is found."""
    async with asyncio.timeout(PATIENCE_S):
        while not find():  # noqa: ASYNC110 - a process sets no event
            await asyncio.sleep(0.02)


def has_ended(process: Command, screen: Screen) -> bool:
    """Return whether a process has ended, which waits until its screen was read."""
    screen.read()
    return process.poll() is not None


@pytest.fixture
def screen() -> Iterator[Screen]:
    screen = Screen()
    yield screen
    screen.close()


async def test_a_key_that_is_held_down_ends_an_experiment_once(
    mosquitto: Broker, motor: Path, screen: Screen
) -> None:
    async with answering_drive(mosquitto, motor.stem) as drive:
        with commissioning(mosquitto, motor, screen.inner) as process:
            await until(lambda: "waiting for rest" in screen.read())
            screen.press("q")
            await until(drive.stopped.is_set)
            screen.press("q")
            await asyncio.sleep(HELD_S)
            drive.answers_stop.set()
            await until(lambda: has_ended(process, screen))
    assert process.returncode == 1
    assert "ended by a key: the drive is off" in screen.read()
    assert drive.verbs == ["mode", "enable", "voltage", "disable", "mode"]
    assert drive.mode == "fixed"


async def test_a_stopped_terminal_holds_up_no_experiment(
    mosquitto: Broker, motor: Path, screen: Screen
) -> None:
    """Its voltages are asked for all the while: without them the drive would trip."""
    async with answering_drive(mosquitto, motor.stem) as drive:
        drive.answers_stop.set()
        around = {"TERM": "dumb"}
        with commissioning(mosquitto, motor, screen.inner, around) as process:
            await until(lambda: "no picture" in screen.read())
            screen.press("\x13")
            await until(lambda: "voltage" in drive.verbs)
            await asyncio.sleep(HELD_S)
            screen.press("q")
            await until(drive.stopped.is_set)
            screen.press("\x11")
            await until(lambda: has_ended(process, screen))
    assert "ended by a key: the drive is off" in screen.read()
