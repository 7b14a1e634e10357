"""`adaptdrive commission` on a real bus, with a load that its configuration does not describe."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import tomllib

import pytest

from tests.pseudo_terminal import Screen
from tests.scenes.system.conftest import MakeSite
from tests.scenes.system.site import PATIENT_DRIVE, Site, motor_configuration, until

PATIENT = {"interlocks.stale_s": "0.5"}
LOAD = {
    "load.model.gain": "0.008",
    "load.model.tau_motor_s": "0.5",
    "load.model.tau_filter_s": "0.2",
}
BEGIN_S = 90.0
"""The program starts, watches the sensor, and enables the drive."""

LONGEST_S = 800.0


def commission(site: Site, *options: str, terminal: int | None = None) -> subprocess.Popen[str]:
    """Start the command with the file that the daemon runs with."""
    words = ["commission", "motor", "--config", str(site.config), "--patience", "1", "--yes"]
    broker = ["--broker", f"127.0.0.1:{site.broker_port}"]
    return subprocess.Popen(
        [sys.executable, "-m", "adaptdrive.cli", *words, *broker, *options],
        cwd=site.folder,
        env=os.environ | {"TERM": "xterm", "LINES": "24", "COLUMNS": "80"},
        stdin=terminal,
        stdout=subprocess.PIPE if terminal is None else terminal,
        stderr=subprocess.STDOUT,
        text=True,
    )


@pytest.fixture
def site(make_site: MakeSite) -> Site:
    """A site whose daemon has the example's model, and whose load is another."""
    site = make_site({**PATIENT, **LOAD})
    site.start_broker()
    site.start_device("--noise", "0.002", *PATIENT_DRIVE)
    text = motor_configuration(site.broker_port, site.bus_port, PATIENT)
    site.config.write_text(text, encoding="utf-8")
    site.start_daemon()
    site.await_measurement()
    return site


@pytest.mark.slow
def test_a_load_is_commissioned_and_the_file_is_written(site: Site) -> None:
    before = site.config.read_text(encoding="utf-8")
    process = commission(site, "--write")
    output, _ = process.communicate(timeout=LONGEST_S)
    assert process.returncode == 0, output
    site.await_state(state="standby", mode="fixed")
    assert "predicted overshoot" in output
    assert (site.folder / "commission.png").read_bytes().startswith(b"\x89PNG")
    assert site.config.with_name("motor.toml.bak").read_text(encoding="utf-8") == before
    after = site.config.read_text(encoding="utf-8")
    assert "# tachometer volts per volt of boost voltage" in after
    model = tomllib.loads(after)["load"]["model"]
    assert model["gain"] == pytest.approx(0.008, rel=0.05)
    assert model["tau_motor_s"] + model["tau_filter_s"] == pytest.approx(0.7, rel=0.15)
    check = [sys.executable, "-m", "adaptdrive.cli", "check", str(site.config)]
    assert subprocess.run(check, capture_output=True, check=False).returncode == 0


@pytest.mark.slow
def test_a_measured_load_is_applied_and_adaptive_is_in_force(site: Site) -> None:
    """`--apply` writes the file; the same daemon takes it, without learning anew for 90 s."""
    daemon = site.daemon
    assert daemon is not None
    process = commission(site, "--apply")
    output, _ = process.communicate(timeout=LONGEST_S)
    assert process.returncode == 0, output
    state = site.await_state(state="running", mode="adaptive", controller="adaptive")
    assert daemon.poll() is None
    waited = re.search(r"in force after ([\d.]+) s", output)
    assert waited is not None
    assert float(waited[1]) < 20.0  # 10 s on a machine that runs no other tests
    assert f"holds {state['setpoint']:.4g} V in mode adaptive" in output
    model = tomllib.loads(site.config.read_text(encoding="utf-8"))["load"]["model"]
    load = site.ear.on("telemetry/load")[-1].content
    assert load["estimates"]["gain"]["value"] == pytest.approx(model["gain"], rel=0.1)

    def arrived() -> bool:
        output = site.ear.on("telemetry/drive")[-1].content["output"]
        return bool(abs(output - state["setpoint"]) < 0.1)

    until(arrived, "the output is at the set-point")


@pytest.mark.slow
def test_an_interrupt_and_a_key_end_it_with_the_drive_off(site: Site) -> None:
    process = commission(site)
    site.await_state(patience_s=BEGIN_S, state="running", mode="manual")
    process.send_signal(signal.SIGINT)
    site.await_state(state="standby", mode="fixed")
    process.communicate(timeout=LONGEST_S)
    assert process.returncode == 130
    screen = Screen()
    process = commission(site, terminal=screen.inner)
    try:
        until(lambda: "waiting for rest" in screen.read(), "the live picture", BEGIN_S)
        assert site.state["mode"] == "manual"
        screen.press("q")
        site.await_state(state="standby", mode="fixed")
        until(lambda: "ended by a key: the drive is off" in screen.read(), "the reason")
        assert process.wait(timeout=LONGEST_S) == 1
    finally:
        process.kill()
        screen.close()


@pytest.mark.slow
def test_a_disable_ends_it_and_a_second_one_does_not(site: Site) -> None:
    process = commission(site)
    site.await_state(patience_s=BEGIN_S, state="running", mode="manual")
    second = commission(site)
    refusal, _ = second.communicate(timeout=LONGEST_S)
    assert second.returncode == 1
    assert f"motor is already commissioned by process {process.pid}" in refusal
    assert site.state["state"] == "running"
    site.demand("disable")
    output, _ = process.communicate(timeout=LONGEST_S)
    assert process.returncode == 1
    assert "motor is standby: disabled by another operator" in output


@pytest.mark.slow
def test_a_killed_program_leaves_a_tripped_drive(site: Site) -> None:
    process = commission(site)
    site.await_state(patience_s=BEGIN_S, state="running", mode="manual")
    until(lambda: site.state["voltage_V"] is not None, "a voltage")
    until(lambda: [one for one in site.ear.on("reply") if "voltage" in one.payload], "a reply")
    process.kill()
    process.communicate()
    tripped = site.await_state(state="tripped")
    assert tripped["trip"].startswith("manual: no new voltage within the 5 s")


@pytest.mark.slow
def test_a_drive_that_is_not_heard_is_named(make_site: MakeSite) -> None:
    site = make_site(PATIENT)
    site.start_broker()
    site.start_daemon()
    output, _ = commission(site).communicate(timeout=LONGEST_S)
    assert "no measurement for 4 s: adaptdrive probe shows why" in output
    assert "Traceback" not in output
