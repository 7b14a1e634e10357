"""Stories that are disturbed on their way, played with the daemon's controller in virtual time."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import msgspec
import pytest

from adaptdrive.runtime.requests import Disable
from adaptdrive.safety.trips import Trip, TripKind
from adaptdrive_sim.demo.player import DemoError, Player
from adaptdrive_sim.demo.stage import Stage
from adaptdrive_sim.demo.story import read_story
from tests.support import sample

PERIOD_S = 120.0
"""Period of the wave in the story of the brake: it steps up first, and down after a half."""

WAVE = {"shape": "square", "low": 2.6, "high": 4.2, "period_s": PERIOD_S}


class Theatre(Stage):
    """A stage that looks at the story after each step, and may do something."""

    def __init__(self, duration_s: float) -> None:
        story = read_story("braking")
        quiet = msgspec.structs.replace(story, duration_s=duration_s, noise=0.0)
        super().__init__(quiet, speed=1e6)
        self.said: list[str] = []
        self.looks: list[Callable[[Player], None]] = [self._listen]
        self.player = Player(self, None)

    async def wait(self, longest_s: float) -> None:
        await super().wait(min(longest_s, 1.0))
        for look in self.looks:
            look(self.player)

    def _listen(self, player: Player) -> None:
        if not self.said or self.said[-1] != player.say:
            self.said.append(player.say)

    def once(self, at_s: float, do: Callable[[Player], None]) -> None:
        """Do something at a time of the drive."""

        def look(player: Player) -> None:
            if self.time_s >= at_s:
                self.looks.remove(look)
                do(player)

        self.looks.append(look)

    def latch(self, _: Player) -> None:
        self.drive.machine.latch(
            Trip(TripKind.OVER_VOLTAGE, "over-voltage: v_bst = 431 V, limit 430 V")
        )


async def test_a_story_plays_its_scenes_and_ends() -> None:
    theatre = Theatre(70.0)
    await theatre.player.run()
    assert theatre.said[-2:] == [scene.say for scene in theatre.story.scenes]
    assert theatre.player.at_s == pytest.approx(70.0, abs=0.1)
    assert theatre.player.position.startswith("1:10 of 1:10 · scene 2 of 2")
    assert theatre.record.trips == []


async def test_the_key_of_the_disks_always_changes_their_number() -> None:
    theatre = Theatre(70.0)
    seen = [theatre.record.truth["disks"]]
    for _ in range(6):
        command = theatre.player.dropped()
        assert command is not None
        assert (await theatre.ask(command)).accepted
        theatre.report()  # publishes the truth
        seen.append(theatre.record.truth["disks"])
    assert all(one != other for one, other in pairwise(seen))


async def test_after_a_trip_everything_is_brought_back_and_the_scene_begins_again() -> None:
    theatre = Theatre(200.0)
    theatre.once(100.0, theatre.latch)
    await theatre.player.run()
    record = theatre.record
    assert len(record.trips) == 1
    assert "The drive tripped (over-voltage)" in "".join(theatre.said)
    assert record.state["state"] == "running"
    assert record.state["mode"] == "adaptive"
    assert record.state["waveform"] == WAVE
    assert record.trip == ""
    second = theatre.story.scenes[1]
    assert theatre.said[-1] == second.say
    assert theatre.player.at_s == pytest.approx(200.0, abs=0.1)
    # it was in the scene that begins at 60 s, and played it anew
    assert theatre.time_s > 100.0 + 200.0 - second.at_s


async def test_a_drive_that_cannot_be_reset_ends_the_story_with_its_reason() -> None:
    theatre = Theatre(400.0)
    theatre.once(50.0, lambda _: theatre.looks.append(theatre.latch))
    with pytest.raises(DemoError):
        await theatre.player.run()


async def test_whoever_stops_the_drive_has_it_until_the_viewer_goes_on() -> None:
    theatre = Theatre(100.0)
    held: list[float] = []

    def stop(_: Player) -> None:
        theatre.drive.carry_out(Disable())
        theatre.once(theatre.time_s + 30.0, look)

    def look(player: Player) -> None:
        assert player.paused
        assert "The drive was stopped." in player.say
        assert not theatre.record.running
        held.append(player.at_s)
        player.toggle()

    theatre.once(40.0, stop)
    await theatre.player.run()
    assert held[0] < 45.0
    assert theatre.record.running
    assert theatre.record.state["waveform"] == WAVE


@pytest.mark.parametrize("pause_s", sample([50.0, 7.0, 130.0], 1))
async def test_after_a_pause_the_steps_come_in_the_story_when_they_should(pause_s: float) -> None:
    """The wave runs on; the clock of the story is set to where the wave stands."""
    theatre = Theatre(400.0)
    steps: list[float] = []
    before: list[float] = []

    def watch(player: Player) -> None:
        reference = theatre.drive.reference
        if before and reference != before[-1] and not player.paused:
            steps.append(player.at_s)
        before.append(reference)

    def pause(player: Player) -> None:
        player.toggle()
        theatre.once(theatre.time_s + pause_s, lambda again: again.toggle())
        theatre.once(theatre.time_s + pause_s, lambda _: theatre.looks.append(watch))

    theatre.once(150.0, pause)
    await theatre.player.run()
    assert len(steps) >= 3
    for at_s in steps:
        assert min(at_s % (PERIOD_S / 2), -at_s % (PERIOD_S / 2)) < 2.5
