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
from tests.system.conftest import MakeSite
from tests.system.daemon.site import PATIENT, QUICK_MOTOR, Site, until

LOAD = {
    "load.model.gain": "0.008",
    "load.model.tau_motor_s": "0.2",
    "load.model.tau_filter_s": "0.1",
}
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
    site = make_site({**QUICK_MOTOR, **LOAD})
    site.start_broker()
    site.start_device("--noise", "0.001")
    site.write({**PATIENT, **QUICK_MOTOR})
    site.start_daemon()
    site.await_measurement()
    return site


def test_a_measured_load_is_applied_and_adaptive_is_in_force(site: Site) -> None:
    """`--apply` writes the file; the same daemon takes it, without learning anew for 90 s."""
    daemon = site.daemon
    assert daemon is not None
    before = site.config.read_text(encoding="utf-8")
    process = commission(site, "--apply")
    output, _ = process.communicate(timeout=LONGEST_S)
    assert process.returncode == 0, output
    state = site.await_state(state="running", mode="adaptive", controller="adaptive")
    assert daemon.poll() is None
    assert "predicted overshoot" in output
    assert re.search(r"in force after ([\d.]+) s", output)
    assert f"holds {state['setpoint']:.4g} V in mode adaptive" in output
    assert (site.folder / "commission.png").read_bytes().startswith(b"\x89PNG")
    assert site.config.with_name("motor.toml.bak").read_text(encoding="utf-8") == before
    after = site.config.read_text(encoding="utf-8")
    assert "# tachometer volts per volt of boost voltage" in after
    model = tomllib.loads(after)["load"]["model"]
    assert model["gain"] == pytest.approx(0.008, rel=0.05)
    assert model["tau_motor_s"] + model["tau_filter_s"] == pytest.approx(0.3, rel=0.15)
    load = site.ear.on("telemetry/load")[-1].content
    assert load["estimates"]["gain"]["value"] == pytest.approx(model["gain"], rel=0.1)

    def arrived() -> bool:
        output = site.ear.on("telemetry/drive")[-1].content["output"]
        return bool(abs(output - state["setpoint"]) < 0.1)

    until(arrived, "the output is at the set-point")
    gains = [
        tomllib.loads((one / "config.toml").read_text())["load"]["model"]["gain"]
        for one in sorted((site.folder / "sessions").glob("[!.]*/"))
    ]
    assert gains == [0.011, model["gain"]]
    assert "reloaded; changed: [load]" in site.daemon_log


@pytest.mark.proof
def test_an_interrupt_a_key_and_another_operator_end_it_with_the_drive_off(site: Site) -> None:
    process = commission(site)
    site.await_state(state="running", mode="manual")
    refusal, _ = commission(site).communicate(timeout=LONGEST_S)
    assert f"motor is already commissioned by process {process.pid}" in refusal
    process.send_signal(signal.SIGINT)
    site.await_state(state="standby", mode="fixed")
    process.communicate(timeout=LONGEST_S)
    assert process.returncode == 130
    process = commission(site)
    site.await_state(state="running", mode="manual")
    site.demand("disable")
    output, _ = process.communicate(timeout=LONGEST_S)
    assert process.returncode == 1
    assert "motor is standby: disabled by another operator" in output
    screen = Screen()
    process = commission(site, terminal=screen.inner)
    try:
        until(lambda: "waiting for rest" in screen.read(), "the live picture")
        screen.press("q")
        site.await_state(state="standby", mode="fixed")
        until(lambda: "ended by a key: the drive is off" in screen.read(), "the reason")
        assert process.wait(timeout=LONGEST_S) == 1
    finally:
        process.kill()
        screen.close()
