"""A supply that speaks SCPI, answered by one that shares no code with the port."""

from __future__ import annotations

import asyncio
import contextlib
import math
import tomllib
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import pytest

from adaptdrive.app.ports import build_port
from adaptdrive.config.file import validate_configuration
from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.devices.port import Port
from adaptdrive.safety.trips import TripKind
from tests.unit.devices import memory
from tests.unit.devices.bench import Ear, until

EXAMPLE = Path(__file__).parents[4] / "deploy" / "examples" / "motor-scpi.toml"
RUN = Command(current_scale_S=0.0, boost_reference_V=287.6543, bridge=True)
ENDS = {"LF": b"\n", "CR": b"\r", "CRLF": b"\r\n"}
Answer = Callable[[str], bytes | None]
pytestmark = pytest.mark.usefixtures("memory")


class Supply:
    """The server: its lines, the commands that it got, and how a test spoils it.

    Attributes:
        commands: Every command in order, without the questions.
        replies: By question; numbers of every measurement differ.
        spoil: Gives the bytes that answer a question in place of the reply, None for the reply.
        obeys: Whether `OUTP` does something.
        answer: What answers a command.
        end: End of the lines that it takes.
        reply_end: End of its replies.
    """

    def __init__(self, port: int) -> None:
        self.port = port
        self.commands: list[str] = []
        self.connections = 0
        self.obeys = True
        self.answer = b""
        self.end, self.reply_end = b"\n", b"\r\n"
        self.spoil: Answer = lambda _: None
        self.replies = {
            "MEAS:VOLT?": "+3.0012E+02",
            "MEAS:POW?": "4.5E1",
            "MEAS:AUX?": "3.25",
            "SYST:ERR?": '+0,"No error"',
            "VOLT?": "0",
            "OUTP?": "0",
            "*OPC?": "1",
        }
        self._writers: set[asyncio.StreamWriter] = set()

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        self._writers.add(writer)
        with contextlib.suppress(ConnectionError, asyncio.IncompleteReadError):
            while line := (await reader.readuntil(self.end)).decode().strip():
                writer.write(self.reply(line))
        writer.close()

    def reply(self, line: str) -> bytes:
        if not line.endswith("?"):
            self.commands.append(line)
            if line.startswith("OUTP ") and self.obeys:
                self.replies["OUTP?"] = str(int(line == "OUTP ON"))
            return self.answer
        spoilt = self.spoil(line)
        return self.replies[line].encode() + self.reply_end if spoilt is None else spoilt

    def hang_up(self) -> None:
        for writer in self._writers:
            writer.transport.abort()


class Rig:
    """A port between a supply and an ear."""

    def __init__(self, port: Port, supply: Supply, ear: Ear) -> None:
        self.port, self.supply, self.ear = port, supply, ear

    async def hears(self, more: int = 2) -> None:
        """Wait for more readings."""
        count = len(self.ear.readings) + more
        await until(lambda: len(self.ear.readings) >= count)

    async def runs(self) -> None:
        """Command the supply on until a reading shows that it is."""

        def renewed() -> bool:
            self.port.send(RUN)
            return bool(self.ear.readings) and self.ear.readings[-1].bridge

        await until(renewed)


@pytest.fixture
async def rig(request: pytest.FixtureRequest) -> AsyncIterator[Rig]:
    """The example on a port of its own; `param` is more of its bus."""
    supply, ear = Supply(memory.new_port()), Ear()
    tables = tomllib.loads(EXAMPLE.read_text(encoding="utf-8"))
    tables["bus"] |= {"port": supply.port, "poll_ticks": 24, "timeout_s": 0.15}
    more = dict(getattr(request, "param", {}))
    tables["bus"]["values"] |= more.pop("values", {})
    tables["bus"] |= {"command_timeout_s": 1.0} | more
    supply.end = ENDS[more.get("line_end", "LF")]
    tables["bus"]["values"]["limit"] = {"query": "VOLT:PROT?", "write": "VOLT:PROT {:.1f}"}
    tables["load"]["latency_ticks"], tables["interlocks"]["stale_s"] = 24, 1.0
    port = build_port(
        validate_configuration(tables, EXAMPLE), asyncio.get_running_loop().time, EXAMPLE
    )
    with memory.serving(supply.port, supply.serve):
        task = asyncio.create_task(port.run(ear, lambda: None))
        yield Rig(port, supply, ear)
        task.cancel()
        await asyncio.wait([task])
        supply.hang_up()


async def test_it_is_set_up_measured_and_commanded_by_lines_of_text(rig: Rig) -> None:
    await rig.runs()
    reading = rig.ear.readings[-1]
    assert reading.boost_voltage_V == pytest.approx(300.12)
    assert (reading.load_power_W, reading.output, reading.fault) == (45.0, 3.25, 0)
    assert math.isnan(reading.line_voltage_V)
    assert rig.supply.commands[:2] == ["*CLS", "SYST:REM"]
    assert rig.supply.commands[2:4] == ["VOLT 287.654", "OUTP ON"]
    assert rig.port.description == f"scpi 127.0.0.1:{rig.supply.port}"
    assert "MEAS:AUX? 3.25" in rig.port.details()


async def test_a_stop_begins_with_the_output_and_is_confirmed_by_its_question_alone(
    rig: Rig,
) -> None:
    await rig.runs()
    rig.supply.obeys = False
    rig.port.send(SAFE_COMMAND)
    await until(lambda: rig.port.monitor.safe_s < math.inf)
    commands = rig.supply.commands
    assert commands.index("OUTP OFF") < commands.index("VOLT 0.000")
    await rig.hears(3)
    assert rig.ear.readings[-1].bridge
    assert "OUTP ON" not in commands[commands.index("OUTP OFF") :]
    rig.supply.obeys = True
    await until(lambda: not rig.ear.readings[-1].bridge)


async def test_a_missing_reply_never_moves_the_others_to_other_questions(rig: Rig) -> None:
    await rig.runs()
    late: list[bytes] = []

    def delayed(question: str) -> bytes | None:
        """Keep the reply to one question back, and send it with the next reply."""
        if question == "MEAS:POW?" and not late:
            late.append(b"45\n")
            return b""
        return late.pop() + b"3.25\n" if late else None

    known = len(rig.ear.readings)
    rig.supply.spoil = delayed
    connections = rig.supply.connections
    await until(lambda: rig.supply.connections > connections)
    rig.supply.spoil = lambda _: None
    await rig.hears(3)
    for reading in rig.ear.readings[known:]:
        assert (reading.load_power_W, reading.output) == (45.0, 3.25)
    assert rig.port.statistics.timeouts >= 1


def kind_of(rig: Rig) -> TripKind | None:
    """Return the kind of trip for which the values are old."""
    why = rig.port.explain_age()
    return None if why is None else why.kind


async def test_a_supply_that_is_silent_is_named_with_its_remedy(rig: Rig) -> None:
    await rig.hears()
    rig.supply.spoil = lambda line: b"" if line == "MEAS:POW?" else None
    await until(lambda: "no reply within" in str(rig.port.explain_age()))
    cause = f"stale: measurement is 600 ms old, limit 500 ms; {rig.port.explain_age()}"
    assert cause.endswith("the polls give no reading: no reply within 0.15 s to 'MEAS:POW?'")
    assert kind_of(rig) is TripKind.NO_REPLY


async def test_a_supply_that_does_not_say_that_it_is_done_is_named(rig: Rig) -> None:
    await rig.hears()
    rig.supply.spoil = lambda line: b"" if line == "*OPC?" else None
    rig.port.send(RUN)
    missing = "no reply within 0.15 s to 'VOLT 287.654' and '*OPC?'"
    await until(lambda: any(missing in line for line in rig.port.details()))


def error_word(**how: int | str) -> dict[str, object]:
    return {"values": {"error": {"query": "SYST:ERR?", **how}}}


@pytest.mark.parametrize(
    ("rig", "expected"),
    [
        (error_word(mask=0x10), 1),
        (error_word(mask=0x08), 0),
        (error_word(mask=0x30), 3),
        (error_word(mask=0x248), 0x200 >> 3),
        (error_word(form="hexadecimal"), 0x234),
    ],
    indirect=["rig"],
)
async def test_words_are_read_in_any_base(rig: Rig, expected: int) -> None:
    replies = ["0x234", "0X234", "#H234", "#q1064", "#B1000110100", '0x234,"on"']
    plain = "234" if expected == 0x234 else "564"
    for reply in (*replies, plain, f"+{plain}"):
        rig.supply.replies["SYST:ERR?"] = reply
        await rig.hears(3)
        assert rig.ear.readings[-1].fault == expected
        rig.supply.replies["SYST:ERR?"] = "0"
        await rig.hears(3)
        assert rig.ear.readings[-1].fault == 0


ANSWERED = {
    "clear": {"write": "*CLS", "answer": "OK"},
    "remote": {"write": "SYST:REM", "answer": "OK"},
    "voltage_set": {"write": "VOLT {:.3f}", "answer": "OK|=.*"},
    "output": {
        "query": "OUTP?",
        "write": "OUTP {}",
        "answer": "OK",
        "names": {"OFF": 0, "ON": 1},
    },
}


@pytest.mark.parametrize(
    "rig", [{"values": ANSWERED, "done": done} for done in ("", "*OPC?")], indirect=True
)
async def test_a_setting_that_is_answered_is_taken_once_its_answer_has_come(rig: Rig) -> None:
    rig.supply.answer = b"OK\r\n"
    await rig.runs()
    rig.supply.answer = b"ERR\n"
    rig.port.send(SAFE_COMMAND)
    refused = "'ERR' came in reply to 'VOLT 0.000'"
    await until(lambda: any(refused in line for line in rig.port.details()))
    assert rig.port.monitor.safe_s == math.inf
    rig.supply.answer = b"OK\n"
    await until(lambda: rig.port.monitor.safe_s < math.inf)
    assert rig.supply.connections == 1


@pytest.mark.parametrize(
    ("rig", "reply_end"),
    [({"line_end": "CR"}, "CR"), ({"line_end": "CR"}, "CRLF"), ({"line_end": "CRLF"}, "LF")],
    indirect=["rig"],
)
async def test_lines_end_as_the_supply_has_it(rig: Rig, reply_end: str) -> None:
    """A line feed behind the carriage return that ends a reply is no further reply."""
    rig.supply.reply_end = ENDS[reply_end]
    await rig.runs()
    assert (rig.supply.connections, rig.port.statistics.timeouts) == (1, 0)


async def test_a_reply_without_its_end_is_quoted_with_its_remedy(rig: Rig) -> None:
    await rig.hears()
    rig.supply.spoil = lambda line: b"45\r" if line == "MEAS:POW?" else None
    await until(lambda: "no reply within" in str(rig.port.explain_age()))
    cause = f"stale: measurement is 600 ms old, limit 500 ms; {rig.port.explain_age()}"
    came = "'45\\r' came without the end of a line, see bus.line_end"
    assert cause.endswith(f"no reply within 0.15 s to 'MEAS:POW?'; {came}")
    assert kind_of(rig) is TripKind.NO_LINE_END


async def test_a_supply_that_hangs_up_within_a_reply_is_no_matter_of_its_line_end(rig: Rig) -> None:
    await rig.hears()

    def hang_up(line: str) -> bytes | None:
        if line != "MEAS:POW?":
            return None
        asyncio.get_running_loop().call_later(0.01, rig.supply.hang_up)
        return b"45"

    rig.supply.spoil = hang_up
    await until(lambda: "closed the connection" in str(rig.port.explain_age()))
    assert kind_of(rig) is TripKind.NO_REPLY


@pytest.mark.parametrize("rig", [{"setup": {"limit": 44.0}}], indirect=True)
async def test_a_supply_that_keeps_another_limit_is_named_by_its_reply(rig: Rig) -> None:
    rig.supply.replies["VOLT:PROT?"] = "10.0V"
    kept = "set-up of 'limit': VOLT:PROT? gives '10.0V' after 'VOLT:PROT 44.0'"
    await until(lambda: any(kept in detail for _, detail in rig.ear.bus))
    assert not rig.ear.readings


@pytest.mark.parametrize("rig", [{"done": ""}, {"done": "*IDN?"}], indirect=True)
async def test_a_supply_without_the_question_is_commanded_and_its_stop_confirmed(rig: Rig) -> None:
    del rig.supply.replies["*OPC?"]
    rig.supply.replies["*IDN?"] = "a supply"
    await rig.runs()
    rig.supply.obeys = False
    rig.port.send(SAFE_COMMAND)
    await until(lambda: "OUTP OFF" in rig.supply.commands)
    await rig.hears(3)
    assert rig.ear.readings[-1].bridge
    rig.supply.obeys = True
    await until(lambda: not rig.ear.readings[-1].bridge)
    assert rig.supply.connections == 1


async def test_a_reply_that_nothing_asked_for_ends_the_connection(rig: Rig) -> None:
    await rig.hears()
    rig.supply.spoil = lambda line: b"45\n45\n" if line == "MEAS:POW?" else None
    connections, known = rig.supply.connections, len(rig.ear.readings)
    await until(lambda: rig.supply.connections > connections)
    await until(lambda: "nothing asked for" in str(rig.port.explain_age()))
    assert kind_of(rig) is TripKind.POLL_REFUSED
    rig.supply.spoil = lambda _: None
    await rig.hears()
    assert {one.output for one in rig.ear.readings[known:]} == {3.25}
    assert rig.port.statistics.foreign >= 1


async def test_a_supply_that_comes_late_or_returns_is_set_up_before_it_is_commanded(
    rig: Rig,
) -> None:
    await rig.runs()
    rig.supply.commands.clear()
    rig.supply.hang_up()
    await until(lambda: "OUTP ON" in rig.supply.commands or rig.port.send(RUN) is None)
    assert rig.supply.commands[:2] == ["*CLS", "SYST:REM"]


@pytest.mark.parametrize(
    ("reply", "word", "name"),
    [('-113,"Undefined header"', 113, "undefined header"), ("7", 7, "")],
)
async def test_an_error_in_the_queue_is_a_fault(rig: Rig, reply: str, word: int, name: str) -> None:
    await rig.hears()
    queue = [f"{reply}\n".encode()]
    rig.supply.spoil = lambda line: queue.pop() if line == "SYST:ERR?" and queue else None
    await until(lambda: any(one.fault for one in rig.ear.readings))
    fault = next(one for one in rig.ear.readings if one.fault)
    assert (fault.fault, name in fault.fault_name) == (word, True)


@pytest.mark.parametrize("reply", [b"9.91E37\n", b"nan\n", b"1_0\n", b"---\n", b"1E999\n", b"-1\n"])
async def test_a_reply_that_is_no_voltage_is_not_used_and_the_stop_is_confirmed_all_the_same(
    rig: Rig, reply: bytes
) -> None:
    await rig.runs()
    rig.supply.spoil = lambda line: reply if line == "MEAS:VOLT?" else None
    rig.port.send(SAFE_COMMAND)
    await until(lambda: rig.port.monitor.safe_s < math.inf)
    await until(lambda: not rig.ear.readings[-1].bridge)
    await rig.hears()
    gives = f"MEAS:VOLT? gives {reply.decode().strip()!r}, no number in its range"
    assert str(rig.port.explain_age()) == f"the polls give no reading: boost_voltage_V: {gives}"
    assert kind_of(rig) is TripKind.VALUE_REFUSED
    assert {round(one.boost_voltage_V, 6) for one in rig.ear.readings} == {300.12}


@pytest.mark.parametrize("reply", [b"1" * 5000, b"0\n", b"ON\nOFF\n", b"\xff\n"])
async def test_a_command_counts_as_taken_only_when_the_supply_says_that_it_is_done(
    rig: Rig, reply: bytes
) -> None:
    await rig.runs()
    rig.supply.spoil = lambda line: reply if line == "*OPC?" else None
    rig.port.send(SAFE_COMMAND)
    known = len(rig.supply.commands)
    await until(lambda: rig.supply.commands[known:].count("OUTP OFF") >= 2)
    assert rig.port.monitor.safe_s == math.inf
    rig.supply.spoil = lambda _: None
    await until(lambda: rig.port.monitor.safe_s < math.inf)
