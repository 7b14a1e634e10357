"""What a drive needs before it is commanded, fields of a register, and registers that wear out."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator

import pytest

from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.devices import modbus
from adaptdrive.devices.polled.commander import WritePace
from adaptdrive.devices.polled.mapping import block_words
from adaptdrive.devices.polled.registers import Block
from tests.unit.config.modbus_documents import flaws
from tests.unit.described.modbus_node import ILLEGAL_VALUE, ModbusNode, RefusalError
from tests.unit.devices.bench import Ear, until
from tests.unit.devices.modbus.bench import RUN, build, plan

pytestmark = pytest.mark.usefixtures("memory")
UNLOCK, MODE, WANTED, CONTROL = 20, 21, 0, 1
SETUP = {
    "bus__registers__unlock": "{ address = 20, table = 'holding' }",
    "bus__registers__mode": (
        "{ address = 21, table = 'holding', names = { Local = 0, Remote = 2 } }"
    ),
    "bus__setup__unlock": "0x2A5A",
    "bus__setup__mode": "'Remote'",
    "bus__setup_unread": "['unlock']",
}
FIELDS = {
    "bus__registers__control": "{ address = 1, table = 'holding', mask = 0x0007 }",
    "signals__command__bridge": "{ signal = 'control', on = 3 }",
    "bus__registers__local": "{ address = 1, table = 'holding', mask = 0x200 }",
    "signals__command__constants__local": "1",
}
DAY_S = 86400.0


class Drive(ModbusNode):
    """Takes a command in remote mode only, and that mode after its unlock word only."""

    def __init__(self) -> None:
        super().__init__({3, 4, 6, 16}, framing="tcp")
        self.put("input", 0, 30012, 1200, 43, 0x4050, 0, 1)
        self.put("holding", 0, 0, 0, 0)
        self.put("holding", UNLOCK, 0, 0)
        self.unlocked = False
        self.on_write = self._judge

    def _judge(self, _: str, address: int, word: int) -> None:
        if address == UNLOCK:
            self.unlocked = word == 0x2A5A
            return
        refuses_mode = address == MODE and not self.unlocked
        if refuses_mode or (address == CONTROL and word and self.tables["holding"][MODE] != 2):
            raise RefusalError(ILLEGAL_VALUE)


@contextlib.asynccontextmanager
async def running(
    drive: ModbusNode, first: Command | None = None, /, **changes: str | None
) -> AsyncIterator[tuple[modbus.Port, Ear]]:
    """Run a port against a drive, with a first command or none."""
    async with drive.served():
        port, ear = build(bus__port=str(drive.port), bus__heartbeat__daemon=None, **changes), Ear()
        if first is not None:
            port.send(first)
        task = asyncio.create_task(port.run(ear, lambda: None))
        try:
            yield port, ear
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)


async def test_a_drive_is_unlocked_and_set_up_before_its_first_command() -> None:
    drive = Drive()
    async with running(drive, **SETUP) as (port, ear):

        def commanded() -> bool:
            port.send(RUN)  # renewed, as by the fast loop
            return 1 in drive.written(CONTROL)

        await until(lambda: bool(ear.readings))
        await until(commanded)
    assert [address for address, _ in drive.writes][:2] == [UNLOCK, MODE]
    assert drive.written(MODE) == [2]
    assert port.trip_cause is None


async def test_a_drive_that_has_started_anew_is_set_up_anew() -> None:
    drive = Drive()
    functions = drive.functions
    async with running(drive, **SETUP) as (_, ear):
        await until(lambda: bool(ear.readings))
        drive.functions = frozenset()  # behind a gateway, whose own link stays
        await until(lambda: len(ear.bus) > 0)
        drive.put("holding", UNLOCK, 0, 0)
        drive.unlocked = False
        drive.functions = functions
        await until(lambda: len(ear.bus) > 1)
    assert drive.written(MODE) == [2, 2]


async def test_a_set_up_that_does_not_hold_keeps_the_drive_lost() -> None:
    drive = Drive()
    async with running(drive, **{**SETUP, "bus__setup__unlock": "7"}) as (_, ear):
        await until(lambda: bool(ear.bus))
    up, detail = ear.bus[0]
    assert not up
    assert "set-up of 'mode': exception reply 3 to function 16 (illegal value)" in detail
    assert not ear.readings


@pytest.mark.parametrize(("held", "fits"), [(-2, True), (-3, False)])
async def test_a_register_that_tells_a_scale_must_hold_that_of_the_file(
    held: int, fits: bool
) -> None:
    """As the scale factors of SunSpec, which no client may write."""
    drive = Drive()
    power = {"bus__registers__wanted_sf": "{ address = 23, table = 'holding', type = 'int16' }"}
    drive.put("holding", 23, held)

    def refuse(_table: str, address: int, _word: int) -> None:
        if address == 23:
            raise RefusalError(ILLEGAL_VALUE)

    drive.on_write = refuse
    async with running(drive, bus__setup__wanted_sf="-2", **power) as (_, ear):
        await until(lambda: bool(ear.readings if fits else ear.bus))
    assert bool(ear.readings) == fits
    assert fits or "set-up of 'wanted_sf'" in ear.bus[0][1]


async def test_a_stop_goes_before_the_set_up() -> None:
    drive = Drive()
    async with running(drive, SAFE_COMMAND, **SETUP):
        await until(lambda: bool(drive.written(MODE)))
    assert next(address for address, _ in drive.writes) in {WANTED, CONTROL}


TWO_COILS: dict[str, str | None] = {
    "bus__registers__run": "{ address = 0x49, table = 'coil' }",
    "bus__registers__halt": "{ address = 0x4B, table = 'coil' }",
    "bus__registers__closed": "{ address = 5, table = 'input' }",
    "signals__bridge": "'closed'",
    "signals__command__bridge": "{ signal = 'run', off_signal = 'halt' }",
}


@pytest.mark.parametrize("interval_s", ["0.0", "60.0"])
async def test_a_drive_may_have_one_coil_to_start_it_and_another_one_to_stop_it(
    interval_s: str,
) -> None:
    drive = ModbusNode({3, 4, 5, 6, 16}, framing="tcp")
    drive.put("input", 0, 30012, 1200, 43, 0x4050, 0, 0)
    drive.put("holding", 0, 0)
    drive.put("coil", 0x49, 0, 0, 0)

    def turn(table: str, address: int, _: int) -> None:
        if table == "coil":
            drive.put("input", 5, int(address == 0x49))

    drive.on_write = turn
    async with running(drive, bus__command_interval_s=interval_s, **TWO_COILS) as (port, ear):
        await until(lambda: bool(ear.readings))
        for _ in range(2):
            drive.writes.clear()
            await until(lambda: port.send(RUN) and ear.readings[-1].bridge)
            assert {(at, word) for at, word in drive.writes if at} == {(0x49, 0xFF00)}
            drive.writes.clear()
            port.send(SAFE_COMMAND)
            await until(lambda: not ear.readings[-1].bridge)
            assert drive.writes[0] == (0x4B, 0xFF00)
            assert {at for at, _ in drive.writes} <= {0x4B, 0}


@pytest.mark.parametrize(
    ("changes", "place", "words"),
    [
        ({"bus__registers__halt": "{ address = 9, table = 'holding' }"}, "", "'halt' is no coil"),
        ({"signals__command__bridge__on": "1"}, "", "leave on and off out"),
        ({"signals__command__bridge__off_signal": "'hold'"}, ".off_signal", "no register 'hold'"),
    ],
)
def test_what_cannot_stop_a_drive_is_refused(
    changes: dict[str, str | None], place: str, words: str
) -> None:
    two: dict[str, str | None] = {
        **TWO_COILS,
        "signals__command__bridge": None,
        "signals__command__bridge__signal": "'run'",
        "signals__command__bridge__off_signal": "'halt'",
        **changes,
    }
    assert words in flaws(**two)[f"signals.command.bridge{place}"]


def test_fields_of_one_register_are_written_together() -> None:
    ((block, sinks),) = plan(**FIELDS).writes
    assert block_words(block, sinks, RUN, 0)[1] == 0x0203
    assert block_words(block, sinks, SAFE_COMMAND, 0) == [0, 0x0200]


def test_fields_that_share_bits_are_a_flaw() -> None:
    wide = "{ address = 1, table = 'holding', mask = 0x0300 }"
    assert flaws(**FIELDS) == {}
    both = {**FIELDS, "bus__registers__other": wide, "signals__command__constants__other": "0"}
    place = "signals.command.constants.other"
    assert flaws(**both) == {place: "'other' lies in the same register as 'local'"}


def test_names_of_counts_switch() -> None:
    named = "{ address = 1, table = 'holding', names = { Stop = 0, Run = 5 } }"
    switch = "{ signal = 'control', on = 'Run', off = 'Stop' }"
    ((block, sinks),) = plan(bus__registers__control=named, signals__command__bridge=switch).writes
    assert block_words(block, sinks, RUN, 0)[1] == 5
    wrong = flaws(
        bus__registers__control=named, signals__command__bridge=switch.replace("Run", "Go")
    )
    assert "has no 'Go'" in wrong["signals.command.bridge"]


async def test_a_command_that_does_not_change_is_written_seldom() -> None:
    drive = Drive()
    drive.put("holding", MODE, 2)
    async with running(drive, bus__command_interval_s="0.4") as (port, ear):

        def commanded() -> bool:
            port.send(RUN)  # renewed, as by the fast loop
            return len(drive.written(CONTROL)) >= 4

        await until(commanded)
        count = len(ear.readings)
        assert count >= 3 * (len(drive.written(CONTROL)) - 1)
        port.send(SAFE_COMMAND)
        await until(lambda: drive.tables["holding"][CONTROL] == 0)


LIMITED = {
    "bus__registers__wanted": (
        "{ address = 0, table = 'holding', scale = 0.01, write_limit = 86400 }"
    ),
    "load__period_s": "2.0",
    "signals__load_power_W": None,
}


class Now:
    """A clock that a test sets."""

    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def test_a_register_that_wears_out_is_written_on_change_and_not_too_often() -> None:
    poll, clock = plan(**LIMITED), Now()
    wanted, control = sorted((block for block, _ in poll.writes), key=lambda one: one.address)
    assert (wanted, control) == (Block("holding", 0, 1), Block("holding", 1, 1))
    pace, writes = WritePace(poll, clock), 0
    for second in range(20 * 60):
        clock.now_s = second / 20.0
        if pace.is_due(wanted, [second // 3]):
            pace.note(wanted, [second // 3])
            writes += 1
    assert writes == 60  # one a second, as many a day as the register endures
    clock.now_s += DAY_S
    pace.note(wanted, [7])
    clock.now_s += DAY_S
    assert not pace.is_due(wanted, [7])
    pace.note(wanted)  # 8 was written, and no reply has come
    assert not pace.is_due(wanted, [7])
    clock.now_s += 1.0
    assert pace.is_due(wanted, [7])
    pace.note(wanted, [7])
    clock.now_s += DAY_S
    assert pace.is_due(wanted, [0])
    assert pace.is_due(control, [1])


@pytest.mark.parametrize(
    ("changes", "place", "words"),
    [
        ({"load__period_s": "0.5"}, "bus.registers.wanted.write_limit", "let load.period_s be 1 s"),
        (
            {"bus__command_timeout_s": "1.0"},
            "bus.registers.wanted.write_limit",
            "the time-out of a drive that needs writes",
        ),
        (
            {"bus__command_timeout_s": "1.0", "bus__command_interval_s": "0.9"},
            "bus.command_interval_s",
            "0.9 must be at most 0.85 s",
        ),
        (
            {"signals__load_power_W": "'power'"},
            "bus.registers.wanted.write_limit",
            "delays what holds V_c back",
        ),
        ({"bus__setup__speed": "1"}, "bus.setup.speed", "cannot be written"),
        ({"bus__setup__none": "1"}, "bus.setup.none", "no register 'none'"),
    ],
)
def test_what_cannot_work_is_a_flaw(changes: dict[str, str | None], place: str, words: str) -> None:
    assert words in flaws(**{**LIMITED, **changes})[place]
