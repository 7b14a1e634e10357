"""Who may do what on the shipped broker: as mosquitto sees it, and the daemon behind TLS."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path

import pytest

from tests.support import MosquittoLauncher, free_port, start_process, stop_process
from tests.system.access.broker import Ear, GuardedBroker, make_broker, password
from tests.system.daemon.site import motor_configuration, until

Listen = Callable[[str], Ear]
Adaptdrive = Callable[..., subprocess.CompletedProcess[str]]
_COMMAND = (sys.executable, "-m", "adaptdrive.cli")

NAMES = ("availability", "state", "telemetry/load", "telemetry/drive", "event", "reply", "history")
OWN = [f"adaptdrive/motor/{name}" for name in NAMES]
OTHERS = [f"adaptdrive/bath/{name}" for name in NAMES]
OWN_STOP = "adaptdrive/motor/command/disable"
OWN_PROBE = "adaptdrive/motor/command/probe"
COMMANDS = [f"adaptdrive/{drive}/command/{verb}" for drive in ("motor", "bath") for verb in "ab"]
QUESTIONS = [f"adaptdrive/{drive}/ask/history" for drive in ("motor", "bath")]
ELSEWHERE = ["adaptdrive", "adaptdrive/motor", "adaptdrive/motor/state/x", "adaptdrive//state"]


@pytest.fixture(scope="module")
def _guarded_broker(
    _mosquitto_program: MosquittoLauncher, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[GuardedBroker]:
    for program in ("openssl", "mosquitto_passwd", "mosquitto_pub", "mosquitto_sub"):
        if shutil.which(program) is None:
            pytest.skip(f"{program} is not installed")
    folder = tmp_path_factory.mktemp("guarded")
    broker, process = make_broker(folder, _mosquitto_program.program, free_port(socket.SOCK_STREAM))
    yield broker
    stop_process(process)


@pytest.fixture
def guarded(outside: None, _guarded_broker: GuardedBroker) -> GuardedBroker:
    """The broker as it is shipped, for all tests of this file."""
    return _guarded_broker


@pytest.fixture
def listen(guarded: GuardedBroker, tmp_path: Path) -> Iterator[Listen]:
    """Let a user hear all that he may until the test ends."""
    ears: list[Ear] = []
    numbers = count()

    def start(user: str) -> Ear:
        ears.append(Ear(guarded, user, tmp_path / f"{user}-{next(numbers)}.log"))
        return ears[-1]

    yield start
    for ear in ears:
        ear.close()


def heard(
    broker: GuardedBroker, listen: Listen, listener: str, speaker: str, topics: list[str]
) -> list[str]:
    """What a listener hears of all that a speaker tries to publish."""
    ear = listen(listener)
    for topic in topics:
        broker.publish(speaker, topic)
    return ear.topics()


def test_a_drive_speaks_for_itself_alone(guarded: GuardedBroker, listen: Listen) -> None:
    other_stop = OWN_STOP.replace("motor", "bath")
    others = [*COMMANDS, *QUESTIONS, *ELSEWHERE]
    tried = [*OWN, *OTHERS, *others, "adaptdrive/operator/state", other_stop, OWN_STOP, OWN_PROBE]
    assert heard(guarded, listen, "operator", "motor", tried) == [*OWN, OWN_STOP, OWN_PROBE]


def test_a_drive_hears_its_own_commands_only(guarded: GuardedBroker, listen: Listen) -> None:
    own = [topic for topic in COMMANDS if topic.startswith("adaptdrive/motor/")]
    assert heard(guarded, listen, "motor", "operator", COMMANDS) == own
    assert heard(guarded, listen, "motor", "bath", OTHERS) == []
    telemetry = ["adaptdrive/motor/telemetry/drive"]
    assert heard(guarded, listen, "motor", "motor", [*OWN, OWN_PROBE]) == [*telemetry, OWN_PROBE]


@pytest.mark.parametrize(
    ("user", "drive", "denied"),
    [
        ("motor", "motor", False),
        ("motor", "bath", True),
        ("viewer", "viewer", True),
        ("operator", "operator", True),
        ("operator", "motor", True),
    ],
)
def test_a_drive_announces_itself_alone(
    guarded: GuardedBroker, user: str, drive: str, *, denied: bool
) -> None:
    topic = f"homeassistant/device/adaptdrive-{drive}/config"
    words = ("-V", "mqttv5", "-q", "1", "-t", topic, "-m", "{}")
    command = guarded.client("mosquitto_pub", *guarded.credentials(user), *words)
    tried = subprocess.run(command, check=False, capture_output=True, text=True, timeout=20)
    assert ("Not authorized" in tried.stderr) is denied


def test_a_drive_hears_what_it_is_asked(guarded: GuardedBroker, listen: Listen) -> None:
    assert heard(guarded, listen, "motor", "viewer", QUESTIONS) == QUESTIONS[:1]


def test_an_operator_commands_and_speaks_for_no_drive(
    guarded: GuardedBroker, listen: Listen
) -> None:
    tried = [*COMMANDS, *QUESTIONS, *OWN, *OTHERS, *ELSEWHERE, "adaptdrive/operator/state"]
    assert heard(guarded, listen, "viewer", "operator", tried) == [*COMMANDS, *QUESTIONS]


def test_a_viewer_hears_everything_and_only_asks(guarded: GuardedBroker, listen: Listen) -> None:
    tried = [*COMMANDS, *QUESTIONS, *OWN, *OTHERS, *ELSEWHERE, "adaptdrive/viewer/state"]
    assert heard(guarded, listen, "operator", "viewer", tried) == QUESTIONS
    assert heard(guarded, listen, "viewer", "motor", OWN) == OWN


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        ((), "not authorised"),
        (("-u", "operator"), "not authorised"),
        (("-u", "operator", "-P", password("viewer")), "not authorised"),
        (("-u", "stranger", "-P", password("stranger")), "not authorised"),
    ],
    ids=["anonymous", "no password", "another's password", "unknown user"],
)
def test_strangers_are_refused(guarded: GuardedBroker, words: list[str], problem: str) -> None:
    tried = guarded.attempt(*words, "--cafile", str(guarded.authority))
    assert tried.returncode != 0
    assert problem in tried.stderr


def test_nobody_enters_without_tls(guarded: GuardedBroker) -> None:
    tried = guarded.attempt("-u", "operator", "-P", password("operator"))
    assert tried.returncode != 0


def test_a_client_that_trusts_another_authority_stays_away(guarded: GuardedBroker) -> None:
    words = ("-u", "operator", "-P", password("operator"), "--tls-use-os-certs")
    tried = guarded.attempt(*words)
    assert tried.returncode != 0
    assert "TLS error" in tried.stderr


def test_one_who_may_enter_does(guarded: GuardedBroker) -> None:
    tried = guarded.attempt(*guarded.credentials("operator"))
    assert tried.returncode == 0, tried.stderr


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
