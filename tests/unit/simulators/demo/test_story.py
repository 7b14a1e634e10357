"""The stories that come along: their data, their view, and how they end."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from rich.console import Console

from adaptdrive.util.errors import RefusedError
from adaptdrive_sim.demo.main import KEYS, run_demo, show, summarise
from adaptdrive_sim.demo.player import Player
from adaptdrive_sim.demo.stage import Stage
from adaptdrive_sim.demo.story import Story, read_story, story_names

STORIES = [read_story(name) for name in story_names()]
BY_NAME = pytest.mark.parametrize("story", STORIES, ids=lambda one: one.name)


def staged(story: Story, duration_s: float | None = None) -> tuple[Stage, Player]:
    """A story as fast as it goes."""
    stage = Stage(story, speed=1e6)
    return stage, Player(stage, duration_s)


def played(name: str, duration_s: float | None = None) -> tuple[Stage, dict[str, Any]]:
    stage, player = staged(read_story(name), duration_s)
    asyncio.run(player.run())
    return stage, summarise(player, "")


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
        assert stage.record.state["enabled"] is True
        assert stage.record.trips == []


@BY_NAME
@pytest.mark.parametrize("size", [(80, 24), (160, 48)])
def test_the_view_fills_the_terminal_and_cuts_nothing(story: Story, size: tuple[int, int]) -> None:
    _, player = staged(story, 30.0)
    asyncio.run(player.run())
    text = "\n".join(lines := shown(player, size))
    assert len(lines) == size[1]
    assert max(map(len, lines)) <= size[0]
    cut = [line for line in lines if "…" in line and not line.startswith(" ")]
    assert not [line for line in cut if "…4" not in line and "…1" not in line], text
    assert f"0:30 of 0:30 · scene {player.number + 1} of {len(story.scenes)}" in text
    assert player.say in text
    assert "truth" in text
    for key in set(KEYS) - {"d disk"}:
        assert key in text
    player.takes("?")
    assert "1e+06 times real time" in "\n".join(shown(player, size))


def shown(player: Player, size: tuple[int, int]) -> list[str]:
    console = Console(width=size[0], height=size[1], force_terminal=True, color_system=None)
    with console.capture() as capture:
        console.print(show(player, size))
    return capture.get().splitlines()


def test_braking_returns_the_energy_that_the_motor_gives() -> None:
    story = read_story("braking")
    stage, player = staged(story, 100.0)
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
    assert stage.record.events[-1]["kind"] == "complete"


@pytest.mark.slow
def test_the_adaptive_motor_overshoots_less_than_the_fixed_one() -> None:
    _, summary = played("motor")
    assert summary["ok"], summary
    fixed, adaptive = (summary["overshoot"][name] for name in ("fixed", "adaptive"))
    assert fixed["1 disk"] < 0.02
    assert 0.05 < fixed["2 disks"] < fixed["3 disks"]
    assert all(adaptive[name] < fixed[name] for name in ("2 disks", "3 disks"))
    assert summary["truth"]["tau_sum_s"] == pytest.approx(21.7)


@pytest.mark.proof
def test_the_adaptive_bath_overshoots_less_than_the_fixed_one() -> None:
    _, summary = played("bath")
    assert summary["ok"], summary
    fixed, adaptive = (summary["overshoot"][name] for name in ("fixed", "adaptive"))
    assert fixed["1.5 gal"] > 0.05
    assert max(adaptive.values()) < 0.02


@pytest.mark.parametrize(
    ("name", "duration_s", "speed", "flaw"),
    [
        ("motor", None, 0.0, "--speed 0"),
        ("motor", None, 2e6, r"--speed 2e\+06"),
        ("motor", 0.0, None, "--duration 0"),
        ("kettle", None, None, "'kettle' is no story; there are bath, battery, braking, motor"),
    ],
)
def test_what_cannot_be_done_is_refused(
    name: str, duration_s: float | None, speed: float | None, flaw: str
) -> None:
    with pytest.raises(RefusedError, match=flaw):
        run_demo(name, duration_s, headless=True, speed=speed)
