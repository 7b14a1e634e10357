"""The stories that come along: their data, their view, and how they end."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from adaptdrive.util.errors import RefusedError
from adaptdrive_sim.demo import DemoSettings
from adaptdrive_sim.demo.main import KEYS, DemoView, summarise
from adaptdrive_sim.demo.player import Player
from adaptdrive_sim.demo.stages import VirtualStage
from adaptdrive_sim.demo.story import DemoRecord, Story, read_story, story_names

STORIES = [read_story(name) for name in story_names()]
BY_NAME = pytest.mark.parametrize("story", STORIES, ids=lambda one: one.name)


def staged(story: Story, duration_s: float | None = None) -> tuple[VirtualStage, Player]:
    """A story in virtual time, as fast as it goes."""
    stage = VirtualStage(story, DemoSettings(speed=1e6))
    record = DemoRecord(stage.drive_name, lambda: 0.0, story=story)
    stage.services(record)
    return stage, Player(story, stage, record, duration_s)


def played(name: str, duration_s: float | None = None) -> tuple[VirtualStage, dict[str, Any]]:
    stage, player = staged(read_story(name), duration_s)
    asyncio.run(player.run())
    assert stage.record is not None
    return stage, summarise(stage.record, player, "")


@BY_NAME
def test_the_scenes_of_a_story_come_one_after_the_other(story: Story) -> None:
    times = [scene.at_s for scene in story.scenes]
    assert times[0] == 0.0
    assert times == sorted(set(times))
    assert times[-1] < story.duration_s
    assert story.scenes[0].mode is not None
    assert all(len(scene.say) < 80 for scene in story.scenes)


@BY_NAME
def test_a_story_does_nothing_that_its_drive_refuses(story: Story) -> None:
    """Each scene is brought about by itself, as after a trip in it."""
    for number in range(len(story.scenes)):
        stage, player = staged(story)
        player.number = number
        asyncio.run(player._prepare())
        assert stage.record is not None
        assert stage.record.state["enabled"] is True
        assert stage.record.trips == []


@BY_NAME
@pytest.mark.parametrize("size", [(80, 24), (160, 48)])
def test_the_view_fills_the_terminal_and_cuts_nothing(story: Story, size: tuple[int, int]) -> None:
    stage, player = staged(story, 30.0)
    asyncio.run(player.run())
    assert stage.record is not None
    stage.places = {"folder": "/tmp/demo"}
    view = DemoView(stage.record, player, stage)
    text = "\n".join(lines := shown(view, size))
    assert len(lines) == size[1]
    assert max(map(len, lines)) <= size[0]
    cut = [line for line in lines if "…" in line and not line.startswith(" ")]
    assert not [line for line in cut if "…4" not in line and "…1" not in line], text
    assert f"0:30 of 0:30 · scene {player.number + 1} of {len(story.scenes)}" in text
    assert player.say in text
    assert "truth" in text
    for key in set(KEYS) - {"d disk"}:
        assert key in text
    view.help = True
    assert "/tmp/demo" in "\n".join(shown(view, size))


def shown(view: DemoView, size: tuple[int, int]) -> list[str]:
    console = Console(width=size[0], height=size[1], force_terminal=True, color_system=None)
    with console.capture() as capture:
        console.print(view.screen(size))
    return capture.get().splitlines()


def test_braking_returns_the_energy_that_the_motor_gives() -> None:
    story = read_story("braking")
    stage, player = staged(story, 100.0)
    assert stage.record is not None
    taken_J, tick = [0.0], stage.drive.tick

    def count() -> bool:
        taken_J[0] += max(0.0, -stage.drive.world.boost.mean_load_W) / 120.0
        return tick()

    stage.drive.tick = count  # type: ignore[method-assign]
    asyncio.run(player.run())
    returned_J = stage.record.values["returned"]
    # The capacitor itself gives 0.5 C (400² - 200²) V² = 60 J of what the line gets.
    assert 0.8 * taken_J[0] < returned_J < taken_J[0] + 60.0 + 20.0
    assert returned_J > 100.0


@pytest.mark.proof
def test_the_battery_is_complete_in_the_end() -> None:
    stage, summary = played("battery")
    assert summary["ok"], summary
    assert summary["complete"] is True
    assert summary["state"] == "standby"
    assert summary["values"]["highest voltage"] < 1.005 * 82.0
    assert stage.record is not None
    assert stage.record.events[-1]["kind"] == "complete"


@pytest.mark.proof
def test_the_adaptive_bath_overshoots_less_than_the_fixed_one() -> None:
    _, summary = played("bath")
    assert summary["ok"], summary
    fixed, adaptive = (summary["overshoot"][name] for name in ("fixed", "adaptive"))
    assert fixed["1.5 gal"] > 0.05
    assert max(adaptive.values()) < 0.02


@pytest.mark.parametrize(
    "settings",
    [
        DemoSettings(speed=0.0),
        DemoSettings(duration_s=0.0),
        DemoSettings(noise=2.0),
        DemoSettings(directory=Path("demo")),
    ],
)
def test_a_story_in_virtual_time_refuses_what_cannot_be_done(settings: DemoSettings) -> None:
    with pytest.raises(RefusedError, match="--"):
        settings.check(virtual=True)
