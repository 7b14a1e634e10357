"""A run that follows a trip begins as any other one."""

from __future__ import annotations

from adaptdrive.control.signals import Shape, Waveform
from adaptdrive.runtime.requests import Enable, Reset, SetWaveform
from tests.support import a_trip
from tests.unit.runtime.test_machine import Desk


def test_enabling_after_a_trip_forgets_the_waveform() -> None:
    desk = Desk()
    desk.ask(Enable())
    desk.pass_ticks(2)
    desk.ask(SetWaveform(Waveform(Shape.SQUARE, 3.0, 3.2, 60.0)))
    desk.machine.latch(a_trip("drive fault: word 0x1"))
    desk.ask(Reset())
    desk.machine.confirm_stop()
    desk.ask(Enable(), output=1.25)
    assert desk.machine.asked.waveform is None
    assert desk.machine.reference(desk.tick + 5000) == 1.25
