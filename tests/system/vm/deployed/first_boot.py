"""On a bare machine: the steps of the deployment page, then everything that may happen to it.

The tests build on each other, in this order; pytest in the virtual machine runs them.
"""

from __future__ import annotations

import contextlib
import shutil
import time
from pathlib import Path

import pytest

from tests.system.vm.deployed.page import Shell, Step, read_steps
from tests.system.vm.deployed.site import (
    DEAD_MAN_S,
    ROOT,
    SHARED,
    UNIT,
    Bus,
    Operator,
    call,
    unit_says,
    until,
)

STATE = Path("/var/lib/adaptdrive/motor")
CONFIG = Path("/etc/adaptdrive/motor.toml")
DROP_INS = Path("/etc/systemd/system", f"{UNIT}.d")
# A machine that is emulated is late where a real one is not.
SLOW_SETTINGS = {
    "stale_s = 0.05 ": "stale_s = 2.0 ",
    "line_frequency_Hz = 60": "line_frequency_Hz = 50",
    "[mqtt]": "[mqtt]\ntelemetry_Hz = 1.0",
}
BUSY_S = 5.0
"""What a machine with more work than processors may add to any time."""
SLOW_UNIT = "[Service]\nWatchdogSec=10\nTimeoutStartSec=300\n"


@pytest.fixture(scope="module")
def shell() -> Shell:
    folder = Path("/root/deployment")
    folder.mkdir()
    shutil.copy(ROOT / "build" / "adaptdrive.deb", folder)
    return Shell(folder)


@pytest.fixture(scope="module")
def bus() -> Bus:
    return Bus()


@pytest.fixture(scope="module")
def operator() -> Operator:
    operator = Operator()
    operator.listen(SHARED / "heard")
    return operator


@pytest.fixture
def running(bus: Bus, operator: Operator) -> None:
    """The drive runs and is energised."""
    if operator.await_state()["state"] != "running":
        operator.run_drive()
    until(lambda: any(bus.commands()[-20:]), "energising commands")


def came_back_in_standby(bus: Bus, operator: Operator, known: int) -> None:
    """A new daemon is in standby, and no command after the known ones energised."""
    operator.await_state(state="standby", enabled=False)
    until(lambda: len(bus.commands()) > known + 50, "commands of the new daemon")
    assert not any(bus.commands()[known:])


def drive_became_safe(bus: Bus, known: int) -> None:
    """The drive noticed by itself that nobody commands it."""
    event = until(lambda: bus.safe_events()[known:], "the drive's safe state")[0]
    assert event["reason"] == "command timeout"
    assert (event["current_scale_S"], event["bridge"]) == (0.0, False)
    assert event["load_current_A"] == 0.0
    assert DEAD_MAN_S <= 1e-3 * event["after_ms"] < DEAD_MAN_S + BUSY_S


@pytest.mark.parametrize("step", read_steps(), ids=lambda step: f"{step.number}-{step.title}")
def test_step(step: Step, shell: Shell, bus: Bus) -> None:
    said = shell.run(step.commands.replace("can=can0", "can=vcan0"))
    if step.number == 2:
        bus.listen()
    elif step.number == 6:
        _keep_processors_awake()
        _allow_for_a_slow_machine()
        bus.start_drive(CONFIG)
        until(lambda: "simulated drive" in bus.device.read_text(), "the simulated drive")
    elif step.number == 8:
        assert unit_says("ActiveState") == "active", said


def _keep_processors_awake() -> None:
    with CONFIG.open("a", encoding="utf-8") as config:
        config.write("\n[realtime]\ncpu_latency_us = 0\n")
    DROP_INS.mkdir()
    shutil.copy("/usr/share/adaptdrive/drop-ins/latency.conf", DROP_INS)


def _allow_for_a_slow_machine() -> None:
    text = CONFIG.read_text(encoding="utf-8")
    for old, new in SLOW_SETTINGS.items():
        assert old in text
        text = text.replace(old, new)
    CONFIG.write_text(text, encoding="utf-8")
    (DROP_INS / "slow.conf").write_text(SLOW_UNIT, encoding="utf-8")
    call("systemctl", "daemon-reload")


def test_it_runs_and_is_operated(running: None, operator: Operator) -> None:
    assert operator.ask("setpoint", 3.0)["accepted"]
    assert operator.ask("mode", "adaptive")["accepted"]
    operator.await_state(state="running", mode="adaptive", setpoint=3.0)


def test_it_keeps_idle_processors_awake(running: None) -> None:
    said = call("journalctl", "--unit", UNIT, "--output=cat", "--grep=cpu_latency_us")
    assert "cpu_latency_us = 0 granted" in said
    opened = Path("/proc", unit_says("MainPID"), "fd").iterdir()
    assert Path("/dev/cpu_dma_latency") in {one.resolve() for one in opened}


def test_killed_it_comes_back_in_standby(running: None, bus: Bus, operator: Operator) -> None:
    safe, process = len(bus.safe_events()), unit_says("MainPID")
    call("systemctl", "kill", "--kill-whom=main", "--signal=KILL", UNIT)
    time.sleep(1.0)
    known = len(bus.commands())
    drive_became_safe(bus, safe)
    until(lambda: unit_says("MainPID") not in {"0", process}, "a new daemon")
    came_back_in_standby(bus, operator, known)
    assert operator.await_state()["mode"] == "fixed"


def test_frozen_it_is_restarted_by_the_watchdog(
    running: None, bus: Bus, operator: Operator
) -> None:
    safe, process = len(bus.safe_events()), unit_says("MainPID")
    call("systemctl", "kill", "--kill-whom=main", "--signal=STOP", UNIT)
    time.sleep(1.0)
    known = len(bus.commands())
    drive_became_safe(bus, safe)
    until(lambda: unit_says("MainPID") not in {"0", process}, "a new daemon")
    assert "Watchdog timeout" in call("journalctl", "--unit", UNIT, "--output=cat")
    # stopped between the last look at the clock and the bus, it sends that one command
    came_back_in_standby(bus, operator, known + 1)


def test_an_interface_that_goes_down_trips_it(running: None, bus: Bus, operator: Operator) -> None:
    safe = len(bus.safe_events())
    call("ip", "link", "set", "vcan0", "down")
    time.sleep(1.0)
    known = len(bus.commands())
    drive_became_safe(bus, safe)
    tripped = operator.await_state(state="tripped", enabled=False)
    assert tripped["trip"].startswith("stale")
    call("ip", "link", "set", "vcan0", "up")
    until(lambda: len(bus.commands()) > known + 50, "commands on the bus")
    assert operator.await_state()["state"] == "tripped"
    operator.await_accepted("reset")
    came_back_in_standby(bus, operator, known)


def test_a_broker_that_restarts_changes_nothing(
    running: None, bus: Bus, operator: Operator
) -> None:
    safe, known = len(bus.safe_events()), len(bus.commands())
    call("systemctl", "restart", "mosquitto.service")
    told = len(operator.heard("telemetry/load"))
    until(lambda: len(operator.heard("telemetry/load")) > told + 1, "telemetry")
    assert operator.ask("setpoint", 2.9)["accepted"]
    assert len(bus.safe_events()) == safe
    assert all(bus.commands()[known:])


def test_a_step_of_the_clock_changes_nothing(running: None, bus: Bus, operator: Operator) -> None:
    safe, known = len(bus.safe_events()), len(bus.commands())
    for step in ("+2 hours", "-2 hours"):
        call("date", "--set", f"now {step}")
        count = len(bus.commands())
        until(lambda count=count: len(bus.commands()) > count + 50, "commands")  # type: ignore[misc]
        assert operator.ask("setpoint", 3.0)["accepted"]
    assert len(bus.safe_events()) == safe
    assert all(bus.commands()[known:])
    operator.await_state(state="running", trip=None)


def test_a_full_disk_changes_nothing(bus: Bus, operator: Operator) -> None:
    call("systemctl", "stop", UNIT)
    call("mount", "-t", "tmpfs", "-o", "size=4m", "small", str(STATE))
    start_daemon(operator)
    operator.run_drive()
    safe, known = len(bus.safe_events()), len(bus.commands())
    fill(STATE / "filling")
    until(lambda: said_by_recorder(operator), "an event of the recorder")
    assert operator.ask("setpoint", 2.9)["accepted"]
    operator.await_state(state="running", trip=None)
    assert len(bus.safe_events()) == safe
    assert all(bus.commands()[known:])


def start_daemon(operator: Operator) -> None:
    """Start a daemon that was stopped, and wait until it is on the broker."""
    time.sleep(1.0)  # what the one before said has been heard
    known = len(operator.heard("state"))
    call("systemctl", "start", UNIT)
    until(lambda: operator.heard("state")[known:], "the state of a new daemon")
    operator.await_state(state="standby")


def fill(path: Path) -> None:
    """Leave no room on a disk."""
    with contextlib.suppress(OSError), path.open("wb", buffering=0) as filling:
        while True:
            filling.write(bytes(4096))


def said_by_recorder(operator: Operator) -> bool:
    return any(event["kind"] == "recording" for event in operator.heard("event"))


def test_the_power_may_fail_now(operator: Operator) -> None:
    """The last of this boot: the machine is switched off while the drive runs."""
    call("systemctl", "stop", UNIT)
    call("umount", "--lazy", str(STATE))
    start_daemon(operator)
    operator.run_drive()
    call("sync")
