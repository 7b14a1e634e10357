"""No sequence of commands, faults, delays, restarts, thaws energises a drive that must be off."""

from __future__ import annotations

import math
import os

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis.stateful import run_state_machine_as_test

from adaptdrive.safety.interlocks import InterlockBoard
from adaptdrive.safety.monitor import Monitor
from adaptdrive.safety.timing import Timing
from tests.integration.faults.story import HastyDriveStory, PatientStory, SlowDriveStory, Story

STORIES = int(os.environ.get("STORIES", "8"))
QUICK = settings(
    max_examples=STORIES,
    stateful_step_count=25,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)
UNSHRUNK = settings(
    QUICK,
    max_examples=3000,
    derandomize=True,
    database=None,
    print_blob=False,
    report_multiple_bugs=False,
    phases=[Phase.generate],
)

TestStory = Story.TestCase
TestStory.settings = QUICK

TestPatientStory = PatientStory.TestCase
TestPatientStory.settings = QUICK

TestHastyDriveStory = HastyDriveStory.TestCase
TestHastyDriveStory.settings = QUICK

TestSlowDriveStory = SlowDriveStory.TestCase
TestSlowDriveStory.settings = QUICK


def _no_cause(*_: object, **__: object) -> None:
    return None


@pytest.mark.parametrize(
    ("story", "owner", "name"),
    [
        (Story, InterlockBoard, "standing_cause"),
        pytest.param(Story, InterlockBoard, "gap_cause", marks=pytest.mark.proof),
        (PatientStory, Monitor, "look"),
        (PatientStory, Monitor, "_note_passed"),
    ],
    ids=["interlocks", "freezes", "own-stop", "silence"],
)
def test_a_daemon_without_one_protection_is_found_out(
    story: type[Story], owner: type, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(owner, name, _no_cause)
    with pytest.raises(AssertionError, match=r"although|without a reset"):
        run_state_machine_as_test(story, settings=UNSHRUNK)


@pytest.mark.proof
def test_a_daemon_that_does_not_know_a_short_time_out_is_found_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Timing, "certain_s", math.inf)
    with pytest.raises(AssertionError, match="stopped unheard"):
        run_state_machine_as_test(HastyDriveStory, settings=UNSHRUNK)


@pytest.mark.parametrize(("kind", "ticks"), [(PatientStory, 20), (HastyDriveStory, 8)])
def test_a_command_that_was_frozen_for_longer_than_the_time_out_waits_for_a_report(
    kind: type[PatientStory], ticks: int
) -> None:
    story = kind()
    story.wake_up(readings=62)
    story.bring_up()
    story.freeze_within_a_tick(ticks=ticks)
    story.it_has_not_died()
