"""The fixtures that other tests stand on do what they say."""

from __future__ import annotations

import socket
import sys
from pathlib import Path

import aiomqtt

from tests.support import (
    Broker,
    MosquittoLauncher,
    Spawn,
    complete_lines,
    logged_events,
    stop_process,
)


def test_free_ports_can_be_bound(free_udp_port: int, free_tcp_port: int) -> None:
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp,
        socket.socket(socket.AF_INET, socket.SOCK_STREAM) as tcp,
    ):
        udp.bind(("127.0.0.1", free_udp_port))
        tcp.bind(("127.0.0.1", free_tcp_port))


def test_a_spawned_process_writes_its_own_log(spawn: Spawn, tmp_path: Path) -> None:
    first = spawn(sys.executable, "-c", "print('one')")
    second = spawn(sys.executable, "-c", "print('two')")
    assert (first.wait(), second.wait()) == (0, 0)
    assert (tmp_path / "process-0.log").read_text() == "one\n"
    assert (tmp_path / "process-1.log").read_text() == "two\n"


def test_a_line_that_is_half_written_is_not_read_yet(tmp_path: Path) -> None:
    log = tmp_path / "drive.log"
    log.write_text('simulated drive\n{"event": "safe", "t": 1}\n{"event": "sa')
    assert logged_events(log, "safe") == [{"event": "safe", "t": 1}]
    log.write_text("a line without an end")
    assert complete_lines(log) == []


async def test_the_broker_carries_messages(mosquitto: Broker) -> None:
    async with aiomqtt.Client(mosquitto.host, mosquitto.port) as client:
        await client.subscribe("harness/#")
        await client.publish("harness/word", "here", qos=1)
        message = await anext(client.messages)
    assert message.payload == b"here"


def test_a_broker_can_be_stopped_and_started_again(
    mosquitto_launcher: MosquittoLauncher, free_tcp_port: int
) -> None:
    for _ in range(2):
        process = mosquitto_launcher.start(free_tcp_port)
        stop_process(process)
        assert process.returncode is not None
