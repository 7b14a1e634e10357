"""Every fault of the wire, on every kind of bus: how it is made, and what is to come of it.

`tools/pages/wire_faults.py` writes the table of the documentation.
"""

from __future__ import annotations

import itertools
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass
from typing import cast

from adaptdrive.devices.can import port as can_port
from tests.integration.wire.rig import Rig
from tests.integration.wire.wires import (
    STUCK_V,
    CanWire,
    Frames,
    ModbusWire,
    Spoil,
    Wire,
    as_it_is,
    float_bytes,
    with_crc,
)
from tests.unit.devices.modbus import bench as modbus
from tests.unit.devices.modbus import spoils

LINKS = ("can", "tcp", "rtu")
_NOW_AND_THEN = 12
_STRANGERS_Hz = 5000

Inject = Callable[[Wire, Rig], Awaitable[None] | None]


@dataclass(frozen=True, slots=True)
class Cell:
    """One fault on one kind of bus.

    Attributes:
        inject: Makes the fault, until the wire is healed.
        trips: Whether the drive is to be tripped; otherwise it goes on.
        count: The count of the port in which it shows, if it shows in one.
        words: What an event of the bus says, if there is one.
        cause: How the cause of the trip begins.
        hears: Whether the drive can hear the safe command meanwhile.
        floats: Whether it needs the database with a floating-point signal.
    """

    inject: Inject
    trips: bool
    count: str = ""
    words: str = ""
    cause: str = "stale"
    hears: bool = True
    floats: bool = False


@dataclass(frozen=True, slots=True)
class Row:
    """One fault: a cell for each kind of bus, or why there is none."""

    name: str
    label: str
    can: Cell | str
    tcp: Cell | str
    rtu: Cell | str


def on_can(spoil: Spoil) -> Inject:
    """Spoil what the drive on CAN sends."""

    def inject(wire: Wire, _: Rig) -> None:
        cast("CanWire", wire).spoil = spoil

    return inject


def now_and_then(spoil: Spoil) -> Spoil:
    """Do it to one half cycle out of some."""
    numbers = itertools.count(1)

    def spoiled(frames: Frames) -> Iterable[tuple[float, Frames]]:
        return spoil(frames) if next(numbers) % _NOW_AND_THEN == 0 else as_it_is(frames)

    return spoiled


def each(change: Callable[[bytes], bytes]) -> Spoil:
    """Change the bytes of each frame."""
    return lambda frames: [(0.0, [(name, change(data)) for name, data in frames])]


def swapped() -> Spoil:
    """Frames of two half cycles in the wrong order, now and then."""
    kept: list[Frames] = []
    numbers = itertools.count(1)

    def spoiled(frames: Frames) -> Iterable[tuple[float, Frames]]:
        if next(numbers) % _NOW_AND_THEN == 0:
            kept.append(frames)
            return []
        return [(0.0, frames), *((0.0, kept.pop()) for _ in list(kept))]

    return spoiled


def stuck_counter() -> Spoil:
    """New values under the alive counter of the first frame."""
    first: dict[str, bytes] = {}

    def spoiled(frames: Frames) -> Iterable[tuple[float, Frames]]:
        for name, data in frames:
            first.setdefault(name, data)
        return [
            (
                0.0,
                [(name, with_crc(data[:6] + first[name][6:7] + data[7:])) for name, data in frames],
            )
        ]

    return spoiled


def says(name: str, content: bytes) -> Spoil:
    """One message begins with other bytes."""

    def change(frames: Frames) -> Frames:
        return [
            (found, with_crc(content + data[len(content) :]) if found == name else data)
            for found, data in frames
        ]

    return lambda frames: [(0.0, change(frames))]


def frozen(frames: Frames) -> Iterable[tuple[float, Frames]]:
    """The boost voltage is another one, and the output does not move."""
    count = round(100.0 * STUCK_V).to_bytes(2, "little")
    return says("DriveStatus", count)(frames)


def pulled(wire: Wire, _: Rig) -> None:
    """Nothing gets through in either direction."""
    can_wire = cast("CanWire", wire)
    can_wire.spoil, can_wire.deaf = (lambda _: []), True


def bus_off(wire: Wire, _: Rig) -> None:
    """The controller leaves the bus: it hears nothing any more."""
    cast("CanWire", wire).go_bus_off()
    pulled(wire, _)


def closed(wire: Wire, rig: Rig) -> None:
    """The interface goes away under the daemon."""
    bus = cast("can_port.Port", rig.port)._connection.bus
    assert bus is not None
    pulled(wire, rig)
    bus.shutdown()


def foreign(wire: Wire, _: Rig) -> None:
    """Many frames that nobody asked for, with those of the drive."""
    can_wire = cast("CanWire", wire)
    count = round(_STRANGERS_Hz / 120)

    def spoiled(frames: Frames) -> Iterable[tuple[float, Frames]]:
        for _ in range(count):
            can_wire.send_stranger()
        return as_it_is(frames)

    can_wire.spoil = spoiled


def on_modbus(**changes: object) -> Inject:
    """Change the device on Modbus."""

    def inject(wire: Wire, _: Rig) -> None:
        for name, value in changes.items():
            setattr(cast("ModbusWire", wire).peer, name, value)

    return inject


def fifth(spoil: modbus.Spoil) -> Inject:
    """Spoil one reply out of some."""
    numbers = itertools.count(1)
    return on_modbus(
        spoil=lambda reply: spoil(reply) if next(numbers) % _NOW_AND_THEN == 0 else [(0.0, reply)]
    )


def twice(reply: bytes) -> modbus.Pieces:
    return [(0.0, reply), (0.001, reply)]


async def away(wire: Wire, _: Rig) -> None:
    """The device goes."""
    await wire.stop()


def modbus_both(
    count: str,
    *,
    trips: bool = True,
    cause: str = "stale",
    **changes: object,
) -> tuple[Cell, Cell]:
    """The same cell on TCP and on RTU."""
    cell = Cell(on_modbus(**changes), trips=trips, count=count, cause=cause)
    return cell, cell


_SERIAL_ONLY = "own checksum"
_NAN, _HIGH = float_bytes(float("nan")), float_bytes(9.5)

ROWS = (
    Row(
        "one-lost",
        "one frame or reply lost",
        Cell(on_can(now_and_then(lambda _: [])), trips=False, count="counter_lost"),
        Cell(fifth(spoils.silence), trips=False, count="timeouts"),
        Cell(fifth(spoils.silence), trips=False, count="timeouts"),
    ),
    Row(
        "burst-lost",
        "burst lost, longer than `stale_s`",
        Cell(on_can(lambda _: []), trips=True),
        *modbus_both("timeouts", spoil=spoils.silence),
    ),
    Row(
        "duplicated",
        "duplicated",
        Cell(on_can(lambda frames: [(0.0, frames * 2)]), trips=False, count="counter_stuck"),
        Cell(fifth(twice), trips=False, count="foreign"),
        Cell(fifth(twice), trips=False, count="foreign"),
    ),
    Row(
        "reordered",
        "reordered",
        Cell(on_can(swapped()), trips=False, count="counter_lost"),
        "none",
        "none",
    ),
    Row(
        "late",
        "late: frame by 30 ms, reply after its time-out",
        Cell(on_can(now_and_then(lambda frames: [(0.03, frames)])), trips=False),
        *modbus_both("foreign", spoil=spoils.late),
    ),
    Row(
        "truncated",
        "truncated",
        Cell(on_can(each(lambda data: data[:7])), trips=True, count="wrong_length"),
        Cell(on_modbus(spoil=spoils.cut), trips=True, count="timeouts"),
        Cell(on_modbus(spoil=spoils.cut), trips=True, count="wrong_length"),
    ),
    Row(
        "wrong-length",
        "whole, but of another length",
        Cell(on_can(each(lambda data: with_crc(data[:4]))), trips=True, count="wrong_length"),
        *modbus_both("foreign", answer=spoils.fewer),
    ),
    Row(
        "bad-checksum",
        "bad checksum",
        Cell(
            on_can(each(lambda data: bytes((data[0] ^ 1,)) + data[1:])),
            trips=True,
            count="wrong_checksum",
        ),
        _SERIAL_ONLY,
        Cell(on_modbus(spoil=spoils.flipped), trips=True, count="wrong_checksum"),
    ),
    Row(
        "counter-stuck",
        "counter or heartbeat stands still",
        Cell(on_can(stuck_counter()), trips=True, count="counter_stuck"),
        *modbus_both("counter_stuck", state=0),
    ),
    Row(
        "sensor-stuck",
        "output frozen, counter alive, v_bst 100 V higher",
        Cell(on_can(frozen), trips=True, cause="stuck"),
        Cell(on_modbus(voltage=40012), trips=True, cause="stuck"),
        Cell(on_modbus(voltage=40012), trips=True, cause="stuck"),
    ),
    Row(
        "nan",
        "value is NaN",
        Cell(on_can(says("DriveLoad", _NAN)), trips=True, count="out_of_range", floats=True),
        *modbus_both("out_of_range", speed=float("nan")),
    ),
    Row(
        "out-of-range",
        "value out of range",
        Cell(on_can(says("DriveLoad", _HIGH)), trips=True, count="out_of_range", floats=True),
        *modbus_both("out_of_range", voltage=60001),
    ),
    Row(
        "not-available",
        "value *not available* (all ones)",
        Cell(on_can(says("DriveStatus", b"\xff\xff")), trips=True, count="out_of_range"),
        *modbus_both("out_of_range", voltage=0xFFFF),
    ),
    Row(
        "foreign",
        "foreign frames, 5,000 a second; replies of another device",
        Cell(foreign, trips=False, count="foreign"),
        Cell(on_modbus(spoil=spoils.other_protocol), trips=True, count="timeouts"),
        Cell(on_modbus(spoil=spoils.foreign_device), trips=True, count="timeouts"),
    ),
    Row(
        "transaction",
        "wrong transaction id",
        "none",
        Cell(on_modbus(spoil=spoils.other_transaction), trips=True, count="foreign"),
        "none",
    ),
    Row(
        "exception",
        "exception replies",
        "none",
        *modbus_both(
            "exceptions",
            cause="the drive refuses commands",
            answer=spoils.exception,
        ),
    ),
    Row(
        "noise",
        "noise on the line",
        "the controller drops it",
        _SERIAL_ONLY,
        Cell(on_modbus(spoil=spoils.noisy), trips=True, count="timeouts"),
    ),
    Row(
        "bus-off",
        "bus-off",
        Cell(bus_off, trips=True, words="bus-off", hears=False),
        "none",
        "none",
    ),
    Row(
        "cable",
        "cable pulled and put back; half-open connection",
        Cell(pulled, trips=True, hears=False),
        Cell(on_modbus(spoil=spoils.silence), trips=True, count="timeouts", words="no reply"),
        Cell(on_modbus(spoil=spoils.silence), trips=True, count="timeouts", words="no reply"),
    ),
    Row(
        "restart",
        "interface or adapter gone and back; server restarted",
        Cell(closed, trips=True, words="virtual", hears=False),
        Cell(away, trips=True, words="modbus-tcp", hears=False),
        Cell(away, trips=True, words="modbus-rtu", hears=False),
    ),
)

CELLS = {
    f"{row.name}-{link}": cell
    for row in ROWS
    for link in LINKS
    if isinstance(cell := getattr(row, link), Cell)
}
