"""The embedded broker, where it has to be better than what it is made of."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

import aiomqtt

from adaptdrive.processes import BROKER, Ports
from tests.support import Spawn

HOST = "127.0.0.1"


async def listening(port: int) -> None:
    async with asyncio.timeout(20.0):
        while True:
            try:
                _, writer = await asyncio.open_connection(HOST, port)
            except OSError:
                await asyncio.sleep(0.05)
            else:
                writer.close()
                await writer.wait_closed()
                return


async def test_a_client_hears_only_what_it_asked_for(spawn: Spawn, free_tcp_port: int) -> None:
    spawn(sys.executable, "-m", BROKER, f"{HOST}:{free_tcp_port}")
    await listening(free_tcp_port)
    async with aiomqtt.Client(HOST, free_tcp_port) as other:
        await other.subscribe("others/state", qos=1)
        await other.publish("others/state", "not yours", qos=1, retain=True)
        await other.publish("mine/state", "yours", qos=1, retain=True)
        async with aiomqtt.Client(HOST, free_tcp_port) as client:
            await client.subscribe("mine/state", qos=1)
            message = await anext(client.messages)
    assert (message.topic.value, message.payload, message.retain) == ("mine/state", b"yours", True)


async def test_it_ends_when_asked(spawn: Spawn, free_tcp_port: int, tmp_path: Path) -> None:
    process = spawn(sys.executable, "-m", BROKER, f"{HOST}:{free_tcp_port}")
    await listening(free_tcp_port)
    process.terminate()
    assert await asyncio.to_thread(process.wait, 20.0) == 0
    assert "Traceback" not in (tmp_path / "process-0.log").read_text()


async def test_a_web_page_reaches_it_over_a_websocket(spawn: Spawn, free_tcp_port: int) -> None:
    ports = Ports()
    port, page = free_tcp_port, ports.take()
    addresses = (f"{HOST}:{port}", f"{HOST}:{page}")
    spawn(sys.executable, "-m", BROKER, *addresses)
    await listening(page)
    async with (
        aiomqtt.Client(HOST, page, transport="websockets", websocket_path="/mqtt") as client,
        aiomqtt.Client(HOST, port) as other,
    ):
        await client.subscribe("drive/state", qos=1)
        await other.publish("drive/state", "heard", qos=1)
        assert (await anext(client.messages)).payload == b"heard"
    ports.close()
