"""The record of a session in which everything happened, and the controller run again on it."""

from __future__ import annotations

import itertools
import statistics
import subprocess
import time
from typing import Any

import pytest

from adaptdrive.recording.reader import Session
from adaptdrive.recording.session import Ending
from tests.scenes.system.conftest import MakeSite
from tests.scenes.system.site import Site, until

pytestmark = [pytest.mark.slow, pytest.mark.proof]

Q, LATENCY = 120, 2
EAGER = {
    "supervisor.warm_up_s": "2.0",
    "estimator.settle_s": "0.0",
    "interlocks.stale_s": "0.5",
    "recording.flush_s": "0.5",
}
WAVE = {"shape": "triangle", "low": 2.9, "high": 3.2, "period_s": 6.0}


@pytest.fixture(scope="module")
def eventful_site(make_shared_site: MakeSite) -> Site:
    """A site whose daemon has been through it all, and has ended."""
    site = make_shared_site(EAGER)
    site.start("--initial-voltage", "280", "--noise", "0.0004")
    site.run_drive()
    site.demand("waveform", WAVE)
    site.let_periods_pass(2)
    site.demand("mode", "adaptive")
    site.let_periods_pass(3)
    _drop_frames(site)
    _lose_the_broker(site)
    _trip_and_reset(site)
    _set_the_voltage_by_hand(site)
    site.demand("mode", "fixed")
    site.let_periods_pass(2)
    assert site.stop_daemon() == 0
    return site


def _drop_frames(site: Site) -> None:
    for duration_s in (0.03, 0.03, 0.2):
        with site.stalled(site.device):
            time.sleep(duration_s)
        time.sleep(0.2)
    site.await_state(state="running")


def _lose_the_broker(site: Site) -> None:
    site.kill(site.broker)
    time.sleep(0.5)
    site.start_broker()
    site.await_availability("online")
    site.let_periods_pass(1)


def _trip_and_reset(site: Site) -> None:
    site.disturb("fault", "1")
    site.await_state(state="tripped")
    site.disturb("fault", "0")
    until(lambda: site.ask("reset")["accepted"], "the reset is accepted")
    site.run_drive()
    site.demand("setpoint", 3.1)
    site.let_periods_pass(2)


def _set_the_voltage_by_hand(site: Site) -> None:
    site.demand("mode", "manual")
    site.demand("voltage", 285.0)
    site.let_periods_pass(2)


@pytest.fixture(scope="module")
def session(eventful_site: Site) -> Session:
    return eventful_site.session()


@pytest.fixture(scope="module")
def ticks(session: Session) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = session.ticks.to_pylist()
    return rows


@pytest.fixture(scope="module")
def replayed(eventful_site: Site) -> subprocess.CompletedProcess[str]:
    return eventful_site.replay()


def test_the_session_is_whole(session: Session, ticks: list[dict[str, Any]]) -> None:
    assert session.info.ended is Ending.ORDERLY
    assert (session.info.dropped.ticks, session.info.dropped.slow) == (0, 0)
    assert [row["sequence"] for row in ticks] == list(range(len(ticks)))
    assert all(a["tick"] < b["tick"] for a, b in itertools.pairwise(ticks))


def test_the_session_holds_what_happened(session: Session, ticks: list[dict[str, Any]]) -> None:
    kinds = {event.kind for event in session.events}
    assert {"state", "mode", "trip"} <= kinds
    assert {row["mode"] for row in ticks} == {"fixed", "adaptive", "manual"}
    stages = [stage for stage, _ in itertools.groupby(row["stage"] for row in ticks)]
    assert stages == ["off", "precharge", "run"] * 2 + ["off"]
    held = [row for row in ticks if not row["fresh"]]
    assert len(held) >= 20
    states = [event.detail for event in session.events if event.kind == "state"]
    assert states[-1] == "stopping to standby"


def test_each_slow_period_has_its_120_ticks(session: Session, ticks: list[dict[str, Any]]) -> None:
    slow = session.slow.select(["k", "tick"]).to_pylist()
    assert len(slow) >= 10
    assert all(row["tick"] >= row["k"] * Q for row in slow)
    counts = [
        sum(earlier["tick"] < row["tick"] <= later["tick"] for row in ticks)
        for earlier, later in itertools.pairwise(slow)
        if later["k"] == earlier["k"] + 1
    ]
    # Half cycles that an overloaded machine missed were never run; all that were run are here.
    assert max(counts) == Q
    assert statistics.median(counts) >= 0.75 * Q


def test_decisions_take_effect_at_their_fixed_tick(ticks: list[dict[str, Any]]) -> None:
    delays = [row["tick"] - Q * row["applied_k"] for row in ticks if row["applied_k"] >= 0]
    assert len(delays) >= 10
    assert min(delays) == LATENCY
    assert statistics.median(delays) == LATENCY


def test_without_a_run_only_safe_commands_are_recorded(ticks: list[dict[str, Any]]) -> None:
    off = [row for row in ticks if row["stage"] == "off"]
    assert {(row["current_scale_S"], row["bridge"]) for row in off} == {(0.0, False)}
    assert not any(row["bridge"] for row in ticks if row["stage"] != "run")


def test_replay_gives_bit_equal_commands(
    replayed: subprocess.CompletedProcess[str], ticks: list[dict[str, Any]], session: Session
) -> None:
    assert replayed.returncode == 0, replayed.stdout + replayed.stderr
    lines = replayed.stdout.splitlines()
    slow_steps = session.slow.num_rows
    assert lines[0].endswith(f"replayed {len(ticks)} ticks and {slow_steps} slow steps")
    assert lines[1:] == ["every command is bit-equal"]
