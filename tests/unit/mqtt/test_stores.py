"""What outlives a restart: replies and unsent events, with a sound disk and without."""

from __future__ import annotations

import shutil
from datetime import UTC, datetime
from pathlib import Path

import msgspec
import pytest

from adaptdrive.mqtt.contract import Reply
from adaptdrive.mqtt.desk import FORGOTTEN as UNREADABLE
from adaptdrive.mqtt.desk import INTERRUPTED, Desk, LineRation, ReplyMemory
from adaptdrive.mqtt.publisher import Outbox
from adaptdrive.recording.log import Log
from adaptdrive.recording.log_files import EVENTS, log_files, recall
from adaptdrive.recording.records import EventRow, Kind
from adaptdrive.runtime.reports import Hub, State
from adaptdrive.runtime.requests import Request
from adaptdrive.safety.trips import Trip
from tests.unit.mqtt.logs import Time, memory_of, open_log, remembering
from tests.unit.recording.disk import Disk

DAY_s = 24 * 3600.0


def _reply(identity: str) -> Reply:
    return Reply(identity, "enable", accepted=True, reason="", state=State.RUNNING)


def _event(number: int, kind: str = "mode") -> EventRow:
    return EventRow(Time.wall, number, kind, "info", f"number {number}", 1.0, number)


def _note(log: Log, event: EventRow) -> None:
    log.append(Kind.EVENT, msgspec.msgpack.encode(event))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "below" / "drive.log"


async def test_the_last_replies_are_remembered_across_restarts(path: Path) -> None:
    for start in (0, 6):
        async with remembering(path, Time(), limit=10) as memory:
            for number in range(start, start + 6):
                memory.note(f"id-{number}", _reply(f"id-{number}"))
    async with remembering(path, Time(), limit=10) as memory:
        memory.note("id-12", _reply("id-12"))
        known = [number for number in range(13) if memory.recall(f"id-{number}")]
    assert known == list(range(3, 13))


async def test_what_was_asked_is_remembered_across_restarts(path: Path) -> None:
    async with remembering(path, Time()) as memory:
        memory.note("a", _reply("a"), "3.0")
    for _ in range(2):
        async with remembering(path, Time()) as memory:
            assert (memory.recall("a"), memory.asked("a")) == (_reply("a"), "3.0")


@pytest.mark.parametrize(("idle_s", "known"), [(DAY_s - 1.0, True), (DAY_s + 1.0, False)])
@pytest.mark.parametrize("restart", [False, True])
async def test_a_reply_is_remembered_for_a_day(
    path: Path, idle_s: float, *, known: bool, restart: bool
) -> None:
    time = Time()
    async with remembering(path, time) as memory:
        memory.note("a", _reply("a"))
        if not restart:
            time.pass_by(idle_s)
            assert (memory.recall("a") is not None) is known
    if restart:
        time.pass_by(idle_s)
        async with remembering(path, time) as memory:
            assert (memory.recall("a") is not None) is known


async def test_setting_the_clock_makes_nobody_forget(path: Path) -> None:
    time = Time(wall=datetime(1970, 1, 1, tzinfo=UTC))
    async with remembering(path, time) as memory:
        memory.note("a", _reply("a"))
        time.wall = datetime(2026, 1, 1, tzinfo=UTC)
        assert memory.recall("a") == _reply("a")


async def test_a_reply_from_before_the_clock_was_set_outlives_a_restart(path: Path) -> None:
    """The log has a record at least every ten seconds, of ticks or of what was dropped."""
    time = Time(wall=datetime(1970, 1, 1, tzinfo=UTC))
    async with open_log(path, time) as (log, recalled):
        memory_of(log, recalled, time).note("a", _reply("a"))
        time.wall = datetime(2026, 1, 1, tzinfo=UTC)
        log.append(Kind.DROPPED, b"")
    time.pass_by(DAY_s - 1.0)
    left = Path(shutil.copytree(path, path.with_name("left.log")))
    async with remembering(left, time) as memory:
        assert memory.recall("a") == _reply("a")
    time.pass_by(2.0)
    async with remembering(path, time) as memory:
        assert memory.recall("a") is None


async def test_events_leave_in_order_and_only_when_acknowledged(path: Path) -> None:
    async with open_log(path) as (log, recalled):
        outbox = Outbox((), lambda: log.append(Kind.SENT, b""))
        for number in range(3):
            _note(log, _event(number))
            outbox.put(b"%d" % number)
        body = await outbox.oldest()
        assert body == b"0"
        outbox.sent(body)
    async with open_log(path) as (log, recalled):
        outbox = Outbox([b"%d" % one.tick for one in recalled.unsent], lambda: None)
        outbox.put(b"3")
        left = []
        while len(outbox):
            body = await outbox.oldest()
            outbox.sent(body)
            left.append(body)
    assert left == [b"1", b"2", b"3"]


async def test_a_full_outbox_drops_the_oldest_on_disk_too(path: Path, log_disk: Disk) -> None:
    async with open_log(path) as (log, _):
        outbox = Outbox((), lambda: log.append(Kind.SENT, b""))
        with log_disk.stalled():
            for number in range(EVENTS + 7):
                _note(log, _event(number))
                outbox.put(b"%d" % number)
                if number == 0:
                    first = await outbox.oldest()
        assert outbox.dropped == 7
        outbox.sent(first)  # acknowledged after it was dropped
        outbox.sent(await outbox.oldest())
    unsent = recall(path, Time.wall).unsent
    assert [unsent[0].tick, unsent[-1].tick] == [8, EVENTS + 6]


async def test_a_damaged_file_is_reported_and_costs_only_itself(path: Path) -> None:
    async with remembering(path, Time()) as memory:
        memory.note("a", _reply("a"))
    (first,) = log_files(path)
    first.path.with_name(first.path.name.replace("00000001", "00000002")).write_bytes(b"x" * 99)
    recalled = recall(path, Time.wall)
    assert [identity for identity, _, _ in recalled.replies] == ["a"]
    assert any("00000002" in flaw and "bytes 0 to 99" in flaw for flaw in recalled.flaws)
    async with remembering(path, Time()) as memory:
        assert memory.recall("a") == _reply("a")
        memory.note("b", _reply("b"))
    assert recall(path, Time.wall).flaws == ()


async def test_a_reply_that_cannot_be_read_refuses_its_id_and_costs_only_itself(
    path: Path,
) -> None:
    time = Time()
    async with open_log(path, time) as (log, recalled):
        memory_of(log, recalled, time).note("sound", _reply("sound"))
        for identity, body in (("torn", b'{"id": "torn", "ver'), ("empty", b""), ("odd", b"[]")):
            log.append(Kind.REPLY, msgspec.msgpack.encode((identity, body)))
        log.append(Kind.REPLY, b"\xc1")
        log.append(Kind.EVENT, b"\xc1")
        _note(log, _event(2))
    async with open_log(path, time) as (log, recalled):
        memory = memory_of(log, recalled, time)
        assert memory.recall("sound") == _reply("sound")
        unreadable = memory.recall("empty")
        assert unreadable is not None
        assert (unreadable.accepted, unreadable.reason) == (False, UNREADABLE)
        assert [one.tick for one in recalled.unsent] == [2]


class DyingHost:
    """Dies while it carries out a command."""

    async def execute(self, request: Request) -> State:
        raise SystemError("power failure")

    def stop(self) -> State:
        return State.STANDBY

    def trip(self, cause: Trip) -> None:
        raise AssertionError(cause)


def dying_desk(memory: ReplyMemory, time: Time) -> Desk:
    hub, ration = Hub(), LineRation(lambda: time.running_s)
    return Desk(DyingHost(), memory, lambda: None, lambda: time.wall, ration,
                report=hub.publish, kept=hub.kept, shutting_down=lambda: False)  # fmt: skip


async def test_a_command_cut_short_by_a_crash_does_not_act_a_second_time(path: Path) -> None:
    time = Time()
    async with remembering(path, time) as memory:
        desk = dying_desk(memory, time)
        with pytest.raises(SystemError):
            await desk.answer(desk.receive("enable", b'{"id": "a"}', retained=False))
    async with remembering(path, time) as memory:
        desk = dying_desk(memory, time)
        reply = await desk.answer(desk.receive("enable", b'{"id": "a"}', retained=False))
    assert reply is not None
    assert not reply.accepted
    assert reply.reason == INTERRUPTED


async def test_the_last_trip_and_estimates_are_recalled_however_many_restarts_ago(
    path: Path,
) -> None:
    async with open_log(path) as (log, _):
        for learnt in (b"first", b"last"):
            log.append(Kind.LEARNT, learnt)
        for number in range(3):
            _note(log, _event(number, "trip"))
        _note(log, _event(3))
    for _ in range(3):
        async with open_log(path) as (_, recalled):
            assert (recalled.trip, recalled.learnt) == (_event(2, "trip"), b"last")
