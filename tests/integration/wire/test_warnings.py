"""Warnings of a drive with the whole daemon behind its bus: told, never a trip."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable

import pytest

from adaptdrive.runtime.reports import Severity, State
from tests.integration.wire.rig import Rig, rigged, until
from tests.integration.wire.wires import CanWire, PATIENT_s, motor_text, strung

Drive = tuple[Rig, Callable[[int], None], str]
"""The daemon, what sets the drive's word, and the name of the signal of it."""

_NAMES = "{ 4 = 'derating', 5 = 'fan' }"


@pytest.fixture
async def drive(memory: None) -> AsyncIterator[Drive]:
    """A drive on CAN that holds its voltage; `test_fault_words.py` has the words of each bus."""
    words = "{ signal = 'DriveStatus.Fault', mask = 0x0F }\n"
    words += f"warning = {{ signal = 'DriveStatus.Fault', mask = 0x70, names = {_NAMES} }}\n"
    text = motor_text(stale_s=PATIENT_s).replace('where = "daemon"', 'where = "drive"')
    wire = CanWire(text.replace('fault = "DriveStatus.Fault"', f"fault = {words}"))

    def show(word: int) -> None:
        wire.values["Fault"] = word

    async with strung(wire), rigged(wire.configuration) as rig:
        yield rig, show, "Fault"


async def test_a_warning_is_told_once_for_each_change_and_trips_nothing(drive: Drive) -> None:
    rig, show, signal = drive
    await rig.run()
    rig.events.clear()
    told: list[str] = []
    for word, words in (
        (0x10, f"drive warning: {signal} bit 4 derating"),
        (0x30, f"drive warning: {signal} bit 4 derating, bit 5 fan"),
        (0x00, f"drive warning: none any more; the last was {signal} bit 4 derating, bit 5 fan"),
    ):
        show(word)
        told.append(words)
        await until(lambda: rig.heard("warning") == told)
    severities = [one.severity for _, one in rig.events if one.kind == "warning"]
    assert severities == [Severity.WARNING, Severity.WARNING, Severity.INFO]
    await asyncio.sleep(0.2)
    assert rig.heard("warning") == told
    assert rig.heard("trip") == []
    assert rig.state is not None
    assert rig.state.state is State.RUNNING


async def test_a_drive_that_warns_is_enabled_and_its_fault_trips(drive: Drive) -> None:
    rig, show, signal = drive
    show(0x10)
    await until(lambda: rig.heard("warning"))
    await rig.run()
    began_s = asyncio.get_running_loop().time()
    show(0x14)
    await until(lambda: rig.heard("trip", began_s))
    assert rig.heard("trip", began_s)[0].startswith(f"drive fault: {signal} bit 2")


async def test_a_warning_that_comes_and_goes_is_told_once_in_a_second(drive: Drive) -> None:
    rig, show, _ = drive
    await rig.run()
    rig.events.clear()
    end_s = asyncio.get_running_loop().time() + 2.5
    while asyncio.get_running_loop().time() < end_s:
        show(0x10)
        await asyncio.sleep(0.06)
        show(0x00)
        await asyncio.sleep(0.06)
    assert 1 <= len(rig.heard("warning")) <= 4
    await until(lambda: "none any more" in rig.heard("warning")[-1])
