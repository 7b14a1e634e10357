"""A CiA 402 node made of the canopen library's own parts, in the event loop of the test.

Its SDO server, heartbeat, emergencies and PDOs are the library's; only the way from controlword to
statusword is written here, and it does what a test tells it to.
"""

from __future__ import annotations

import asyncio
import math
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import canopen

from adaptdrive.config.bus import CanOpenBus
from adaptdrive.devices.can.bus import open_bus
from tests.unit.devices.canopen.documents import EDS, MEMORY

NODE = 5
REST, READY, SWITCHED_ON, ENABLED, FAULT = 0x0240, 0x0221, 0x0233, 0x0237, 0x0208
MEASURED = {"0x6079": 250_000, "0x2000.1": 1203, "0x2001.1": 431_700, "0x2001.2": -3_123_456}
_ANSWERS = {0x00: REST, 0x06: READY, 0x07: SWITCHED_ON, 0x0F: ENABLED}


class Watch:
    """A heartbeat consumer of CiA 301: a write of its entry makes it wait for a first heartbeat."""

    def __init__(self, timeout_s: Callable[[], float]) -> None:
        self._timeout_s = timeout_s
        self._due_s = math.inf
        self._expired = False

    @property
    def expired(self) -> bool:
        """Whether a heartbeat has stayed away for the time-out, now or before."""
        self._expired = self._expired or asyncio.get_running_loop().time() > self._due_s
        return self._expired

    def hear(self) -> None:
        """Take a heartbeat."""
        if not self.expired:
            self._due_s = asyncio.get_running_loop().time() + self._timeout_s()

    def restart(self) -> None:
        """Forget the heartbeats: the entry is written."""
        if not self.expired:
            self._due_s = math.inf


class Periodic:
    """A frame that is sent again and again until it is stopped."""

    def __init__(self, send: Callable[[bytes], None], data: bytes, period_s: float) -> None:
        self._send, self._data, self._period_s = send, data, period_s
        self._go()

    def _go(self) -> None:
        self._send(self._data)
        self._timer = asyncio.get_running_loop().call_later(self._period_s, self._go)

    def update(self, data: bytes) -> None:
        self._data = bytes(data)

    def stop(self) -> None:
        self._timer.cancel()


class LoopNetwork(canopen.Network):
    """The library's network, which the event loop reads and times."""

    def open(self, config: CanOpenBus) -> None:
        """Go on the bus."""
        self.bus = open_bus(config)
        asyncio.get_running_loop().add_reader(self.bus.fileno(), self._read, self.bus)

    def _read(self, bus: can.BusABC) -> None:
        while self.bus is bus and (frame := bus.recv(0)) is not None:
            self.listeners[0].on_message_received(frame)

    def send_periodic(  # type: ignore[override]
        self, can_id: int, data: bytes, period: float, remote: bool = False
    ) -> Periodic:
        return Periodic(lambda now: self.send_message(can_id, now, remote), bytes(data), period)

    def disconnect(self) -> None:
        if self.bus is not None:
            asyncio.get_running_loop().remove_reader(self.bus.fileno())
        super().disconnect()


class Peer:
    """One node on a bus.

    Attributes:
        words: Controlwords heard.
        references_V: Commanded voltage beside each of them.
        beats: Heartbeats of the daemon heard.
        statusword: What the next PDO says.
        obeys: Whether the statusword follows the controlword.
        silent: Names of PDOs that are not sent.
        copies: How often the PDOs come after a SYNC, one set after the other.
        syncs: SYNCs that were received.
        deaf: Whether it takes no PDO outside the state operational, as CiA 301 asks for.
        watch: Its watch over the daemon's heartbeat, which switches it off; None for none.
    """

    def __init__(self, config: CanOpenBus = MEMORY, eds: Path = EDS) -> None:
        self.config = config
        self.network = LoopNetwork()
        self.join()
        self.node = canopen.LocalNode(NODE, str(eds))
        self.network.add_node(self.node)
        self.network.subscribe(0x080, self._sync)
        self.network.subscribe(0x205, self._receive)
        self.network.subscribe(0x77F, self._beat)
        self.network.subscribe(0x000, self._start)
        self.words: list[int] = []
        self.references_V: list[float] = []
        self.beats: list[bytes] = []
        self.statusword = REST
        self.obeys = True
        self.silent: set[int] = set()
        self.copies = 1
        self.syncs = 0
        self.deaf = False
        self.watch: Watch | None = None

    def join(self) -> None:
        """Go on the bus."""
        self.network.open(self.config)

    def leave(self) -> None:
        """Leave the bus."""
        self.node.nmt.stop_heartbeat()
        self.network.disconnect()

    def boot(self) -> None:
        """Say that the node has been started, as after power-on."""
        self.node.nmt.stop_heartbeat()
        self.node.data_store.clear()
        self.node.nmt.state = "INITIALISING"
        self.node.nmt.state = "PRE-OPERATIONAL"

    def number(self, index: int, subindex: int = 0) -> int:
        """An unsigned number in the node's dictionary."""
        return int.from_bytes(self.node.get_data(index, subindex), "little")

    def override(self, index: int, subindex: int, data: bytes) -> None:
        """Give an entry another value than the EDS does."""
        self.node.set_data(index, subindex, data)

    def keep(self, index: int, change: Callable[[bytes], bytes]) -> None:
        """Keep something else than what is written to an object."""
        take = self.node.set_data

        def spoilt(at: int, subindex: int, data: bytes, *_: object, **__: object) -> None:
            take(at, subindex, change(data) if at == index else data)

        self.node.set_data = spoilt  # type: ignore[assignment, method-assign]

    def close(self) -> None:
        if self.network.bus is not None:
            self.leave()

    def _start(self, _: int, data: bytearray, __: float) -> None:
        if data[0] == 1:
            self.node.tpdo.read()

    def _sync(self, *_: Any) -> None:
        if self.node.nmt.state != "OPERATIONAL":
            return
        self.syncs += 1
        for _copy in range(self.copies):
            self._send_pdos()

    def _send_pdos(self) -> None:
        for number, pdo in self.node.tpdo.items():
            if not pdo.enabled or pdo.trans_type != 1 or number in self.silent:
                continue
            for variable in pdo:
                label = f"0x{variable.index:04X}"
                label += f".{variable.subindex}" if variable.subindex else ""
                variable.raw = MEASURED.get(label, self.statusword)
            pdo.transmit()

    def arm(self) -> None:
        """Watch over the daemon's heartbeat from its next one on."""
        self.watch = Watch(lambda: (self.number(0x1016, 1) & 0xFFFF) * 1e-3)
        self.node.add_write_callback(self._restart_watch)

    @property
    def powered(self) -> bool:
        """Whether its power stage is on; it stays on when the node leaves the state operational."""
        expired = self.watch is not None and self.watch.expired
        return self.statusword == ENABLED and not expired

    def _restart_watch(self, *, index: int, **_: object) -> None:
        if self.watch is not None and index == 0x1016:
            self.watch.restart()

    def _receive(self, _: int, data: bytearray, __: float) -> None:
        if self.deaf and self.node.nmt.state != "OPERATIONAL":
            return
        word, reference_V = struct.unpack("<Hf", data)
        self.words.append(word)
        self.references_V.append(reference_V)
        if self.obeys:
            self.statusword = _ANSWERS.get(word, self.statusword)

    def _beat(self, _: int, data: bytearray, __: float) -> None:
        self.beats.append(bytes(data))
        if self.watch is not None:
            self.watch.hear()
