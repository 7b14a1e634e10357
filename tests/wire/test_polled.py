"""A drive on CAN that answers only when asked, with the whole daemon behind it."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable

import pytest

from adaptdrive.runtime.reports import State
from tests.wire.rig import rigged, until
from tests.wire.wires import CanWire, Frames, motor_text, strung

_IDS = {0x100: "DriveStatus", 0x101: "DriveLoad"}


class AnsweringWire(CanWire):
    """The reference drive, some of whose messages come only when a remote frame asks for them."""

    def __init__(self, polled: Iterable[str]) -> None:
        table = ", ".join(f'{name} = "rtr"' for name in polled)
        text = motor_text().replace("[bus]\n", f"[bus]\npolled = {{ {table} }}\n")
        super().__init__(text)
        self.polled = tuple(polled)
        self.answers = True
        self.newest: dict[str, bytes] = {}

    def put(self, frames: Frames) -> None:
        """Send what comes without a request, and hold the rest."""
        self.newest.update(frames)
        super().put([(name, data) for name, data in frames if name not in self.polled])

    def _hear(self) -> None:
        while (frame := self.bus.recv(0)) is not None:
            name = _IDS.get(frame.arbitration_id, "")
            if frame.is_remote_frame and name in self.polled:
                self._answer(name)
            elif frame.arbitration_id == 0x080:
                self._told = asyncio.get_running_loop().time(), bool(frame.data[4] & 1)

    def _answer(self, name: str) -> None:
        if self.answers and (data := self.newest.pop(name, None)) is not None:
            self.drive.put(name, data)


@pytest.mark.parametrize("polled", [["DriveStatus"], ["DriveStatus", "DriveLoad"]])
async def test_a_drive_that_answers_only_runs_and_trips_as_stale_when_it_answers_no_more(
    polled: list[str],
) -> None:
    wire = AnsweringWire(polled)
    async with strung(wire), rigged(wire.configuration) as rig:
        await rig.run()
        assert wire.told[1]
        await asyncio.sleep(1.0)
        assert rig.state is not None
        assert rig.state.state is State.RUNNING
        wire.answers = False
        await rig.reaches(State.TRIPPED)
        await until(lambda: not wire.told[1])
        (trip,) = rig.heard("trip")
        assert trip.startswith("stale: ")
        assert ": no reply to its requests: check bus.polled" in trip
        wire.answers = True
        await rig.run()
