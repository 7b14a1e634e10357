"""Demonstrations in virtual time: the stories, the view that suits each load, the command line."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Callable
from typing import Any, Literal

import pytest
from rich.console import Console

from adaptdrive.errors import RefusedError
from adaptdrive_sim.demo.braking_story import BrakingStory
from adaptdrive_sim.demo.settings import VirtualSettings
from adaptdrive_sim.demo.story import Story
from adaptdrive_sim.demo.subject import Subject
from adaptdrive_sim.demo.view import ViewContext, screen
from adaptdrive_sim.demo.virtual import (
    Teller,
    build_story,
    summarise,
)

Load = Literal["bath", "battery", "braking"]


def told(load: Load, duration_s: float, until: Callable[[Story], bool] | None = None) -> Story:
    """A story that has gone on for a while."""
    story = build_story(VirtualSettings(load))
    teller = Teller(story)
    while teller.time_s < duration_s and not (until and until(story)):
        teller.tick()
    return story


def shown(story: Story, size: tuple[int, int]) -> list[str]:
    subject = Subject(story.name, story.title, story.figures, ("virtual time",))
    around = ViewContext("", "", "", None, story.window_s, subject)
    console = Console(width=size[0], height=size[1], force_terminal=True, color_system=None)
    with console.capture() as capture:
        console.print(screen(story.play.record, around, size))
    return capture.get().splitlines()


@pytest.mark.parametrize("size", [(80, 24), (120, 40)])
def test_the_bath_is_shown_in_its_own_words(size: tuple[int, int]) -> None:
    lines = shown(told("bath", 200.0), size)
    text = "\n".join(lines)
    assert len(lines) == size[1]
    assert max(map(len, lines)) <= size[0]
    for expected in ("bath", "temperature", "RC in s", "0.60 gal", "1.5", "virtual time"):
        assert expected in text
    assert "disk" not in text


@pytest.mark.parametrize("size", [(80, 24), (120, 40)])
def test_the_battery_is_shown_in_its_own_words(size: tuple[int, int]) -> None:
    lines = shown(told("battery", 40.0), size)
    text = "\n".join(lines)
    assert len(lines) == size[1]
    assert max(map(len, lines)) <= size[0]
    for expected in ("battery", "CC", "82.00 V", "set-point", "12.00 A"):
        assert expected in text


@pytest.mark.slow
def test_the_battery_is_complete_in_the_end_and_says_so() -> None:
    story = told("battery", 6000.0, lambda story: story.ended())
    summary = summarise(story, 60.0)
    assert summary["ok"], summary
    assert summary["complete"] is True
    assert summary["state"] == "standby"
    assert summary["terminal_voltage_max_V"] < 1.005 * summary["voltage_limit_V"]
    assert [event.kind for event in story.play.record.events][-1] == "complete"
    assert "full" in story.play.record.caption


def test_braking_returns_the_energy_that_the_motor_gives() -> None:
    story = build_story(VirtualSettings("braking"))
    assert isinstance(story, BrakingStory)
    teller, taken_J, before_J = Teller(story), 0.0, math.nan
    while teller.time_s < 100.0:
        teller.tick()
        taken_J += max(0.0, -story.play.drive.world.boost.mean_load_W) / 120.0
        if teller.time_s < 59.0:
            before_J = story.returned_J
    assert before_J == 0.0
    summary = story.summary()
    assert summary["lowest_load_W"] < -50.0
    assert -0.05 <= summary["lowest_scale_S"] < 0.0
    # The capacitor itself gives 0.5 C (400² - 200²) V² = 60 J of what the line gets.
    assert 0.8 * taken_J < summary["returned_J"] < taken_J + 60.0 + 20.0


def run(*words: str) -> tuple[int, dict[str, Any], str]:
    command = [sys.executable, "-m", "adaptdrive_sim", "demo", *words, "--headless"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    lines = ended.stdout.splitlines()
    return ended.returncode, json.loads(lines[0]) if lines else {}, ended.stderr


@pytest.mark.parametrize("load", ["bath", "battery", "braking"])
def test_headless_it_prints_one_line_of_json(load: str) -> None:
    status, summary, problem = run(load, "--duration=120", "--speed=100000")
    assert status == 0, (summary, problem)
    assert summary["demo"] == load
    assert summary["ok"] is True
    assert summary["virtual_time"] is True
    assert summary["state"] == "running"
    assert summary["duration_s"] == pytest.approx(120.0, abs=11.0)
    assert summary["trips"] == []


@pytest.mark.parametrize(
    "settings",
    [
        VirtualSettings("bath", speed=0.0),
        VirtualSettings("bath", duration_s=0.0),
        VirtualSettings("battery", noise=2.0),
    ],
)
def test_refuses_what_cannot_be_done(settings: VirtualSettings) -> None:
    with pytest.raises(RefusedError, match="--"):
        settings.check()
