"""A broker that asks for a password and speaks TLS only."""

from __future__ import annotations

import asyncio
import gc
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from adaptdrive.config.services import Mqtt
from adaptdrive.operation.conversation import NoAnswerError
from adaptdrive.operation.messages import Profile
from adaptdrive.operation.sender import send_command
from adaptdrive.operation.service import MqttService, ServiceSurroundings
from adaptdrive.runtime.requests import Enable
from tests.operation.peers import PATIENCE_S, RememberingHost
from tests.runtime.bench import until
from tests.support import Spawn, captured_lines


def _run(name: str, *words: str | Path) -> None:
    program = shutil.which(name)
    if program is None:
        pytest.skip(f"{name} is not installed")
    subprocess.run([program, *words], check=True, capture_output=True)


# paho leaves the socket of a failed handshake to the garbage collector.
pytestmark = [
    pytest.mark.filterwarnings("ignore:.*SSLSocket:pytest.PytestUnraisableExceptionWarning"),
    pytest.mark.filterwarnings("ignore:unclosed <ssl.SSLSocket:ResourceWarning"),
]


@pytest.fixture(autouse=True)
def _collected() -> Iterator[None]:
    """Collect such sockets here, not in the test of another file."""
    yield
    gc.collect()


@pytest.fixture
def guarded(tmp_path: Path, free_tcp_port: int, spawn: Spawn) -> Mqtt:
    """The settings that a guarded broker accepts; it runs until the test ends."""
    program = shutil.which("mosquitto", path=f"{os.environ['PATH']}:/usr/sbin")
    if program is None:
        pytest.skip("mosquitto is not installed")
    certificate, key, users, secret = (
        tmp_path / name for name in ("certificate.pem", "key.pem", "users", "secret")
    )
    _run(
        *("openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2"),
        *("-subj", "/CN=localhost", "-addext", "subjectAltName=IP:127.0.0.1"),
        *("-keyout", key, "-out", certificate),
    )
    _run("mosquitto_passwd", "-c", "-b", users, "bench", "open sesame")
    secret.write_text("open sesame\n")
    conf = tmp_path / "mosquitto.conf"
    conf.write_text(
        f"listener {free_tcp_port} 127.0.0.1\npassword_file {users}\n"
        f"certfile {certificate}\nkeyfile {key}\nuser root\n"
    )
    spawn(program, "-c", conf)
    return Mqtt(
        port=free_tcp_port,
        tls=True,
        ca_file=certificate,
        username="bench",
        password_file=secret,
    )


async def _ask_until_answered(settings: Mqtt) -> bool:
    async with asyncio.timeout(PATIENCE_S):
        while True:
            try:
                return (await send_command(settings, "guarded", "enable", None, 0.5)).accepted
            except NoAnswerError:
                await asyncio.sleep(0.05)


async def test_both_ends_get_in_with_password_and_tls(guarded: Mqtt, tmp_path: Path) -> None:
    host = RememberingHost()
    surroundings = ServiceSurroundings(uniform=lambda low, _: 0.1 * low)
    service = MqttService(Profile("guarded"), guarded, host, host.hub, surroundings)
    running = asyncio.create_task(service.run())
    assert await _ask_until_answered(guarded)
    assert Enable() in host.asked
    running.cancel()
    await asyncio.wait([running])


def _binary(path: Path) -> None:
    path.write_bytes(b"\xff\x00\xfe")


@pytest.mark.parametrize(
    ("key", "damage"),
    [
        ("password_file", _binary),
        ("password_file", Path.mkdir),
        ("password_file", os.mkfifo),
        ("ca_file", Path.touch),  # no certificate must not mean the machine's authorities
        ("ca_file", os.mkfifo),
    ],
)
async def test_a_secret_that_cannot_be_read_is_tried_again(
    guarded: Mqtt, tmp_path: Path, key: str, damage: Callable[[Path], None]
) -> None:
    right = getattr(guarded, key).read_text()
    spoilt = tmp_path / "spoilt"
    damage(spoilt)
    host = RememberingHost()
    surroundings = ServiceSurroundings(uniform=lambda low, _: 0.1 * low)
    settings = guarded.model_copy(update={key: spoilt})
    service = MqttService(Profile("guarded"), settings, host, host.hub, surroundings)
    with captured_lines() as lines:
        running = asyncio.create_task(service.run())
        lost = await _first(lines, "broker lost")
        await asyncio.sleep(1.0)
        assert not running.done()
    assert "spoilt" in lost["problem"]
    spoilt.rename(tmp_path / "put aside")
    spoilt.write_text(right)
    assert await _ask_until_answered(guarded)
    running.cancel()
    await asyncio.wait([running])


async def _first(lines: Sequence[Mapping[str, Any]], event: str) -> Mapping[str, Any]:
    """Wait for the first log line of an event."""
    await until(lambda: any(line["event"] == event for line in lines))
    return next(line for line in lines if line["event"] == event)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"username": "stranger"}, "[Nn]ot authori[sz]ed"),
        ({"ca_file": None}, "certificate verify failed"),
        ({"tls": False}, "127.0.0.1"),
        ({"password_file": Path("/nowhere/secret")}, "/nowhere/secret"),
    ],
)
async def test_others_stay_outside(
    guarded: Mqtt, change: dict[str, object], problem: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("adaptdrive.operation.link.TIMEOUT_S", 1.0)
    while True:
        with pytest.raises(NoAnswerError) as refusal:
            await send_command(guarded.model_copy(update=change), "guarded", "enable", None, 30.0)
        if "Connection refused" not in str(refusal.value):  # mosquitto has started
            break
        await asyncio.sleep(0.05)
    assert refusal.match(problem)
