"""The desk by itself: what it lets through to the drive, what it replies, reports and logs."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from datetime import timedelta
from pathlib import Path

import pytest

from adaptdrive.mqtt.contract import Reply
from adaptdrive.mqtt.desk import (
    INTERRUPTED,
    OVERTAKEN,
    RETAINED,
    Desk,
    LineRation,
    OperatorCommand,
    ReplyMemory,
)
from adaptdrive.runtime.reports import CommandReport, State
from adaptdrive.runtime.requests import Request
from adaptdrive.safety.trips import Trip
from adaptdrive.util.errors import RefusedError
from tests.support import captured_lines
from tests.unit.mqtt.logs import Time, remembering


@dataclass
class RefusingHost:
    """A drive that notes each request, and refuses or delays it where a test sets that."""

    refusal: str = ""
    trip_kind: str = ""
    ending: bool = False
    state: State = State.STANDBY
    done: list[str] = field(default_factory=list)
    free: asyncio.Event = field(default_factory=asyncio.Event)
    asked: asyncio.Event = field(default_factory=asyncio.Event)
    answered: asyncio.Event = field(default_factory=asyncio.Event)

    async def execute(self, request: Request) -> State:
        self.asked.set()
        await self.free.wait()
        if self.refusal:
            raise RefusedError(self.refusal, self.trip_kind)
        self.done.append(request.verb)
        self.state = State.RUNNING
        self.answered.set()
        return self.state

    def trip(self, cause: Trip) -> None:
        raise AssertionError(cause)

    def stop(self) -> State:
        self.done.append("disable")
        self.state = State.STOPPING
        return self.state


@dataclass
class Office:
    """A desk and all that it talks to."""

    desk: Desk
    host: RefusingHost
    memory: ReplyMemory
    time: Time
    reports: list[CommandReport]
    kept: list[int]

    def receive(self, verb: str, identity: str) -> OperatorCommand:
        return self.desk.receive(verb, json.dumps({"id": identity}).encode(), retained=False)

    async def send(
        self, verb: str, raw: bytes | dict[str, object], *, retained: bool = False
    ) -> Reply:
        raw = raw if isinstance(raw, bytes) else json.dumps(raw).encode()
        return await self.desk.answer(self.desk.receive(verb, raw, retained=retained))


def open_office(memory: ReplyMemory, time: Time) -> Office:
    host, reports, kept = RefusingHost(), list[CommandReport](), list[int]()
    host.free.set()

    async def keep() -> None:
        kept.append(len(reports))

    ration = LineRation(lambda: time.running_s, lines=20)
    desk = Desk(host, memory, lambda: host.state, lambda: time.wall, ration,
                report=reports.append, kept=keep, shutting_down=lambda: host.ending)  # fmt: skip
    return Office(desk, host, memory, time, reports, kept)


@pytest.fixture
async def office(tmp_path: Path) -> AsyncIterator[Office]:
    time = Time()
    async with remembering(tmp_path / "motor.log", time) as memory:
        yield open_office(memory, time)


@dataclass
class SlowDisk:
    """Writes what waits for it when the test lets it."""

    waiting: list[asyncio.Event] = field(default_factory=list)

    async def written(self) -> None:
        gate = asyncio.Event()
        self.waiting.append(gate)
        await gate.wait()

    async def write(self) -> None:
        """Let the one that waits go on as far as it can; fails where none waits."""
        (gate,) = self.waiting
        self.waiting.clear()
        gate.set()
        await settle()


@pytest.fixture
def disk(office: Office, monkeypatch: pytest.MonkeyPatch) -> SlowDisk:
    slow = SlowDisk()
    monkeypatch.setattr(office.desk, "kept", slow.written)
    return slow


async def settle() -> None:
    """Let every task go on until it waits for something."""
    for _ in range(20):
        await asyncio.sleep(0)


async def test_a_command_acts_once_and_each_repeat_hears_the_first_reply(office: Office) -> None:
    first = await office.send("enable", {"id": "a"})
    assert first == Reply("a", "enable", accepted=True, reason="", state=State.RUNNING)
    assert await office.send("enable", {"id": "a"}) == first
    assert office.host.done == ["enable"]
    assert [one.id for one in office.reports] == ["a"]


async def test_a_refusal_for_a_trip_names_its_kind_and_so_does_each_repeat(office: Office) -> None:
    office.host.refusal, office.host.trip_kind = "tripped (…); reset first", "over-voltage"
    first = await office.send("enable", {"id": "a"})
    assert (first.accepted, first.trip_kind) == (False, "over-voltage")
    assert await office.send("enable", {"id": "a"}) == first
    office.host.refusal, office.host.trip_kind = "pole = 2 is outside 0.5…0.97", ""
    assert (await office.send("pole", {"id": "b", "value": 2})).trip_kind is None


async def test_an_id_of_another_verb_is_refused_and_does_nothing(office: Office) -> None:
    await office.send("enable", {"id": "a"})
    other = await office.send("reset", {"id": "a"})
    assert not other.accepted
    assert other.reason == "id 'a' was used by 'enable'; give each command its own id"
    assert other.state is State.RUNNING
    assert office.host.done == ["enable"]


@pytest.mark.parametrize(
    "other", [{"value": 4}, {"value": 3, "hold_s": 6}, {"value": "3"}, {}], ids=repr
)
async def test_an_id_of_another_value_is_refused_and_does_nothing(
    office: Office, other: dict[str, object]
) -> None:
    first = await office.send("voltage", {"id": "a", "value": 3})
    reply = await office.send("voltage", {"id": "a"} | other)
    assert not reply.accepted
    assert reply.reason == "id 'a' was used with another value; give each command its own id"
    assert office.host.done == ["voltage"]
    again = {"id": "a", "value": 3.0, "user": "b", "expires": "2030-01-01T00:00:00Z"}
    assert await office.send("voltage", again) == first
    assert office.host.done == ["voltage"]


async def test_what_the_drive_refuses_is_answered_with_reason_and_state(office: Office) -> None:
    office.host.refusal = "tripped\x1b; reset first"
    reply = await office.send("enable", {"id": "a"})
    assert reply == Reply("a", "enable", False, "tripped?; reset first", State.STANDBY)
    office.host.refusal = ""
    assert await office.send("enable", {"id": "a"}) == reply
    assert office.host.done == []


@pytest.mark.parametrize(
    ("payload", "identity", "reason"),
    [
        (b"{}", None, "missing required field `id`"),
        (b"", None, "not JSON: "),
        (b'{"id": 7}', 7, "Expected `str`, got `int`"),
    ],
)
async def test_a_command_without_a_usable_id_does_nothing(
    office: Office, payload: bytes, identity: int | None, reason: str
) -> None:
    reply = await office.send("enable", payload)
    assert (reply.id, reply.accepted, reply.state) == (identity, False, State.STANDBY)
    assert reason in reply.reason
    assert office.host.done == []


async def test_a_retained_command_does_nothing(office: Office) -> None:
    for verb in ("enable", "ping"):
        reply = await office.send(verb, {"id": verb}, retained=True)
        assert (reply.accepted, reply.reason) == (False, RETAINED)
        assert reply.state is State.STANDBY
    assert office.host.done == []


async def test_a_ping_that_nobody_waits_for_any_more_is_refused(office: Office) -> None:
    expired = office.time.wall - timedelta(seconds=1.0)
    reply = await office.send("ping", {"id": "p", "expires": expired.isoformat()})
    assert not reply.accepted
    assert reply.reason.startswith("expired at ")
    for other in ("2099-01-01T00:00:00Z", "soon", 7, None):
        assert (await office.send("ping", {"id": "p", "expires": other})).accepted


async def test_a_ping_is_answered_and_neither_recorded_nor_remembered(office: Office) -> None:
    reply = await office.send("ping", {"id": "p"})
    assert reply == Reply("p", "ping", accepted=True, reason="", state=State.STANDBY)
    assert office.reports == []
    assert office.memory.recall("p") is None


@pytest.mark.parametrize(("late_s", "accepted"), [(-1.0, True), (0.0, False), (1.0, False)])
async def test_a_command_expires_at_its_time(
    office: Office, late_s: float, *, accepted: bool
) -> None:
    expires = office.time.wall - timedelta(seconds=late_s)
    reply = await office.send("enable", {"id": "a", "expires": expires.isoformat()})
    assert reply.accepted is accepted
    told = f"expired at {expires.isoformat()}; the daemon's clock says 2026-01-01T00:00:00+00:00"
    assert reply.reason == ("" if accepted else told)
    assert office.host.done == (["enable"] if accepted else [])


STOPS = {
    "plain": (b'{"id":"s"}', False, "", "s"),
    "retained": (b'{"id":"s"}', True, "carried out, although: it is retained; publish", "s"),
    "empty": (b"", False, "carried out, although: not JSON", None),
    "superfluous": (b'{"id":"s","value":3}', False, "carried out, although: Expected `null`", "s"),
    "expired": (b'{"id":"s","expires":"2025-01-01T00:00:00Z"}', False,
                "carried out, although: expired at 2025", "s"),
}  # fmt: skip


@pytest.mark.parametrize("case", STOPS)
async def test_a_stop_acts_at_its_arrival_whatever_is_wrong_with_it(
    office: Office, case: str
) -> None:
    raw, retained, reason, identity = STOPS[case]
    command = office.desk.receive("disable", raw, retained=retained)
    assert office.host.done == ["disable"]
    reply = await office.desk.answer(command)
    assert (reply.id, reply.accepted, reply.state) == (identity, True, State.STOPPING)
    assert reply.reason.startswith(reason)
    assert bool(reply.reason) is bool(reason)
    assert office.host.done == ["disable"]
    assert [(one.id, one.accepted) for one in office.reports] == [(identity or "", True)]
    assert (office.memory.recall("s") is not None) is (identity is not None)
    assert office.kept == [1]


async def test_a_stop_with_the_id_of_another_command_leaves_that_reply(office: Office) -> None:
    first = await office.send("enable", {"id": "a"})
    reply = await office.send("disable", {"id": "a"})
    assert reply.accepted
    assert reply.reason.startswith("carried out, although: id 'a' was used by 'enable'")
    assert office.memory.recall("a") == first


async def test_a_repeated_stop_stops_again(office: Office) -> None:
    for _ in range(2):
        assert (await office.send("disable", {"id": "s"})).accepted
    assert office.host.done == ["disable", "disable"]


async def test_a_command_that_waited_while_a_stop_came_does_nothing(office: Office) -> None:
    waiting = office.desk.receive("enable", b'{"id":"a"}', retained=False)
    office.desk.receive("disable", b"", retained=False)
    reply = await office.desk.answer(waiting)
    assert (reply.accepted, reply.reason) == (False, OVERTAKEN)
    assert office.host.done == ["disable"]
    after = await office.send("enable", {"id": "b"})
    assert after.accepted


async def test_commands_are_carried_out_one_after_the_other(office: Office) -> None:
    office.host.free.clear()
    async with asyncio.TaskGroup() as tasks:
        first = tasks.create_task(office.send("enable", {"id": "a"}))
        await office.host.asked.wait()
        second = tasks.create_task(office.send("reset", {"id": "b"}))
        await asyncio.sleep(0)
        doubt = office.memory.recall("a")
        assert doubt is not None
        assert doubt.reason == INTERRUPTED
        assert office.memory.recall("b") is None
        office.host.free.set()
    assert first.result().accepted
    assert second.result().accepted
    assert office.host.done == ["enable", "reset"]


async def test_a_reply_waits_until_its_report_is_recorded(office: Office) -> None:
    await office.send("enable", {"id": "a", "user": "ann"})
    assert office.kept == [0, 1]  # before it acts, and before it replies
    report = office.reports[0]
    assert (report.user, report.verb, report.accepted, report.value) == ("ann", "enable", True, "")


async def test_a_caller_that_leaves_does_not_end_its_command(office: Office) -> None:
    running = asyncio.create_task(office.desk.run())
    await asyncio.sleep(0)
    office.host.free.clear()
    command = office.desk.receive("enable", b'{"id":"a"}', retained=False)
    caller = asyncio.create_task(office.desk.ask(command))
    await office.host.asked.wait()
    caller.cancel()
    await asyncio.wait([caller])
    office.host.free.set()
    await office.host.answered.wait()
    assert office.host.done == ["enable"]
    running.cancel()
    await asyncio.wait([running])


async def test_refusing_unread_names_the_state_and_cleans_the_reason(office: Office) -> None:
    command = office.desk.receive("ena\nble", b'{"id":"a"}', retained=True)
    assert command.remains_on_broker
    reply = office.desk.refuse(command, "too\x07 many " + "x" * 600)
    assert (reply.verb, reply.id, reply.state) == ("ena?ble", "a", State.STANDBY)
    assert reply.reason.startswith("too? many xxx")
    assert len(reply.reason) == 500
    assert not office.desk.receive("enable", b"", retained=True).remains_on_broker
    assert not office.desk.receive("enable", b"x", retained=False).remains_on_broker


async def test_each_command_at_the_end_of_the_daemon_is_in_the_log(office: Office) -> None:
    for number in range(30):
        await office.send("ping", {"id": f"p{number}"})
    office.host.ending = True
    with captured_lines() as lines:
        for number in range(30):
            office.desk.refuse(
                office.receive("enable", f"e{number}"), "the daemon is shutting down"
            )
        await office.send("disable", {"id": "d"})
    assert [(line["id"], line["accepted"]) for line in lines] == [
        *((f"e{number}", False) for number in range(30)),
        ("d", True),
    ]


async def test_each_answer_is_logged_until_the_ration_is_used_up(office: Office) -> None:
    with captured_lines() as lines:
        await office.send("enable", {"id": "a"})
        await office.send("disable", b"junk")
        office.desk.refuse(office.desk.receive("reset", b"", retained=False), "busy")
        for number in range(30):
            await office.send("ping", {"id": f"p{number}"})
        for number in range(3):
            await office.send("enable", b"%d" % number)
        office.time.pass_by(10.0)
        await office.send("ping", {"id": "last"})
    told = [(line["event"], line["verb"]) for line in lines]
    assert told[:4] == [
        ("command", "enable"),
        ("command without a readable id", "disable"),
        ("command", "disable"),
        ("command without a readable id", "reset"),
    ]
    assert [line["carried_out"] for line in lines if "carried_out" in line] == [True, False]
    assert [line["size"] for line in lines if "size" in line] == [4, 0]
    assert len(lines) == 21
    assert (lines[0]["accepted"], lines[0]["reason"]) == (True, None)
    assert lines[2]["reason"].startswith("carried out, although")
    assert [line["withheld_lines"] for line in lines] == [0] * 20 + [17]


async def test_an_id_may_have_128_letters(office: Office) -> None:
    longest = await office.send("enable", {"id": "a" * 128})
    assert longest.accepted
    assert office.memory.recall("a" * 128) == longest
    assert not (await office.send("enable", {"id": "b" * 129})).accepted
    assert office.memory.recall("b" * 129) is None
    assert not (await office.send("enable", {"id": ""})).accepted
    assert office.memory.recall("") is None
    assert (await office.send("disable", {"id": "b" * 129})).accepted
    assert office.memory.recall("b" * 129) is None


async def test_a_number_is_no_id_although_its_digits_are_known(office: Office) -> None:
    first = await office.send("enable", {"id": "7"})
    for verb in ("enable", "reset"):
        reply = await office.send(verb, {"id": 7})
        assert (reply.id, reply.accepted) == (7, False)
        assert "Expected `str`, got `int`" in reply.reason
    assert office.memory.recall("7") == first


async def test_a_drive_acts_after_its_doubt_is_on_disk_and_replies_after_its_reply_is(
    office: Office, disk: SlowDisk
) -> None:
    answer = asyncio.create_task(office.desk.answer(office.receive("enable", "a")))
    await settle()
    doubt = office.memory.recall("a")
    assert doubt is not None
    assert (doubt.reason, office.host.done) == (INTERRUPTED, [])
    await disk.write()
    assert (office.host.done, answer.done()) == (["enable"], False)
    await disk.write()
    assert (await answer).accepted


async def test_a_stop_that_comes_while_the_disk_writes_is_obeyed(
    office: Office, disk: SlowDisk
) -> None:
    answer = asyncio.create_task(office.desk.answer(office.receive("enable", "a")))
    await settle()
    office.receive("disable", "s")
    await disk.write()
    await disk.write()
    assert (await answer).reason == OVERTAKEN
    assert office.host.done == ["disable"]


async def test_a_command_that_expires_while_the_disk_writes_does_nothing(
    office: Office, disk: SlowDisk
) -> None:
    expires = office.time.wall + timedelta(seconds=1.0)
    sent = office.send("enable", {"id": "a", "expires": expires.isoformat()})
    answer = asyncio.create_task(sent)
    await settle()
    office.time.wall = expires
    await disk.write()
    await disk.write()
    assert (await answer).reason.startswith("expired at ")
    assert office.host.done == []
