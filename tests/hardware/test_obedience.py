"""When a drive that is still on does not obey the safe command, in exact times."""

from __future__ import annotations

import math

from adaptdrive.hardware.doubts import LEAPT, LOST, Obedience, Relink


class Watched:
    """A drive that has two seconds for the safe command."""

    def __init__(self) -> None:
        self.now_s = 64.0
        self.obedience = Obedience(2.0, lambda: self.now_s)

    def overdue_s(self, after_s: float, *, powered: bool = True) -> float:
        self.now_s += after_s
        return self.obedience.overdue_s(powered=powered)


def test_a_drive_that_was_never_stopped_obeys() -> None:
    watched = Watched()
    assert watched.overdue_s(1000.0) == -math.inf
    assert not watched.obedience.awaited


def test_a_drive_that_stays_on_does_not_obey_after_its_time_from_the_first_command() -> None:
    watched = Watched()
    watched.obedience.hear()
    assert watched.overdue_s(1.5) == -0.5
    watched.obedience.hear()
    assert watched.overdue_s(1.0) == 0.5
    assert watched.obedience.heard_s == 64.0


def test_a_drive_that_reports_itself_off_obeys() -> None:
    watched = Watched()
    watched.obedience.hear()
    assert watched.overdue_s(10.0, powered=False) == -math.inf


def test_its_time_begins_anew_after_another_command() -> None:
    watched = Watched()
    watched.obedience.hear()
    watched.overdue_s(10.0)
    watched.obedience.forget()
    assert watched.obedience.heard_s == math.inf
    watched.obedience.hear()
    assert watched.overdue_s(1.5) == -0.5


def test_a_counter_that_leaps_after_a_lost_bus_leaves_the_loss_as_the_cause() -> None:
    relink = Relink()
    relink.note(bridge=True, safe=False)
    relink.hear(bridge=True)
    relink.open(bridge=True)
    relink.open(bridge=True, how=LEAPT)
    relink.hear(bridge=False)
    assert LOST in str(relink.complaint)
