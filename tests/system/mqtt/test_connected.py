"""A program and a shell at a drive, over a real broker."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import TypeVar

import pytest

from adaptdrive import lab
from adaptdrive.connected import ConnectedDrive
from adaptdrive.mqtt import connection
from adaptdrive.mqtt.client import NoAnswerError
from adaptdrive.runtime.requests import Enable, SetSetpoint
from adaptdrive.util.errors import RefusedError
from tests.support import Broker
from tests.unit.mqtt.peers import Bench, drive_report, load_report, serving

T = TypeVar("T")


async def beside(bench: Bench, program: Callable[[], T]) -> T:
    """Result of a program of plain calls, while the daemon publishes telemetry."""
    running = asyncio.create_task(asyncio.to_thread(program))
    while not running.done():
        bench.hub.publish(load_report(7))
        bench.hub.publish(drive_report(600))
        await asyncio.sleep(0.05)
    return running.result()


async def test_a_program_reads_and_commands_a_drive_until_it_is_silent(
    mosquitto: Broker, tmp_path: Path
) -> None:
    broker = connection.Broker(host=mosquitto.host, port=mosquitto.port)

    def experiment() -> ConnectedDrive:
        with pytest.raises(NoAnswerError, match="nobody: no answer"):
            lab.connect("nobody", broker, timeout_s=0.5)
        drive = lab.connect("bench", broker)
        drive.enable()
        drive.setpoint(3.0)
        drive.wait_until(lambda d: d.setpoint_asked == 3.0 and d.state == "running")
        with pytest.raises(RefusedError, match="outside 0…4"):
            drive.setpoint(9.0)
        with pytest.raises(TimeoutError, match=r"within 0.2 s; bench: running, speed 3.1 V"):
            drive.wait_until(lambda d: d.output > 4.0, timeout_s=0.2)
        assert {"output", "reference", "setpoint"} <= set(dir(drive))
        assert "<td>output</td><td>3.1 V</td>" in drive._repr_html_()
        with pytest.raises(AttributeError, match="'speeed'"):
            drive.speeed  # noqa: B018 - it is looked up
        return drive

    async with serving(mosquitto, "bench", tmp_path) as bench:
        drive = await beside(bench, experiment)
        assert bench.host.asked == [Enable(), SetSetpoint(3.0)]
        with pytest.raises(NoAnswerError, match="telemetry is"):
            await asyncio.to_thread(drive.wait_until, lambda d: d.output > 4.0)
        await asyncio.to_thread(drive.close)
        assert bench.host.asked == [Enable(), SetSetpoint(3.0)]
    assert "telemetry is" in repr(drive)


@pytest.mark.skipif(find_spec("IPython") is None, reason="IPython is not installed")
async def test_a_shell_has_the_drive_at_hand(mosquitto: Broker, tmp_path: Path) -> None:
    where = ("--broker", f"{mosquitto.host}:{mosquitto.port}")
    async with serving(mosquitto, "alpha", tmp_path) as bench:
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "adaptdrive.cli", "shell", "alpha", *where),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "IPYTHONDIR": str(tmp_path)},
        )
        typed = b"drive.setpoint(2.5)\ndrive.output\ndrive.setpoint(9)\ndrive.live(0.5)\nexit\n"
        ending = asyncio.create_task(process.communicate(typed))
        while not ending.done():
            bench.hub.publish(drive_report(600))
            await asyncio.sleep(0.05)
        output, _ = await ending
        assert bench.host.asked == [SetSetpoint(2.5)]
    said = output.decode()
    assert process.returncode == 0, said
    assert "alpha: standby, speed 3.1 V\n" in said
    assert "Out[2]: 3.1 V" in said
    assert " setpoint 9.0 is outside 0…4.0" in said
    assert "Image object" in said
    assert "Traceback" not in said
