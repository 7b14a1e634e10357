"""SDO answers of a drive that breaks the protocol, byte by byte as CiA 301 has them."""

from __future__ import annotations

import pytest
from canopen import Network
from canopen.objectdictionary import ObjectDictionary
from canopen.sdo.client import SdoClient

from adaptdrive.devices.canopen.sdo import Server
from adaptdrive.util.errors import BusError

NAME = (0x1008, 0)
SEGMENTED, SEGMENT, TOGGLE, LAST, ABORT = 0x40, 0x00, 0x10, 0x01, 0x80


class Device(Network):
    """Answers a read in segments of seven bytes, the last of which is one of many."""

    def __init__(self, segments: int) -> None:
        super().__init__()
        self._left = segments
        self.aborted = False

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self.aborted = self.aborted or data[0] == ABORT
        if self.aborted:
            return
        if data[0] == SEGMENTED:
            answer = bytes([SEGMENTED, *data[1:4], 0, 0, 0, 0])
        else:
            self._left -= 1
            last = LAST if self._left == 0 else 0
            answer = bytes([SEGMENT | (data[0] & TOGGLE) | last, *b"adaptor"])
        self.notify(0x585, bytearray(answer), 0.0)


def served(segments: int) -> tuple[Device, Server]:
    device = Device(segments)
    client = SdoClient(0x605, 0x585, ObjectDictionary())
    client.network = device
    device.subscribe(client.tx_cobid, client.on_response)
    return device, Server(client, "node 5")


@pytest.mark.parametrize("segments", [1, 2, 15, 146])
def test_an_entry_is_read_segment_by_segment(segments: int) -> None:
    assert served(segments)[1].read(NAME) == b"adaptor" * segments


@pytest.mark.parametrize("segments", [147, -1])
def test_an_entry_without_an_end_is_refused_and_aborted(segments: int) -> None:
    device, server = served(segments)
    with pytest.raises(BusError, match="node 5: 0x1008 has over 1024 bytes"):
        server.read(NAME)
    assert device.aborted


class Expedited(Network):
    """Answers a read in one frame, with four bytes whatever the entry has."""

    def __init__(self, command: int, content: bytes) -> None:
        super().__init__()
        self._answer = bytes([command]), content
        self.written: list[bytes] = []

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        command, content = self._answer
        if data[0] == SEGMENTED:
            answer = command + bytes(data[1:4]) + content
        else:
            self.written.append(bytes(data[4:]))
            answer = bytes([0x60, *data[1:4], 0, 0, 0, 0])
        self.notify(0x585, bytearray(answer), 0.0)


def expedited(command: int, content: bytes) -> tuple[Expedited, Server]:
    device = Expedited(command, content)
    client = SdoClient(0x605, 0x585, ObjectDictionary())
    client.network = device
    device.subscribe(client.tx_cobid, client.on_response)
    return device, Server(client, "node 5")


SENT = (0x1017, 0)
STATED, UNSTATED, TWO = 0x43, 0x42, 0x4B


@pytest.mark.parametrize("command", [STATED, UNSTATED, TWO])
def test_a_reply_may_be_longer_than_its_entry(command: int) -> None:
    device, server = expedited(command, b"\x14\0\0\0")
    server.write_surely(SENT, b"\x14\0")
    assert len(device.written) == 1
    assert server.number(SENT) == 0x14


def test_another_value_is_refused_all_the_same() -> None:
    server = expedited(STATED, b"\x15\0\0\0")[1]
    with pytest.raises(BusError, match="0x1017 is 0x0015 after 0x0014 was written"):
        server.write_surely(SENT, b"\x14\0")


def test_an_entry_that_holds_its_value_is_not_written() -> None:
    device, server = expedited(STATED, b"\x80\0\0\0")
    server.settle((0x1005, 0), b"\x80\0\0\0")
    assert device.written == []
    server.settle((0x1005, 0), b"\x81\0\0\0")
    assert len(device.written) == 1
