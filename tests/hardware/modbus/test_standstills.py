"""A drive that stops by itself without commands, and a daemon that stands still at any instant."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import pytest

from adaptdrive.app.ports import build_port
from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.hardware.port import Reading
from tests.config.modbus_documents import parse
from tests.hardware.modbus.bench import FUNCTION_23, MAP, Peer, reported, serial
from tests.hardware.modbus.spoils import nothing_written
from tests.hardware.modbus.virtual import Follower, VirtualDrive, VirtualLoop, use_memory

TIMEOUT_s = 0.15
STANDSTILL_s = 0.3
SHORTEST_s = 0.077
"""A time-out little above the shortest that is accepted, one and a half polls."""

SLOW_s = 0.005
"""Delay of each reply with which the five exchanges of a poll take most of its time."""

UNSEEN_s = 0.1
"""Time since a stop at which no report of a bridge that is on is good any more."""

INSTANTS = 80
"""Looks at the clock after which the daemon stands still, one run each: a few polls."""

LATE_s = 0.03
"""Delay of each reply with which a reply and the silence before it take more than two polls."""

COMMANDS = 3
"""Commands after which the looks are counted: the drive has reported its bridge on."""


@pytest.fixture(autouse=True)
def in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    use_memory(monkeypatch)


class WatchedPeer(Peer):
    """A drive that obeys the level of its switch, and opens its bridge without commands.

    Attributes:
        revived_s: Times for which it had stopped by itself when it was switched on again.
        longest_s: Longest time from one command to the next while it was on.
        fed: Commands that it took while it was on.
    """

    def __init__(self, first: int, timeout_s: float) -> None:
        super().__init__(first)
        self._timeout_s = timeout_s
        self._fed_s = 0.0
        self._stopped_s: float | None = None
        self.loop: VirtualLoop | None = None
        self.state = 0
        self.revived_s: list[float] = []
        self.longest_s = 0.0
        self.fed = 0

    def reply(self, request: bytes) -> bytes:
        self._watch()
        return super().reply(request)

    def _watch(self) -> None:
        assert self.loop is not None
        if self.state and self.loop.time() - self._fed_s > self._timeout_s:
            self.state, self._stopped_s = 0, self._fed_s + self._timeout_s

    def _write(self, head: bytes, data: bytes) -> None:
        super()._write(head, data)
        assert self.loop is not None
        now_s, on = self.loop.time(), self.writes[-1][1][1]
        if self.state:
            self.fed += 1
            self.longest_s = max(self.longest_s, now_s - self._fed_s)
        if on and self._stopped_s is not None:
            self.revived_s.append(now_s - self._stopped_s)
        self._fed_s, self.state, self._stopped_s = now_s, on, None


class Rig:
    """A port in virtual time whose drive watches its commands.

    Attributes:
        stands_at: Number of the look at the clock at which the daemon stands still.
        decisions: Readings that are followed by a command.
    """

    def __init__(self, device: Path, changes: dict[str, str | None], timeout_s: float) -> None:
        held = "bus__read_write" in changes
        self.peer = WatchedPeer(10 if held else 0, timeout_s)
        self.drive = VirtualDrive(self.peer)
        self.loop = VirtualLoop(self.drive)
        self.peer.loop = self.loop
        self.ear = Follower(self._decide)
        self._looks = 0
        self._been_on = False
        self.stands_at = -1
        self.decisions = math.inf
        document = parse(**{**MAP, **serial(device), **reported(changes)})
        self._port = build_port(document, self._clock, "standstills.toml")

    def _clock(self) -> float:
        self._looks += self.peer.fed >= COMMANDS
        if self._looks == self.stands_at:
            self.loop.stand_still(STANDSTILL_s)
        return self.loop.time()

    def _decide(self, reading: Reading) -> None:
        if len(self.ear.readings) > self.decisions:
            return
        stopped = self._been_on and not reading.bridge
        self._been_on = self._been_on or reading.bridge
        wanted = Command(0.0, 250.0 + len(self.ear.readings) // 50, bridge=True)
        self._port.send(SAFE_COMMAND if stopped or self._port.complaint else wanted)

    def run(self, seconds: float) -> None:
        end_s = self.loop.time() + seconds
        self.loop.serve(self._port.run(self.ear, lambda: None), lambda: self.loop.time() >= end_s)


@pytest.mark.parametrize("changes", [{}, FUNCTION_23], ids=["apart", "function-23"])
def test_a_drive_that_stopped_in_a_standstill_is_not_energised_unseen(
    changes: dict[str, str | None], tmp_path: Path
) -> None:
    """Wherever the daemon stood still, with the reply to a read or a write in its buffer, too."""
    revived = dict[int, list[float]]()
    for instant in range(1, INSTANTS):
        rig = Rig(tmp_path / "line", changes, TIMEOUT_s)
        rig.stands_at = instant
        rig.run(2.0)
        assert rig.peer.fed >= COMMANDS
        if any(unseen_s > UNSEEN_s for unseen_s in rig.peer.revived_s):
            revived[instant] = rig.peer.revived_s
    assert sorted(revived) == []


@pytest.mark.parametrize("changes", [{}, FUNCTION_23], ids=["apart", "function-23"])
def test_the_shortest_time_out_lets_no_healthy_drive_stop(
    changes: dict[str, str | None], tmp_path: Path
) -> None:
    """Commands that now go with the read, now after it, would be two polls apart."""
    scattered = {"bus__max_block": "2", "bus__max_gap": "0"}
    known = {**changes, **scattered, "bus__command_timeout_s": str(SHORTEST_s)}
    rig = Rig(tmp_path / "line", known, SHORTEST_s)
    rig.drive.copies = lambda _: (SLOW_s,)
    rig.run(20.0)
    assert rig.peer.revived_s == []
    assert rig.peer.fed > 300


def test_a_wait_for_a_silent_line_is_no_standstill(tmp_path: Path) -> None:
    """A command stays valid while the line must be silent, as after a reply to another request."""
    numbers = itertools.count(1)

    def sometimes_another(pdu: bytes) -> bytes:
        return nothing_written(pdu) if pdu[0] == 16 and next(numbers) % 4 == 0 else pdu

    rig = Rig(tmp_path / "line", {}, 1.0)
    rig.drive.copies, rig.peer.answer = lambda _: (LATE_s,), sometimes_another
    rig.decisions = 1
    rig.run(2.0)
    assert next(numbers) > 12
