"""What is left when a process vanishes: the drive safe, the daemon honest, and a way back."""

from __future__ import annotations

import itertools
import json
import re
import signal
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest

from adaptdrive.recording.session import Ending
from tests.scenes.system.bus_ear import BusEar
from tests.scenes.system.conftest import MakeSite
from tests.scenes.system.site import PATIENCE_S, Site, publish, until
from tests.support import acting

TICK_S = 1.0 / 120.0
STALE_S = 0.1
BUSY_S = 5.0
"""What a machine with more work than processors may add to any time."""


def test_a_killed_daemon_leaves_the_drive_safe_and_comes_back_in_standby(
    make_site: MakeSite,
) -> None:
    site = make_site()
    site.start("--initial-voltage", "280")
    site.demand("mode", "adaptive")
    site.run_drive()
    site.kill(site.daemon)
    (safe,) = until(lambda: site.device_events("safe"), "the drive's safe state")
    assert safe["reason"] == "command timeout"
    assert 100.0 <= safe["after_ms"] <= 100.0 + 1e3 * BUSY_S
    assert (safe["current_scale_S"], safe["bridge"], safe["load_current_A"]) == (0.0, False, 0.0)
    site.await_availability("offline")
    _comes_back_in_standby(site)


def _comes_back_in_standby(site: Site) -> None:
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


@pytest.mark.parametrize(
    "number",
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
)
def test_each_signal_that_ends_leaves_the_bridge_off(
    make_site: MakeSite, number: signal.Signals
) -> None:
    site = make_site()
    with acting(number):
        site.start("--initial-voltage", "280")
    site.run_drive()
    assert site.daemon is not None
    with BusEar(site.config) as bus:
        until(lambda: bus.commands() and bus.commands()[-1].bridge, "the bridge is commanded on")
        site.daemon.send_signal(number)
        assert site.daemon.wait(timeout=PATIENCE_S) == 0
        farewell = bus.commands()[-3:]
    assert all(command.safe for command in farewell)
    site.await_state(state="standby")


BLOCKED = (
    "import os, signal, sys;"
    "signal.pthread_sigmask(signal.SIG_BLOCK, {*range(1, 32)});"
    "signal.signal(signal.SIGCHLD, signal.SIG_IGN);"
    "os.execv(sys.argv[1], sys.argv[1:])"
)
"""A launcher that a careless supervisor resembles: its children inherit what it blocks."""


def test_a_daemon_whose_starter_blocked_its_signals_ends_by_them(make_site: MakeSite) -> None:
    site = make_site()
    site.start_broker()
    site.start_device("--initial-voltage", "280")
    site.start_daemon(sys.executable, "-c", BLOCKED)
    site.await_measurement()
    site.run_drive()
    with BusEar(site.config) as bus:
        until(lambda: bus.commands() and bus.commands()[-1].bridge, "the bridge is commanded on")
        assert site.stop_daemon() == 0
        farewell = bus.commands()[-3:]
    assert all(command.safe for command in farewell)
    assert "Unknown child process" not in site.daemon_log


def test_asked_to_end_the_daemon_says_goodbye(make_site: MakeSite) -> None:
    site = make_site()
    site.start("--initial-voltage", "280")
    site.run_drive()
    with BusEar(site.config) as bus:
        until(lambda: len(bus.commands()) > 20, "some commands")
        assert site.stop_daemon() == 0
        commands = bus.commands()
    energised = [command for command in commands if not command.safe]
    farewell = commands[len(energised) :]
    assert all(command.safe for command in farewell)
    assert len(farewell) >= 3
    site.await_availability("offline")
    site.await_state(state="standby")
    session = site.session()
    assert session.info.ended is Ending.ORDERLY
    assert session.info.dropped.ticks == 0
    assert "Traceback" not in site.daemon_log


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
    site = make_site({"interlocks.stale_s": str(STALE_S)})
    site.start("--initial-voltage", "280")
    site.run_drive()
    site.kill(site.device)
    tripped = site.await_state(state="tripped")
    age_ms = re.match(
        r"stale: measurement is (\d+) ms old, limit 100 ms; .*no message comes",
        tripped["trip"] or "",
    )
    assert age_ms is not None
    assert 1e3 * STALE_S <= int(age_ms[1]) <= 1e3 * (STALE_S + TICK_S + BUSY_S)
    for verb in ("reset", "enable"):
        assert not site.ask(verb)["accepted"]
    site.start_device("--initial-voltage", "280")
    until(lambda: site.ask("reset")["accepted"], "the reset is accepted")
    site.await_state(state="standby")
    site.run_drive()
    site.demand("disable")
    assert site.stop_daemon() == 0
    _tripped_in_time(site)


def _tripped_in_time(site: Site) -> None:
    """The record tells the same, free of what the machine adds: no tick drove on an older value."""
    last_fresh, silent = 0, 0
    for row in site.session().ticks.select(["tick", "fresh", "stage"]).to_pylist():
        last_fresh = row["tick"] if row["fresh"] else last_fresh
        if row["stage"] == "run":
            silent = max(silent, row["tick"] - last_fresh)
    assert silent >= 2
    assert silent * TICK_S <= STALE_S + TICK_S


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
        assert all(command.bridge for command in bus.commands())
    assert site.await_state(state="running")["trip"] is None
    site.demand("setpoint", 3.0)
