"""A stop that does not reach the drive, with the whole daemon behind its bus.

`WIRE_REPORT` keeps the measured times, as for the faults of the wire.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Iterator

import pytest

from adaptdrive.runtime.reports import State, StopWord
from adaptdrive.runtime.requests import Disable, Enable, Reset
from adaptdrive.util.errors import RefusedError
from tests.integration.wire.rig import Rig, rigged, until
from tests.integration.wire.test_matrix import note, run_steadily
from tests.integration.wire.wires import (
    OUTPUT_V,
    PATIENT_NODE,
    CanWire,
    Frames,
    PATIENT_s,
    modbus_wire,
    motor_text,
    strung,
)
from tests.unit.devices import bench as can_bench
from tests.unit.devices.canopen.documents import IN_MEMORY, parse
from tests.unit.devices.canopen.peer import ENABLED, MEASURED
from tests.unit.devices.canopen.peer import Peer as Node
from tests.unit.devices.modbus.bench import Peer

pytestmark = pytest.mark.usefixtures("memory")
ANNOUNCED_s = 1.0


async def alarm(rig: Rig, kind: str, since_s: float) -> tuple[str, float]:
    """Wait for an event; its words, and how long it took."""
    await until(lambda: rig.heard(kind, since_s))
    when_s = next(when for when, event in rig.events if event.kind == kind and when >= since_s)
    return rig.heard(kind, since_s)[0], when_s - since_s


def refused_writes(pdu: bytes) -> bytes:
    """The device answers each write with exception 3, and reads as usual."""
    return bytes((pdu[0] | 0x80, 3)) if pdu[0] == 16 else pdu


async def test_a_bridge_that_stays_on_is_announced() -> None:
    wire = CanWire()
    async with strung(wire), rigged(wire.configuration) as rig:
        await run_steadily(wire, rig)
        wire.values["BridgeOn"] = 1
        began_s = asyncio.get_running_loop().time()
        assert await rig.daemon.execute(Disable()) is State.STOPPING
        with pytest.raises(RefusedError, match="has not confirmed its stop"):
            await rig.daemon.execute(Enable())
        trip, after_s = await alarm(rig, "trip", began_s)
        assert trip.startswith("the drive does not stop: its bridge is still on ")
        assert after_s < ANNOUNCED_s
        note("stop-unconfirmed-can", after_s, 0.0)
        before_s = wire.told[0]
        await until(lambda: wire.told[0] > before_s + 0.1)
        assert not wire.told[1]
        with pytest.raises(RefusedError, match="bridge is on although it is commanded off"):
            await rig.daemon.execute(Reset())
        await wire.heal()
        await rig.ask(Reset())
        await rig.reaches(State.STANDBY)
        assert rig.state is not None
        assert rig.state.stop is StopWord.CONFIRMED


@pytest.mark.parametrize(
    "statusword",
    [ENABLED, 0x0217, 0x0247],
    ids=["enabled", "quick stop active", "no state of CiA 402"],
)
async def test_a_node_that_stays_enabled_is_announced(
    statusword: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(MEASURED, "0x2001.2", 1_000_000)
    with contextlib.closing(Node()) as peer:
        bus = IN_MEMORY
        async with rigged(parse({**PATIENT_NODE, **bus})) as rig:
            await rig.run()
            await until(lambda: peer.statusword == ENABLED)
            peer.obeys = False
            began_s = asyncio.get_running_loop().time()
            assert await rig.daemon.execute(Disable()) is State.STOPPING
            peer.statusword = statusword
            trip, after_s = await alarm(rig, "trip", began_s)
            assert trip.startswith("the drive does not stop: its bridge is still on ")
            assert after_s < ANNOUNCED_s
            note("stop-unconfirmed-canopen", after_s, 0.0)
            told = len(peer.words)
            await until(lambda: len(peer.words) > told + 10)
            assert set(peer.words[told:]) == {0x00}
            with pytest.raises(RefusedError):
                await rig.daemon.execute(Enable())
            peer.obeys = True
            await rig.ask(Reset())
            await rig.reaches(State.STANDBY)


@pytest.mark.parametrize("messages", [1, 2], ids=["the values beside it", "every value"])
async def test_a_fault_beside_values_that_are_not_available_trips_and_the_stop_is_confirmed(
    messages: int,
) -> None:
    wire = CanWire(motor_text(stale_s=PATIENT_s))

    def without_values(frames: Frames) -> Iterator[tuple[float, Frames]]:
        """Send no voltage, and no output either where both messages are without values."""
        none = [b"\xff\xff", b"\xff\xff\x7f" if messages == 2 else b""]
        for spoilt, (name, data) in zip(none, frames, strict=True):
            yield 0.0, [(name, can_bench.with_crc(spoilt + data[len(spoilt) :]))]

    async with strung(wire), rigged(wire.configuration) as rig:
        await run_steadily(wire, rig)
        began_s = asyncio.get_running_loop().time()
        wire.values["Fault"], wire.spoil = 2, without_values
        trip, _ = await alarm(rig, "trip", began_s)
        assert trip.startswith("drive fault: Fault bit 1 Overtemperature (word 0x2)")
        await until(lambda: rig.state is not None and rig.state.stop is StopWord.CONFIRMED)
        await until(lambda: rig.heard("trip", began_s))
        assert not any("does not stop" in event.detail for _, event in rig.events)


class BlindWhenOff(Peer):
    """A Modbus drive that reports its bridge, and no speed from a stop or a fault on.

    Attributes:
        fault: Whether it has a fault, in which it is off.
        blind: Whether it gives no speed.
    """

    fault = blind = False

    def _write(self, head: bytes, data: bytes) -> None:
        super()._write(head, data)
        on = bool(self.writes[-1][1][1])
        self.blind = self.blind or (bool(self.state) and not on)
        self.state = int(on)

    def _registers(self, function: int, address: int, count: int) -> bytes:
        if self.fault:
            self.blind, self.state = True, 2
        self.speed = math.nan if self.blind else OUTPUT_V
        return super()._registers(function, address, count)


@pytest.mark.parametrize("fault", [True, False], ids=["fault", "disable"])
async def test_a_modbus_drive_without_values_once_it_is_off_confirms_its_stop(
    *, fault: bool
) -> None:
    bits: dict[str, str | None] = {
        "bus__registers__on": "{ address = 5, table = 'input', mask = 0x1 }",
        "bus__registers__fault": "{ address = 5, table = 'input', mask = 0x2 }",
        "signals__bridge": '"on"',
        "signals__fault": '"fault"',
    }
    peer = BlindWhenOff()
    patient = {"bus__heartbeat__drive": None, "interlocks__stale_s": str(PATIENT_s)}
    wire = modbus_wire("tcp", peer, **bits, **patient)
    async with strung(wire), rigged(wire.configuration) as rig:
        await run_steadily(wire, rig)
        peer.blind, began_s = False, asyncio.get_running_loop().time()
        if fault:
            peer.fault = True
            trip, _ = await alarm(rig, "trip", began_s)
            assert trip == "drive fault: fault 1 (bit 0) (word 0x1)"
        else:
            assert await rig.daemon.execute(Disable()) is State.STOPPING
        await until(lambda: rig.state is not None and rig.state.stop is StopWord.CONFIRMED)
        assert peer.blind
        assert not rig.heard("stop", began_s)


async def test_a_bridge_switched_on_by_others_trips() -> None:
    wire = CanWire()
    async with strung(wire), rigged(wire.configuration) as rig:
        await rig.recovers()
        await until(lambda: rig.state is not None and rig.state.stop is StopWord.CONFIRMED)
        began_s = asyncio.get_running_loop().time()
        wire.values["BridgeOn"] = 1
        trip, after_s = await alarm(rig, "trip", began_s)
        assert trip.startswith("the drive's bridge is on although this daemon did not command it")
        note("switched-on-can", after_s, 0.0)


async def test_refused_writes_trip_a_running_drive() -> None:
    wire = modbus_wire("tcp", interlocks__stale_s=str(PATIENT_s))
    async with strung(wire), rigged(wire.configuration) as rig:
        await run_steadily(wire, rig)
        began_s = asyncio.get_running_loop().time()
        wire.peer.answer = refused_writes
        trip, after_s = await alarm(rig, "trip", began_s)
        assert trip.startswith(
            "the drive refuses commands: exception reply 3 to function 16 (illegal value), holding "
        )
        note("writes-refused-tcp", after_s, 0.0)
        stop, after_s = await alarm(rig, "stop", began_s)
        assert stop.startswith("the drive does not stop: it has not taken the safe command ")
        assert after_s < ANNOUNCED_s
        note("stop-refused-tcp", after_s, 0.0)
        trip_cause = "the drive refuses commands: exception reply 3"
        await until(lambda: str(rig.port.trip_cause).startswith(trip_cause))
        with pytest.raises(RefusedError, match=trip_cause):
            await rig.daemon.execute(Reset())
        await wire.heal()
        await rig.ask(Reset())
        await rig.reaches(State.STANDBY)


async def test_a_disable_that_is_refused_is_not_standby() -> None:
    wire = modbus_wire("tcp", interlocks__stale_s=str(PATIENT_s))
    async with strung(wire), rigged(wire.configuration) as rig:
        await run_steadily(wire, rig)
        wire.peer.answer = refused_writes
        began_s = asyncio.get_running_loop().time()
        assert await rig.daemon.execute(Disable()) is State.STOPPING
        written = len(wire.peer.writes) + 1  # one may have been on the wire already
        trip, after_s = await alarm(rig, "trip", began_s)
        assert trip.startswith("the drive does not stop: it has not taken the safe command ")
        assert after_s < ANNOUNCED_s
        await until(lambda: len(wire.peer.writes) > written + 10)  # it is repeated all the time
        assert not any(registers[1] for _, registers in wire.peer.writes[written:])
        await wire.heal()
        await rig.ask(Reset())
        await rig.reaches(State.STANDBY)
