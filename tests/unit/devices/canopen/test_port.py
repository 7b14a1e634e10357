"""The port against a node of the canopen library: set-up, readings, the way up, and what trips."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import can
import pytest
from canopen.sdo.exceptions import SdoAbortedError

from adaptdrive.config.bus import CanOpenBus
from adaptdrive.control.signals import SAFE_COMMAND
from adaptdrive.devices.can.bus import open_bus
from adaptdrive.devices.canopen.mapping import map_drive
from adaptdrive.devices.canopen.port import CanOpenWatch
from adaptdrive.safety.timing import timing_of
from tests.unit.devices.bench import until
from tests.unit.devices.canopen.bench import RUN, Ear, driven, ready, running
from tests.unit.devices.canopen.documents import EDS, MEMORY, other_eds, parse, without
from tests.unit.devices.canopen.peer import FAULT, NODE, REST, Peer


@pytest.fixture
async def peer() -> AsyncIterator[Peer]:
    peer = Peer()
    yield peer
    peer.close()


async def test_a_node_is_told_everything_before_it_is_started(peer: Peer) -> None:
    async with running(peer) as bench:
        await bench.ready()
    number = peer.number
    assert number(0x1016, 1) == 127 << 16 | 2000
    assert number(0x1017) == 400
    assert number(0x6007) == 2
    assert (number(0x1005), number(0x1006)) == (0x80, 8333)
    assert number(0x6060) == 0xFF
    assert [number(0x1A00, n) for n in range(4)] == [3, 0x60410010, 0x60790020, 0x20000110]
    assert [number(0x1A01, n) for n in range(3)] == [2, 0x20010120, 0x20010220]
    assert [number(0x1600, n) for n in range(3)] == [2, 0x60400010, 0x20000420]
    assert [number(0x1800 + n, 1) >> 31 for n in range(4)] == [0, 0, 1, 1]
    assert [number(0x1400 + n, 1) >> 31 for n in range(4)] == [0, 1, 1, 1]
    assert [number(0x1800, 1) & 0x7FF, number(0x1801, 1) & 0x7FF] == [0x185, 0x285]
    assert (number(0x1800, 2), number(0x1400, 2)) == (1, 255)


async def test_a_drive_that_syncs_is_told_to(peer: Peer) -> None:
    async with running(peer, sync="drive") as bench:
        await until(lambda: peer.node.nmt.state == "OPERATIONAL")
        await bench.complains("not known yet")  # nobody sends SYNC here
        assert peer.number(0x1005) == 0x40000080
        send_foreign(peer, (0x080, b""))
        await until(lambda: len(bench.ear.readings) == 1)


def send_foreign(peer: Peer, *frames: tuple[int, bytes]) -> None:
    """Send frames as another node of the bus."""
    with open_bus(peer.config) as bus:
        for can_id, data in frames:
            bus.send(can.Message(arbitration_id=can_id, is_extended_id=False, data=data))


async def test_a_reading_is_what_the_drive_measured_at_one_sync(peer: Peer) -> None:
    async with ready(peer) as bench:
        reading = bench.ear.readings[-1]
        assert reading.boost_voltage_V == pytest.approx(250.0)
        assert reading.line_voltage_V == pytest.approx(120.3)
        assert reading.load_power_W == pytest.approx(431.7)
        assert reading.output == pytest.approx(-3.123456)
        assert (reading.counter, reading.fault, reading.bridge) == (None, 0, False)
        assert 0.0 <= reading.arrival_s - reading.oldest_s < 0.5
        assert bench.port.trip_cause is None
        assert bench.ear.bus[-1] == (True, f"{bench.port.description}: operational")


async def test_a_pdo_that_was_refused_long_ago_does_not_explain_why_none_comes(peer: Peer) -> None:
    async with ready(peer) as bench:
        peer.network.send_message(0x180 + NODE, b"\0")
        await until(lambda: bench.port.statistics.wrong_length == 1)
        await bench.ready()
        peer.silent = {1, 2}
        await until(lambda: "TPDO1, TPDO2 has not come" in str(bench.port.explain_age()))
        assert "is SYNC on the bus" in str(bench.port.explain_age())


async def test_a_pdo_that_comes_twice_before_the_others_is_named(peer: Peer) -> None:
    async with ready(peer) as bench:
        peer.copies, peer.silent = 2, {2}
        await until(lambda: "TPDO1 came twice" in str(bench.port.explain_age()))


async def test_a_drive_that_was_on_and_says_nothing_since_its_set_up_gets_no_heartbeat(
    peer: Peer,
) -> None:
    async with driven(peer) as bench:
        peer.obeys, peer.silent = False, {1, 2}
        bench.ear.bus.clear()
        peer.node.nmt.state = "PRE-OPERATIONAL"
        await until(lambda: any(up for up, _ in bench.ear.bus))
        for _ in range(130):  # the ticks, which no reading starts
            bench.port.send(SAFE_COMMAND)
            await asyncio.sleep(0.01)
        known = len(peer.beats)
        for _ in range(30):
            bench.port.send(SAFE_COMMAND)
            await asyncio.sleep(0.01)
        assert len(peer.beats) == known
        peer.statusword, peer.silent = REST, set()
        await until(lambda: len(peer.beats) > known + 2)


def refuse_mapping(*, index: int, **_: object) -> None:
    """Refuse what a drive refuses that is energised: its PDOs stay as they are."""
    if index == 0x1400:
        raise SdoAbortedError(0x08000022)


async def test_a_lost_node_is_commanded_safe_before_it_is_made_pre_operational(peer: Peer) -> None:
    """Its heartbeat stays away, but it goes on: there it takes its last command."""
    peer.deaf = True
    async with driven(peer, heartbeat_timeout_s=0.5) as bench:
        peer.node.add_write_callback(refuse_mapping)
        bench.ear.command = None
        peer.node.nmt.stop_heartbeat()
        await bench.reports("cannot write 0x1400.1")
        assert peer.node.nmt.state == "PRE-OPERATIONAL"
        assert peer.words[-1] == 0x00
        assert not peer.powered


async def test_a_lost_node_takes_the_safe_command_of_each_tick_and_no_other(peer: Peer) -> None:
    async with driven(peer, heartbeat_timeout_s=0.5) as bench:
        peer.override(0x1018, 1, b"\xff\xff\xff\x7f")
        peer.node.nmt.state = "PRE-OPERATIONAL"
        await bench.reports("not operational any more")
        bench.ear.command = None
        await bench.reports("its vendor is")
        await asyncio.sleep(0.05)
        heard, known = len(peer.words), len(peer.beats)
        for command in (SAFE_COMMAND, RUN, SAFE_COMMAND):
            assert not bench.port.send(command)
        await until(lambda: len(peer.words) == heard + 2)
        assert peer.words[heard:] == [0x00, 0x00]
        assert len(peer.beats) == known
        assert bench.port.monitor.safe_s == math.inf


async def test_a_lost_node_that_obeys_nothing_is_switched_off_by_its_own_watch(peer: Peer) -> None:
    """Its set-up ends no time-out of it that runs, however often it is tried."""
    peer.deaf = True
    peer.arm()
    async with driven(peer, heartbeat_timeout_s=0.5) as bench:
        await until(lambda: len(peer.beats) > 2)
        peer.node.add_write_callback(refuse_mapping)
        peer.obeys = False
        peer.node.nmt.stop_heartbeat()
        await bench.reports("cannot write 0x1400.1")
        async with asyncio.timeout(10.0):
            await until(lambda: not peer.powered)


async def test_a_node_that_stays_on_while_its_communication_starts_anew_is_switched_off(
    peer: Peer,
) -> None:
    """Another master resets its communication: its watch begins anew, its power stage goes on."""

    def take(*, index: int, data: bytes, **_: object) -> None:
        if index == 0x6040 and data == b"\0\0":
            peer.statusword = REST
        if peer.powered:
            refuse_mapping(index=index)

    peer.deaf = True
    async with driven(peer) as bench:
        peer.node.add_write_callback(take)
        bench.ear.command = SAFE_COMMAND
        peer.boot()
        await bench.reports("has been restarted")
        await until(lambda: bench.port.trip_cause is None)
        assert not peer.powered


async def test_a_node_that_takes_no_controlword_over_sdo_is_set_up(peer: Peer) -> None:
    def refuse(*, index: int, **_: object) -> None:
        if index == 0x6040:
            raise SdoAbortedError(0x08000022)

    peer.node.add_write_callback(refuse)
    async with running(peer) as bench:
        await bench.ready()


async def test_a_restarted_node_gets_no_command_before_it_is_set_up(peer: Peer) -> None:
    """Its RPDOs are those of the manufacturer again."""
    async with ready(peer) as bench:
        peer.override(0x1018, 1, b"\xff\xff\xff\x7f")
        bench.ear.command = None
        await asyncio.sleep(0.05)
        peer.node.nmt.state = "INITIALISING"
        peer.node.nmt.state = "PRE-OPERATIONAL"
        await bench.reports("its vendor is")
        known = len(peer.words)
        assert not bench.port.send(SAFE_COMMAND)
        await asyncio.sleep(0.05)
        assert len(peer.words) == known


async def test_a_heartbeat_that_stays_away_is_told_and_the_node_set_up_again(peer: Peer) -> None:
    async with driven(peer, heartbeat_timeout_s=0.5) as bench:
        peer.node.nmt.stop_heartbeat()
        await bench.complains("node 5: heartbeat lost for")
        bench.ear.command = SAFE_COMMAND
        bench.port.send(SAFE_COMMAND)
        await until(lambda: bench.port.trip_cause is None)  # its 0x1017 was written again
        assert any("heartbeat lost" in detail for up, detail in bench.ear.bus if not up)
        assert bench.ear.bus[-1][0]


async def test_a_restarted_node_is_not_energised_again(peer: Peer) -> None:
    async with driven(peer) as bench:
        peer.statusword = REST
        known = len(peer.words)
        peer.boot()
        assert await bench.complains("restarted") == "node 5: has been restarted"
        await until(lambda: peer.node.nmt.state == "OPERATIONAL")
        await bench.ready()
        assert (
            str(bench.port.trip_cause) == "node 5: has been restarted"
        )  # until it is commanded safe
        assert set(peer.words[known:]) <= {0x00, 0x0F}
        after = [word for word in peer.words[known:] if word]
        assert 0x06 not in after
        bench.ear.command = SAFE_COMMAND
        await until(lambda: bench.port.trip_cause is None)
        bench.ear.command = RUN
        await until(lambda: bench.ear.readings[-1].bridge)


async def test_a_node_that_somebody_stops_is_told(peer: Peer) -> None:
    async with driven(peer) as bench:
        peer.node.nmt.state = "STOPPED"
        peer.node.nmt.update_heartbeat()
        text = await bench.complains("not operational")
        assert text == "node 5: is not operational any more (state 4)"


async def test_an_emergency_stays_until_the_drive_takes_it_back(peer: Peer) -> None:
    async with driven(peer) as bench:
        peer.node.emcy.send(0x4310, 0x09, b"hot")
        text = await bench.complains("emergency")
        assert text == (
            "node 5: emergency 0x4310, excess temperature of the drive (error register 0x09)"
        )
        bench.ear.command = SAFE_COMMAND
        await bench.ready()
        assert "0x4310" in str(bench.port.trip_cause)
        peer.node.emcy.reset()
        await until(lambda: bench.port.trip_cause is None)
        peer.node.emcy.send(0x4310, 0x09, b"hot")
        await bench.complains("0x4310")
        await bench.port.reset_fault()  # the operator may forget that of a drive without a fault
        assert bench.port.trip_cause is None


async def test_an_emergency_does_not_hide_why_its_node_is_not_set_up(peer: Peer) -> None:
    """A reset ends neither, and the operator must know what to mend."""
    peer.override(0x1018, 1, b"\xff\xff\xff\x7f")
    async with running(peer) as bench:
        await bench.reports("its vendor is")
        peer.node.emcy.send(0x4310, 0x09, b"hot")
        text = await bench.complains("0x4310")
        await bench.port.reset_fault()
        assert text == str(bench.port.trip_cause)
        assert "not ready: is not the drive of cia402.eds" in text


async def test_a_fault_is_reset_by_an_edge_when_the_operator_says_so(peer: Peer) -> None:
    async with driven(peer) as bench:
        peer.obeys = False
        peer.statusword = FAULT
        await bench.complains("left its state by itself: fault")
        bench.ear.command = SAFE_COMMAND
        await bench.complains("the drive's state is fault")
        await bench.ready()
        assert not any(word & 0x80 for word in peer.words)
        reset = asyncio.create_task(bench.port.reset_fault())
        await until(lambda: peer.words[-1] == 0x80)
        assert peer.words[-2] in {0x00, 0x80}
        peer.statusword, peer.obeys = REST, True
        await reset
        assert bench.port.trip_cause is None
        await until(lambda: peer.words[-1] == 0x00)


async def test_a_fault_that_stays_is_given_up_in_bounded_time(peer: Peer) -> None:
    async with ready(peer) as bench:
        peer.statusword, peer.obeys = FAULT, False
        await bench.complains("fault")
        async with asyncio.timeout(10.0):
            await bench.port.reset_fault()
        assert str(bench.port.trip_cause) == "node 5: the drive's state is fault"


@pytest.mark.parametrize(
    ("index", "subindex", "data", "reason"),
    [
        (0x1000, 0, b"\x91\x01\x02\x00", "names profile 401"),
        (0x1018, 1, b"\x01\x00\x00\x00", "its vendor is 0x00000001, the EDS is for 0x00000AD0"),
        (0x1018, 2, b"\x03\x04\x00\x00", "its product is 0x00000403, the EDS is for 0x00000402"),
    ],
)
async def test_another_drive_than_that_of_the_eds_is_left_alone(
    peer: Peer, index: int, subindex: int, data: bytes, reason: str
) -> None:
    peer.override(index, subindex, data)
    async with running(peer) as bench:
        assert "node 5: is" in await bench.complains(reason)
        assert bench.port.send(RUN) is False
        assert peer.node.nmt.state == "PRE-OPERATIONAL"
        assert peer.number(0x1016, 1) == 0
    assert peer.words == []


@pytest.mark.parametrize(("index", "verb"), [("6007", "write 0x6007"), ("6060", "write 0x6060")])
async def test_what_the_drive_has_not_though_the_eds_says_so_is_named(
    tmp_path: Path, index: str, verb: str
) -> None:
    eds = other_eds(tmp_path, without(index))
    with contextlib.closing(Peer(eds=eds)) as peer:
        async with running(peer) as bench:
            assert "object does not exist" in await bench.complains(f"cannot {verb}")


@pytest.mark.parametrize("node_has", [True, False])
async def test_the_node_is_asked_for_what_its_eds_does_not_list(
    tmp_path: Path, *, node_has: bool
) -> None:
    """SYNC has its id of CiA 301; a node that does not monitor the daemon is not used."""
    eds = other_eds(tmp_path, without("1005"), without("1016"))
    with contextlib.closing(Peer(eds=EDS if node_has else eds)) as peer:
        async with running(peer, eds=eds) as bench:
            if not node_has:
                assert "object does not exist" in await bench.complains("cannot read 0x1016.1")
                return
            await bench.ready()
        assert (peer.number(0x1005), peer.number(0x1016, 1)) == (0x80, 127 << 16 | 2000)


async def test_a_node_without_an_id_of_its_sync_is_synchronised(tmp_path: Path) -> None:
    eds = other_eds(tmp_path, without("1005"))
    with contextlib.closing(Peer(eds=eds)) as peer:
        async with running(peer, eds=eds) as bench:
            await bench.ready()


async def test_heartbeats_and_emergencies_of_two_bytes_are_read(peer: Peer) -> None:
    send = peer.network.send_message

    def longer(can_id: int, data: bytes, remote: bool = False) -> None:
        send(can_id, bytes(data) + b"\0" * (can_id == 0x700 + NODE), remote)

    peer.network.send_message = longer  # type: ignore[method-assign]
    async with driven(peer) as bench:
        send_foreign(peer, (0x080 + NODE, b"\x10\x43"))
        text = await bench.complains("emergency")
        assert text == "node 5: emergency 0x4310, excess temperature of the drive"
        bench.ear.command = SAFE_COMMAND
        send_foreign(peer, (0x080 + NODE, b"\0\0"))
        await until(lambda: bench.port.trip_cause is None)


QUICK_STOP = """[605A]
ParameterName=Quick stop option code
ObjectType=0x7
DataType=0x0003
AccessType=rw
DefaultValue={}
PDOMapping=0

[6060]"""


@pytest.mark.parametrize(
    ("option", "written"), [(0, 0), (2, 2), (5, 1), (6, 2), (8, 4), (-1, 0xFFFF)]
)
async def test_a_quick_stop_ends_where_no_single_command_ends_it(
    tmp_path: Path, option: int, written: int
) -> None:
    eds = other_eds(tmp_path, ("[6060]", QUICK_STOP.format(option)))
    with contextlib.closing(Peer(eds=eds)) as peer:
        async with running(peer, eds=eds) as bench:
            await bench.ready()
        assert peer.number(0x605A) == written


async def test_a_frame_id_that_is_too_long_is_refused_like_any_other_answer(
    tmp_path: Path,
) -> None:
    entry = "DataType={}\nAccessType=rw\nDefaultValue=$NODEID+{}"
    longer = entry.format("0x0007", "0x80000300"), entry.format("0x001B", "0x300")
    with contextlib.closing(Peer(eds=other_eds(tmp_path, longer))) as peer:
        async with running(peer) as bench:
            await bench.complains("0x1401.1 has 8 bytes, a number has at most 4")


async def test_a_drive_that_keeps_another_value_is_not_trusted(peer: Peer) -> None:
    peer.keep(0x1016, lambda data: data[:2] + b"\x7e\x00" if len(data) == 4 else data)
    async with running(peer) as bench:
        await bench.complains("0x1016.1 is 0x007e07d0 after 0x007f07d0 was written")


async def test_a_drive_that_is_not_there_is_waited_for(tmp_path: Path) -> None:
    absent = Peer()
    absent.close()
    async with running(absent, sdo_timeout_s=0.1) as bench:
        await bench.complains("no answer when asked to read 0x1000")
        with contextlib.closing(Peer()) as peer:
            peer.boot()
            await bench.ready()


def watching(config: CanOpenBus) -> CanOpenWatch:
    """A port that only looks at the drive."""
    configuration = parse()
    mapping = map_drive(config, configuration.signals)
    return CanOpenWatch(config, mapping, timing_of(configuration), asyncio.get_running_loop().time)


async def test_looking_at_a_drive_writes_nothing_to_it(peer: Peer) -> None:
    watch = watching(peer.config)
    peer.override(0x6079, 0, (250_000).to_bytes(4, "little"))
    peer.override(0x6041, 0, (0x0237).to_bytes(2, "little"))
    writes: list[Any] = []
    peer.node.add_write_callback(lambda **write: writes.append(write))
    ear = Ear()
    async with asyncio.TaskGroup() as tasks:
        task = tasks.create_task(watch.run(ear, lambda: None))
        await until(lambda: len(ear.readings) > 1)
        assert watch.send(RUN) is False
        task.cancel()
    assert ear.readings[-1].boost_voltage_V == pytest.approx(250.0)
    assert ear.readings[-1].bridge
    assert (writes, peer.words, peer.beats) == ([], [], [])
    assert peer.node.nmt.state == "INITIALISING"  # as it was: nobody has said a word of NMT


async def test_looking_at_a_drive_that_does_not_answer_says_so(tmp_path: Path) -> None:
    watch = watching(MEMORY.model_copy(update={"sdo_timeout_s": 0.05}))
    ear = Ear()
    async with asyncio.TaskGroup() as tasks:
        task = tasks.create_task(watch.run(ear, lambda: None))
        await until(lambda: bool(ear.bus))
        task.cancel()
    assert ear.bus == [(False, f"{watch.description}: no answer when asked to read 0x6079")]


@pytest.mark.parametrize(
    ("can_id", "data", "name"),
    [(0x77F, b"\x05", "0x77F (heartbeat of"), (0x080, b"", "0x080 (SYNC of")],
    ids=["heartbeat under the daemon's id", "SYNC"],
)
async def test_a_heartbeat_or_sync_in_place_of_the_daemons_is_a_complaint(
    peer: Peer, can_id: int, data: bytes, name: str
) -> None:
    async with driven(peer) as bench:
        await until(lambda: len(peer.beats) > 2)
        assert bench.port.trip_cause is None
        send_foreign(peer, (0x77E, b"\x05"), (can_id, data))
        await bench.complains(f"another sender commands this drive: 1 x frame {name}")
        assert bench.port.statistics.foreign_commands == 1


async def test_another_master_of_the_node_is_a_complaint(peer: Peer) -> None:
    async with ready(peer) as bench:
        assert bench.port.trip_cause is None
        harmless = [(0x605, b"\x40\x41\x60\0\0\0\0\0"), (0x000, b"\x01\x05"), (0x123, bytes(8))]
        commands = [(0x605, b"\x2b\x40\x60\0\x06\0\0\0"), (0x205, bytes(8))]
        send_foreign(peer, *harmless, *commands)
        await until(lambda: bench.port.statistics.foreign_commands == len(commands))
        await bench.complains("another sender commands this drive: 2 x frame 0x205")


async def test_a_node_whose_watch_another_sender_has_switched_off_is_set_up_again(
    peer: Peer,
) -> None:
    async with ready(peer) as bench:
        watch = peer.number(0x1016, 1)
        send_foreign(peer, (0x605, b"\x23\x16\x10\x01\0\0\0\0"))
        await until(lambda: peer.number(0x1016, 1) == 0)
        await bench.complains("another sender commands this drive")

        while peer.number(0x1016, 1) != watch:
            assert bench.port.trip_cause is not None, "it may be energised without its watch"
            await asyncio.sleep(0.001)
        await until(lambda: bench.port.trip_cause is None)
        await bench.run_drive()
        assert peer.number(0x1016, 1) == watch


async def test_a_node_that_leaves_operational_for_a_moment_is_set_up_again(peer: Peer) -> None:
    """Both heartbeats come before the port has looked once."""
    async with ready(peer) as bench:
        known = bench.port.statistics.reconnects
        for state in (0x7F, 0x05):
            peer.network.send_message(0x700 + NODE, bytes((state,)))
        await until(lambda: bench.port.statistics.reconnects == known + 1)
        await until(lambda: bench.port.trip_cause is None)


async def test_pdos_that_come_twice_make_one_reading_for_each_sync(peer: Peer) -> None:
    """A gateway that repeats them would double the rate of control."""
    async with ready(peer) as bench:
        peer.copies = 2
        syncs, readings = peer.syncs, len(bench.ear.readings)
        await until(lambda: peer.syncs >= syncs + 30)
        assert 20 < len(bench.ear.readings) - readings <= peer.syncs - syncs + 2
        assert bench.port.statistics.counter_stuck > 0
