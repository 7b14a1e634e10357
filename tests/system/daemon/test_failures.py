"""What is left when a process vanishes: the drive safe, the daemon honest, and a way back."""

from __future__ import annotations

import itertools
import json
import os
import signal
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from adaptdrive.recording.reader import read_session
from adaptdrive.recording.session import Dropped, Ending
from tests.support import acting, sample
from tests.system.conftest import MakeSite
from tests.system.daemon.site import PATIENCE_S, BusEar, Site, publish, until


def test_a_killed_daemon_leaves_the_drive_safe_and_comes_back_in_standby(
    make_site: MakeSite,
) -> None:
    site = make_site()
    site.start("--initial-voltage", "280")
    site.demand("mode", "adaptive")
    site.run_drive()
    killed = site.session_folder()
    until(lambda: "run" in stages(killed), "the run is recorded")
    site.kill(site.daemon)
    for recorder in site.recorders():
        os.kill(recorder, signal.SIGKILL)
    (safe,) = until(lambda: site.device_events("safe"), "the drive's safe state")
    assert safe["reason"] == "command timeout"
    assert (safe["current_scale_S"], safe["bridge"], safe["load_current_A"]) == (0.0, False, 0.0)
    site.await_availability("offline")
    with BusEar(site.config) as bus:
        site.start_daemon()
        site.await_measurement()
        state = site.await_state(state="standby", mode="fixed", enabled=False)
        assert (state["trip"], state["waveform"]) == (None, None)
        known = len(bus.commands())
        until(lambda: len(bus.commands()) > known + 60, "half a second of commands")
        assert all(command.safe for command in bus.commands())
        site.run_drive()
        until(lambda: bus.commands()[-1].bridge, "the bridge is commanded on")
    until(lambda: read_session(killed).info.ended is Ending.CUT, "the session is closed")
    session = read_session(killed)
    assert session.ticks["sequence"].to_pylist() == list(range(session.ticks.num_rows))
    assert "run" in stages(killed)


def stages(folder: Path) -> list[str]:
    """What the drive did in each recorded tick."""
    found: list[str] = read_session(folder).ticks["stage"].to_pylist()
    return found


@pytest.mark.parametrize(
    "number",
    sample(
        [
            signal.SIGHUP,
            signal.SIGQUIT,
            signal.SIGINT,
            signal.SIGUSR1,
            signal.SIGXCPU,
            signal.SIGSTKFLT,
            signal.SIGRTMIN,
            signal.SIGRTMAX,
        ],
        1,
    ),
)
def test_each_signal_that_ends_leaves_the_bridge_off(
    make_site: MakeSite, number: signal.Signals
) -> None:
    site = make_site()
    with acting(number):
        site.start("--initial-voltage", "280")
    site.run_drive()
    ends_with_safe_commands(site, number)
    site.await_state(state="standby")


def ends_with_safe_commands(site: Site, number: signal.Signals) -> None:
    assert site.daemon is not None
    with BusEar(site.config) as bus:
        until(lambda: bus.commands() and bus.commands()[-1].bridge, "the bridge is commanded on")
        site.daemon.send_signal(number)
        assert site.daemon.wait(timeout=PATIENCE_S) == 0
        until(lambda: all(command.safe for command in bus.commands()[-3:]), "safe commands")


BLOCKED = (
    "import os, signal, sys;"
    "signal.pthread_sigmask(signal.SIG_BLOCK, {*range(1, 32)});"
    "signal.signal(signal.SIGCHLD, signal.SIG_IGN);"
    "os.execv(sys.argv[1], sys.argv[1:])"
)
"""A launcher that a careless supervisor resembles: its children inherit what it blocks."""


@pytest.mark.proof
def test_a_daemon_whose_starter_blocked_its_signals_ends_by_them(make_site: MakeSite) -> None:
    site = make_site()
    site.start_broker()
    site.start_device("--initial-voltage", "280")
    site.start_daemon(sys.executable, "-c", BLOCKED)
    site.await_measurement()
    site.run_drive()
    ends_with_safe_commands(site, signal.SIGTERM)
    assert "Unknown child process" not in site.daemon_log


def test_asked_to_end_the_daemon_says_goodbye(make_site: MakeSite) -> None:
    site = make_site()
    site.start("--initial-voltage", "280")
    site.run_drive()
    ends_with_safe_commands(site, signal.SIGTERM)
    site.await_availability("offline")
    site.await_state(state="standby")
    session = site.session()
    assert session.info.ended is Ending.ORDERLY
    assert session.info.dropped == Dropped()
    assert session.ticks["sequence"].to_pylist() == list(range(session.ticks.num_rows))
    assert "Traceback" not in site.daemon_log


@pytest.mark.proof
def test_what_the_daemon_says_at_its_end_is_in_the_session(make_site: MakeSite) -> None:
    site = make_site()
    site.start("--initial-voltage", "280")
    site.ask("setpoint", 3.1)
    numbers = itertools.count()
    with ThreadPoolExecutor(1) as aside:
        ending = aside.submit(site.stop_daemon)
        while not ending.done():
            payload = json.dumps({"id": f"at the end {next(numbers)}", "value": 3.0})
            publish(site.broker_port, "adaptdrive/motor/command/setpoint", payload)
        assert ending.result() == 0
    session = site.session()
    replies = [reply.content["id"] for reply in site.ear.on("reply")]
    events = [event.content["detail"] for event in site.ear.on("event")]
    assert replies
    assert set(replies) <= {command.id for command in session.commands}
    assert set(events) <= {event.detail for event in session.events}
    assert session.info.ended is Ending.ORDERLY


def test_a_killed_drive_trips_and_can_be_run_again_once_it_is_back(make_site: MakeSite) -> None:
    site = make_site()
    site.start("--initial-voltage", "280")
    site.run_drive()
    site.kill(site.device)
    trip = site.await_state(state="tripped")["trip"]
    assert trip.startswith("stale: measurement is ")
    assert "no message comes" in trip
    for verb in ("reset", "enable"):
        assert not site.ask(verb)["accepted"]
    site.start_device("--initial-voltage", "280")
    until(lambda: site.ask("reset")["accepted"], "the reset is accepted")
    site.await_state(state="standby")
    site.run_drive()
    site.demand("disable")
    assert site.stop_daemon() == 0
    _drove_on_held_values_until_it_tripped(site)


def _drove_on_held_values_until_it_tripped(site: Site) -> None:
    """In the record, a silence that has ended the run is not driven through again."""
    rows = site.session().ticks.select(["fresh", "stage"]).to_pylist()
    silences = [list(group) for _, group in itertools.groupby(rows, lambda row: row["fresh"])]
    ran = [[row["stage"] == "run" for row in one] for one in silences if not one[0]["fresh"]]
    tripped = [stages for stages in ran if stages[0] and not stages[-1]]
    assert tripped
    assert all(stages == sorted(stages, reverse=True) for stages in tripped)


def test_a_broker_that_goes_away_changes_nothing_for_the_drive(make_site: MakeSite) -> None:
    site = make_site()
    site.start("--initial-voltage", "280")
    site.run_drive()
    with BusEar(site.config) as bus:
        site.kill(site.broker)
        known = len(bus.commands())
        until(lambda: len(bus.commands()) > known + 180, "commands of 1.5 s")
        site.start_broker()
        site.await_availability("online")
        site.ear.next_on("telemetry/load", after=0)
        site.ear.next_on("telemetry/drive", after=0)
        until(lambda: bus.commands()[-1].bridge, "the drive is still commanded on")
    assert site.await_state(state="running")["trip"] is None
    site.demand("setpoint", 3.0)
    assert site.device_events("safe") == []
