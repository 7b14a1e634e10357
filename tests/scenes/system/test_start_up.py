"""A daemon that cannot start says why, in lines that people can read."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from adaptdrive.cli.standard_files import FAILED, UNUSABLE
from tests.scenes.system.site import START_PATIENCE_S, motor_configuration, until
from tests.support import has_can, stop_process


def run_daemon(config: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "adaptdrive.cli", "run", config],
        check=False,
        capture_output=True,
        text=True,
        timeout=240.0,
        cwd=config.parent,
    )


def test_every_flaw_of_a_configuration_is_listed(tmp_path: Path) -> None:
    config = tmp_path / "motor.toml"
    flawed = {
        "estimator.forgetting": "1.5",
        "load.pole": "2.0",
        "interlocks.stale_s": '"soon"',
    }
    text = motor_configuration(1883, 43113, flawed | {"colour.paint": "1"})
    config.write_text(text, encoding="utf-8")
    run = run_daemon(config)
    assert run.returncode == UNUSABLE
    lines = run.stderr.splitlines()
    for section, key in (place.split(".") for place in flawed):
        assert any(section in line and key in line for line in lines), run.stderr
    assert f"adaptdrive: {config}: colour: Unknown key" in lines
    assert all(line.startswith(f"adaptdrive: {config}: ") for line in lines)
    assert not (tmp_path / "sessions").exists()


def test_a_configuration_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    run = run_daemon(tmp_path / "nothing.toml")
    assert run.returncode == UNUSABLE
    (line,) = run.stderr.splitlines()
    file = tmp_path / "nothing.toml"
    assert line == f"adaptdrive: {file}: file: No such file or directory: '{file}'"


@pytest.mark.skipif(has_can(), reason="this kernel has AF_CAN")
def test_a_bus_that_the_kernel_lacks_is_one_line(tmp_path: Path) -> None:
    config = tmp_path / "motor.toml"
    bus = {"bus.interface": '"socketcan"', "bus.channel": '"can0"'}
    config.write_text(motor_configuration(1, 43113, bus), encoding="utf-8")
    run = run_daemon(config)
    assert run.returncode == FAILED
    complaints = [line for line in run.stderr.splitlines() if line.startswith("adaptdrive: ")]
    (complaint,) = complaints
    assert complaint.startswith("adaptdrive: socketcan can0: this kernel has no AF_CAN; ")
    assert complaint.endswith("for a simulated drive use udp_multicast")
    assert "Traceback" not in run.stderr


def test_a_configuration_from_a_pipe_is_the_one_that_is_recorded(
    tmp_path: Path, free_udp_port: int
) -> None:
    text = motor_configuration(1, free_udp_port, {})
    daemon = subprocess.Popen(
        [sys.executable, "-m", "adaptdrive.cli", "run", "/dev/stdin"],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        cwd=tmp_path,
        env=os.environ | {"STATE_DIRECTORY": str(tmp_path)},
    )
    try:
        assert daemon.stdin is not None
        daemon.stdin.write(text.encode())
        daemon.stdin.close()
        until(lambda: list(tmp_path.glob("sessions/*/config.toml")), "a session", START_PATIENCE_S)
    finally:
        stop_process(daemon)
    (recorded,) = tmp_path.glob("sessions/*/config.toml")
    assert recorded.read_text(encoding="utf-8") == text
