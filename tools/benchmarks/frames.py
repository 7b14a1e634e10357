"""Frames of the reference motor's drive, made by cantools and crccheck."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import can

from tests.unit.devices.bench import LOAD, Drive


class Frames(can.BusABC):
    """A bus without a wire.

    Attributes:
        frames: What was sent.
    """

    def __init__(self) -> None:
        self.frames: list[can.Message] = []
        super().__init__(channel="benchmark")
        self.shutdown()  # it holds nothing open

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.frames.append(msg)


def half_cycles(off: int = 0) -> Iterator[tuple[can.Message, can.Message]]:
    """Yield the frames of each half cycle without end; the bridge is off at first."""
    bus = Frames()
    drive = Drive(bus)
    for number in itertools.count():
        drive.send_status(BridgeOn=float(number >= off))
        drive.send_load(Tachometer=LOAD["Tachometer"])
        status, load = bus.frames
        bus.frames.clear()
        yield status, load


def status_frames(count: int, off: int = 0) -> list[tuple[can.Message, can.Message]]:
    """Frames of so many half cycles; the bridge is off at first."""
    return list(itertools.islice(half_cycles(off), count))
