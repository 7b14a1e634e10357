"""Each fault of the wire, on each kind of bus, with the whole daemon behind it.

In none of them is a command computed from a value that the drive did not send in a good frame; the
drive is safe in time where it can hear at all; and when the fault has gone, a reset is accepted.
"""

from __future__ import annotations

import asyncio
import inspect
import json
import os
from pathlib import Path

import pytest

from adaptdrive.runtime.reports import State
from tests.integration.wire.matrix import CELLS, Cell
from tests.integration.wire.rig import Rig, rigged, until
from tests.integration.wire.wires import (
    BOOST_V,
    OUTPUT_V,
    STUCK_V,
    CanWire,
    PATIENT_s,
    Wire,
    float_dbc,
    modbus_wire,
    motor_text,
    strung,
)
from tools.pages.wire_faults import section, table, without_times

TESTS = Path(__file__).parents[2]
PAGE = TESTS.parent / "docs" / "proof" / "reliability.md"
_WATCHED_s = 1.0
_RUNNING_s = 0.2
"""Some polls of a running drive before the wire is spoiled."""

ON_MODBUS = {
    **dict.fromkeys(("one-lost", "not-available", "transaction", "exception"), "tcp"),
    **dict.fromkeys(("cable", "restart"), "tcp"),
    **dict.fromkeys(("late", "truncated", "bad-checksum", "foreign", "noise"), "rtu"),
}
"""The link on which `make test` tries a fault; it is CAN for all others."""


def _marks(name: str) -> list[pytest.MarkDecorator]:
    fault, _, link = name.rpartition("-")
    return [] if link == ON_MODBUS.get(fault, "can") else [pytest.mark.proof]


def wire_for(name: str, tmp_path: Path) -> Wire:
    link, cell = name.rpartition("-")[2], CELLS[name]
    stale_s = {} if cell.cause == "stale" else {"stale_s": PATIENT_s}
    if link != "can":
        return modbus_wire(link, **{f"interlocks__{key}": str(one) for key, one in stale_s.items()})
    text = motor_text(**stale_s)
    if cell.floats:
        text = text.replace('"adaptdrive.dbc"', f'"{float_dbc(tmp_path)}"')
    return CanWire(text)


@pytest.mark.usefixtures("memory")
@pytest.mark.parametrize("name", [pytest.param(name, marks=_marks(name)) for name in CELLS])
async def test_a_fault_of_the_wire(name: str, tmp_path: Path) -> None:
    cell = CELLS[name]
    async with strung(wire_for(name, tmp_path)) as wire, rigged(wire.configuration) as rig:
        await run_steadily(wire, rig)
        began_s = asyncio.get_running_loop().time()
        made = cell.inject(wire, rig)
        if inspect.isawaitable(made):
            await made
        if cell.trips:
            reaction_s = await tripped(cell, wire, rig) - began_s
            note(name, reaction_s, await back(wire, rig))
        else:
            await goes_on(cell, wire, rig)
    assert_honest(rig)


async def run_steadily(wire: Wire, rig: Rig) -> None:
    """Run for some polls without a trip."""
    await rig.run()
    rig.events.clear()
    await until(lambda: wire.told[1])
    await asyncio.sleep(_RUNNING_s)
    assert rig.heard("trip") == []


async def tripped(cell: Cell, wire: Wire, rig: Rig) -> float:
    """Wait until the drive is safe, or cannot be told; when that was."""
    if cell.count:
        await until(lambda: getattr(rig.port.statistics, cell.count) >= 1)
    await rig.reaches(State.TRIPPED)
    when_s = next(when for when, event in rig.events if event.kind == "trip")
    (told,) = rig.heard("trip")
    assert told.startswith(f"{cell.cause}: "), told
    if cell.hears:
        await until(lambda: not wire.told[1])
        when_s = wire.told[0]
    if cell.words:
        await until(lambda: any(cell.words in detail for detail in rig.heard("bus")))
    return when_s


async def back(wire: Wire, rig: Rig) -> float:
    """Heal the wire and run again; the time until a reset was accepted."""
    healed_s = asyncio.get_running_loop().time()
    await wire.heal()
    await rig.recovers()
    recovered_s = asyncio.get_running_loop().time()
    await run_steadily(wire, rig)
    return recovered_s - healed_s


async def goes_on(cell: Cell, wire: Wire, rig: Rig) -> None:
    """The fault is counted, commands keep coming, and nothing trips."""
    until_s = asyncio.get_running_loop().time() + _WATCHED_s
    while asyncio.get_running_loop().time() < until_s:
        before_s = wire.told[0]
        await until(lambda before_s=before_s: wire.told[0] > before_s)  # type: ignore[misc]
    assert rig.heard("trip") == []
    assert wire.told[1]
    if cell.count:
        await until(lambda: getattr(rig.port.statistics, cell.count) >= 3)
    else:
        assert rig.drive is not None
        assert rig.drive.held >= 3


def assert_honest(rig: Rig) -> None:
    """Every tick was computed from what the drive sent in a good frame."""
    assert rig.used
    for boost_V, output in rig.used:
        assert min(abs(boost_V - BOOST_V), abs(boost_V - STUCK_V)) < 1e-6
        assert output == pytest.approx(OUTPUT_V, abs=1e-6)


def note(name: str, reaction_s: float, back_s: float) -> None:
    """Keep the times where a run for the documentation wants them."""
    report = os.environ.get("WIRE_REPORT")
    if report:
        path = Path(report)
        found = json.loads(path.read_text()) if path.exists() else {}
        found[name] = {"reaction_ms": 1e3 * reaction_s, "back_ms": 1e3 * back_s}
        path.write_text(json.dumps(found, indent=1))


def test_the_page_lists_these_faults_and_no_others() -> None:
    assert without_times(section(PAGE.read_text(encoding="utf-8"))) == without_times(table({}))
