"""The daemon and the command line as processes, on the broker that is shipped."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.deploy.broker import GuardedBroker
from tests.scenes.system.site import motor_configuration, until
from tests.support import start_process, stop_process

Adaptdrive = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def daemon(guarded: GuardedBroker, free_udp_port: int, tmp_path: Path) -> Iterator[Path]:
    """A running daemon without a drive, known to the broker as `motor`; its log."""
    config, log = tmp_path / "motor.toml", tmp_path / "daemon.log"
    settings = {
        "mqtt.tls": "true",
        "mqtt.ca_file": f'"{guarded.authority}"',
        "mqtt.username": '"motor"',
        "mqtt.password_file": f'"{guarded.password_file("motor")}"',
        "recording.enabled": "false",
    }
    config.write_text(motor_configuration(guarded.port, free_udp_port, settings), encoding="utf-8")
    process = start_process([*_COMMAND, "run", config], log, {"STATE_DIRECTORY": str(tmp_path)})
    yield log
    stop_process(process)


_COMMAND = (sys.executable, "-m", "adaptdrive.cli")


@pytest.fixture
def adaptdrive(guarded: GuardedBroker) -> Adaptdrive:
    """Runs the command line as a user who keeps broker and credentials in the environment."""

    def run(user: str, *words: str) -> subprocess.CompletedProcess[str]:
        environment = os.environ | {
            "ADAPTDRIVE_BROKER": f"localhost:{guarded.port}",
            "ADAPTDRIVE_TLS": "true",
            "ADAPTDRIVE_CA_FILE": str(guarded.authority),
            "ADAPTDRIVE_USERNAME": user,
            "ADAPTDRIVE_PASSWORD_FILE": str(guarded.password_file(user)),
        }
        command = [*_COMMAND, *words, "--timeout", "3"]
        return subprocess.run(
            command, env=environment, capture_output=True, text=True, check=False, timeout=60
        )

    return run


def mode_of(adaptdrive: Adaptdrive, user: str) -> str:
    """The mode that a user reads from the drive's state, empty when there is none yet."""
    said = adaptdrive(user, "status", "motor", "--json")
    return json.loads(said.stdout)["state"]["mode"] if said.returncode == 0 else ""


@pytest.mark.slow
def test_an_operator_commands_and_a_viewer_only_looks(daemon: Path, adaptdrive: Adaptdrive) -> None:
    until(lambda: "broker connected" in daemon.read_text(), "the daemon is on the broker")
    until(lambda: mode_of(adaptdrive, "viewer") == "fixed", "a viewer reads the status")
    accepted = adaptdrive("operator", "mode", "motor", "adaptive")
    assert accepted.returncode == 0, accepted.stderr
    until(lambda: mode_of(adaptdrive, "viewer") == "adaptive", "a viewer sees what was done")
    refused = adaptdrive("operator", "enable", "motor")
    assert refused.returncode == 1
    assert "no measurement yet" in refused.stderr
    assert adaptdrive("viewer", "mode", "motor", "fixed").returncode == 3
    assert mode_of(adaptdrive, "operator") == "adaptive"
