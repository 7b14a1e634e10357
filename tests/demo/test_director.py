"""The director leaves the drive to whoever else operates it."""

from __future__ import annotations

from itertools import islice

from adaptdrive.config.services import Mqtt
from adaptdrive.control.waveform import Shape, Waveform
from adaptdrive_sim.demo.director import Director
from adaptdrive_sim.demo.script import acts
from adaptdrive_sim.demo.settings import DemoSettings
from tests.demo.stories import state, steady_record

NOBODY = Mqtt(port=1)
"""A broker that is not there: who asks it for something does not get to the caption."""


async def test_somebody_elses_wave_ends_the_play() -> None:
    record = steady_record(10)
    record.hear_state(state(waveform=Waveform(Shape.SINE, 2.0, 3.0, 90.0)))
    director = Director(DemoSettings(), NOBODY, record)
    for act in islice(acts("alternate", disks=True), 4):
        await director._perform(act)
    assert "Another client" in record.caption
    assert record.truth is not None
    assert record.truth.disks == 2


async def test_a_drive_that_is_not_running_is_left_alone() -> None:
    record = steady_record(10)
    record.hear_state(state(state="tripped", trip="stale"))
    director = Director(DemoSettings(), NOBODY, record)
    await director._perform(next(iter(acts("alternate", disks=True))))
    assert "Another client" in record.caption
