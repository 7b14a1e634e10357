"""The shipped broker: its own configuration and access list, on another port, in another folder."""

from __future__ import annotations

import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

from tests.support import Process, await_listener, complete_lines, start_process, stop_process

SHIPPED = Path(__file__).parents[3] / "deploy" / "mosquitto"
PEOPLE = ("operator", "viewer")
DRIVES = ("motor", "bath")
PATIENCE_S = 120.0

# Commands to the drive `motor`, which everybody hears who is asked to in these tests.
_FIRST, _LAST = "adaptdrive/motor/command/first", "adaptdrive/motor/command/last"


@dataclass(frozen=True, slots=True)
class GuardedBroker:
    """A running broker that asks for TLS and a password.

    Attributes:
        port: Where it listens on the loopback interface.
        folder: Holds `ca.crt`, and each user's password as `USER.password`.
    """

    port: int
    folder: Path

    @property
    def authority(self) -> Path:
        """The certificate that clients trust."""
        return self.folder / "ca.crt"

    def password_file(self, user: str) -> Path:
        """Where a user's password is kept."""
        return self.folder / f"{user}.password"

    def credentials(self, user: str) -> list[str]:
        """Words that let one of mosquitto's own clients in."""
        return ["-u", user, "-P", password(user), "--cafile", str(self.authority)]

    def client(self, program: str, *words: str) -> list[str]:
        """The command line of one of mosquitto's own clients."""
        return [program, "-h", "localhost", "-p", str(self.port), *words]

    def publish(self, user: str, topic: str, payload: str = "x") -> None:
        """Publish as a user, and wait until the broker has dealt with it, whatever it thought."""
        words = ("-t", topic, "-m", payload, "-q", "1")
        command = self.client("mosquitto_pub", *self.credentials(user), *words)
        subprocess.run(command, check=False, capture_output=True, timeout=PATIENCE_S)

    def attempt(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Try to get in with some words of `mosquitto_pub`."""
        command = self.client("mosquitto_pub", *words, "-t", "adaptdrive/x", "-m", "x", "-q", "1")
        return subprocess.run(
            command, check=False, capture_output=True, text=True, timeout=PATIENCE_S
        )


def password(user: str) -> str:
    """Each test user's password."""
    return f"{user} opens sesame"


def make_broker(folder: Path, program: str, port: int) -> tuple[GuardedBroker, Process]:
    """Make certificates and passwords the way the manual says, and start the broker with them.

    Args:
        folder: Takes the place of `/etc/mosquitto`.
        program: mosquitto.
        port: Takes the place of 8883.
    """
    certificates = folder / "certs"
    subprocess.run(
        [SHIPPED / "make-certificates", certificates], check=True, capture_output=True, timeout=60
    )
    (certificates / "broker.crt").rename(certificates / "adaptdrive.crt")
    (certificates / "broker.key").rename(certificates / "adaptdrive.key")
    (certificates / "ca.crt").rename(folder / "ca.crt")
    broker = GuardedBroker(port, folder)
    _write_users(broker)
    return broker, _start(broker, program)


def _write_users(broker: GuardedBroker) -> None:
    users = broker.folder / "adaptdrive.passwd"
    users.touch()
    for user in (*PEOPLE, *DRIVES):
        command = ["mosquitto_passwd", "-b", str(users), user, password(user)]
        subprocess.run(command, check=True, capture_output=True, timeout=60)
        broker.password_file(user).write_text(password(user) + "\n", encoding="utf-8")


def _start(broker: GuardedBroker, program: str) -> Process:
    folder = broker.folder
    (folder / "adaptdrive.acl").write_bytes((SHIPPED / "adaptdrive.acl").read_bytes())
    text = (SHIPPED / "adaptdrive.conf").read_text(encoding="utf-8")
    text = text.replace("/etc/mosquitto", str(folder))
    text = text.replace("listener 8883", f"listener {broker.port} 127.0.0.1")
    conf = folder / "adaptdrive.conf"
    # A broker that root starts becomes another user, who may not enter a test's folder.
    conf.write_text(text + "user root\n", encoding="utf-8")
    process = start_process([program, "-c", conf], folder / "mosquitto.log")
    try:
        await_listener(process, broker.port, folder / "mosquitto.log")
    except BaseException:
        stop_process(process)
        raise
    return process


class Ear:
    """A mosquitto_sub that is let in as a user and asks for everything."""

    def __init__(self, broker: GuardedBroker, user: str, log: Path) -> None:
        self._broker = broker
        self._log = log
        words = [*broker.credentials(user), "-t", "#", "-q", "1", "-F", "%t"]
        self._process = start_process(broker.client("mosquitto_sub", *words), log)
        try:
            self._hear_operator(_FIRST)
        except BaseException:
            self.close()
            raise

    def topics(self) -> list[str]:
        """The topics of all that was heard, in the order in which the broker passed them on."""
        self._hear_operator(_LAST)
        return [topic for topic in self._lines() if topic not in (_FIRST, _LAST)]

    def close(self) -> None:
        """Hear no more."""
        stop_process(self._process)

    def _hear_operator(self, topic: str) -> None:
        """Have the operator say something until it is heard: all before it then was, too."""
        deadline_s = time.monotonic() + PATIENCE_S
        while topic not in self._lines():
            assert time.monotonic() < deadline_s, self._log.read_text(encoding="utf-8")
            self._broker.publish("operator", topic)

    def _lines(self) -> list[str]:
        return complete_lines(self._log)
