"""The warning of a machine on which a daemon has too little time."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import pytest

from adaptdrive.app import tick_cost
from adaptdrive.app.tick_cost import shortage
from adaptdrive.config import load_configuration
from tests.unit.cli.here import run_here

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"
TICKS = 50
"""Of a round."""

DAEMON_TICKS = {100.0, 230.0}
"""Processor time of a daemon in a half cycle, in ticks: of the sources, and compiled."""


def warnings(example: str, tick_s: float) -> list[str]:
    """The warnings of a machine on which a tick takes so long."""
    configuration = load_configuration(EXAMPLES / f"{example}.toml")
    times = itertools.count(0.0, TICKS * tick_s)
    return [str(one) for one in shortage(configuration, lambda: next(times))]


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.toml")), ids=lambda path: path.stem)
def test_each_kind_of_drive_and_load_can_be_measured(path: Path) -> None:
    assert len(list(shortage(load_configuration(path)))) <= 1


@pytest.mark.parametrize(("example", "cycle_s"), [("motor", 1 / 120), ("motor-modbus-tcp", 0.1)])
def test_less_than_a_factor_of_three_is_warned_of(example: str, cycle_s: float) -> None:
    limits_s = sorted(cycle_s / 3.0 / ticks for ticks in DAEMON_TICKS)
    assert not warnings(example, 0.99 * limits_s[0])
    (text,) = warnings(example, 1.01 * limits_s[1])
    assert text.startswith("drive: a daemon takes about ")
    assert f" ms of each {1e3 * cycle_s:.3g} ms on this machine" in text


def test_check_warns_also_for_programs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tick_cost, "_LARGEST_SHARE", 1e-9)  # as if every machine were too slow
    example = str(EXAMPLES / "motor.toml")
    assert "warning: drive: a daemon takes about" in run_here("check", example).stderr
    warned = json.loads(run_here("check", "--json", example).stdout)["warnings"]
    assert [text.partition(" about")[0] for text in warned] == ["drive: a daemon takes"]
