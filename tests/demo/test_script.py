"""What is played when."""

from __future__ import annotations

from itertools import islice, pairwise

import pytest

from adaptdrive_sim.demo.script import acts
from adaptdrive_sim.demo.settings import ModeChoice


def test_both_controllers_meet_every_load() -> None:
    met, disks, mode = set(), 1, "fixed"
    last_half = -1
    for act in islice(acts("alternate", disks=True), 15):
        if act.half > last_half:
            met.add((mode, disks))
        disks, mode, last_half = act.disks, act.mode or mode, act.half
    assert met >= {(m, d) for m in ("fixed", "adaptive") for d in (1, 2, 3)}


def test_acts_come_in_order_for_ever() -> None:
    many = list(islice(acts("alternate", disks=True), 100))
    assert all(one.half < next_one.half for one, next_one in pairwise(many))


@pytest.mark.parametrize("mode", ["fixed", "adaptive"])
def test_a_chosen_mode_is_left_alone(mode: ModeChoice) -> None:
    assert all(act.mode is None for act in islice(acts(mode, disks=True), 30))


def test_without_disks_one_stays_on_the_shaft() -> None:
    assert {act.disks for act in islice(acts("alternate", disks=False), 30)} == {1}


def test_there_may_be_nothing_to_play() -> None:
    assert list(acts("fixed", disks=False)) == []
