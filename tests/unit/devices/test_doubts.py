"""Doubts about a drive, in exact times: another master, a lost bus, and a stop not obeyed."""

from __future__ import annotations

import math

from adaptdrive.safety.monitor import LEAPT, LOST, OtherSender, Relink
from adaptdrive.safety.stop import Obedience


def test_another_master_is_remembered_for_five_seconds() -> None:
    now_s = [100.0]
    other = OtherSender(lambda: now_s[0])
    assert other.trip_cause is None
    other.note("0x200 Command")
    now_s[0] = 104.9
    assert "1 x frame 0x200 Command, the last 4.9 s ago" in str(other.trip_cause)
    other.note("0x200 Command")
    now_s[0] = 109.9
    assert "2 x frame" in str(other.trip_cause)
    now_s[0] = 110.0
    assert other.trip_cause is None


def test_a_drive_that_stopped_unheard_waits_for_the_safe_command() -> None:
    relink = Relink()
    relink.note_command(bridge=True, safe=False)
    relink.note_reading(bridge=True)
    relink.open(bridge=True)
    assert not relink.admits(bridge=True)  # until it has reported
    assert relink.admits(bridge=False)
    relink.note_reading(bridge=False)
    assert "drive stopped" in str(relink.trip_cause)
    assert not relink.admits(bridge=True)
    relink.note_command(bridge=False, safe=True)
    assert relink.trip_cause is None
    assert relink.admits(bridge=True)


class Watched:
    """A drive that has two seconds for the safe command."""

    def __init__(self) -> None:
        self.now_s = 64.0
        self.obedience = Obedience(2.0, lambda: self.now_s)

    def overdue_s(self, after_s: float, *, powered: bool = True) -> float:
        self.now_s += after_s
        return self.obedience.overdue_s(powered=powered)


def test_a_drive_that_stays_on_does_not_obey_after_its_time_from_the_first_command() -> None:
    watched = Watched()
    watched.obedience.note_safe()
    assert watched.overdue_s(1.5) == -0.5
    watched.obedience.note_safe()
    assert watched.overdue_s(1.0) == 0.5
    assert watched.obedience.since_s == 64.0


def test_its_time_begins_anew_after_another_command() -> None:
    watched = Watched()
    watched.obedience.note_safe()
    watched.overdue_s(10.0)
    watched.obedience.forget()
    assert watched.obedience.since_s == math.inf
    watched.obedience.note_safe()
    assert watched.overdue_s(1.5) == -0.5


def test_a_counter_that_leaps_after_a_lost_bus_leaves_the_loss_as_the_cause() -> None:
    relink = Relink()
    relink.note_command(bridge=True, safe=False)
    relink.note_reading(bridge=True)
    relink.open(bridge=True)
    relink.open(bridge=True, how=LEAPT)
    relink.note_reading(bridge=False)
    assert LOST in str(relink.trip_cause)
