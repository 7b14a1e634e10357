"""A program that the daemon runs while its client has gone, until a trip ends it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

from tests.system.conftest import MakeSite
from tests.system.daemon.site import QUICK_MOTOR, Site, until
from tests.unit.mqtt.contract import validators

PROGRAM = """
name = "scene"
[[steps]]
do = "mode"
mode = "adaptive"
[[steps]]
do = "ramp"
to = 3.2
slope = 0.5
[[steps]]
do = "hold"
within = 0.2
for_s = 1
[[steps]]
do = "hold"
for_s = 7200
[[steps]]
do = "ramp"
to = 2.6
slope = 0.1
[[steps]]
do = "hold"
for_s = 3600
"""


def program(site: Site, *words: str | Path) -> subprocess.CompletedProcess[str]:
    """The command of a client, which is gone when it returns."""
    broker = ("--broker", f"127.0.0.1:{site.broker_port}", "--timeout", "60")
    command = [sys.executable, "-m", "adaptdrive.cli", "program", *map(str, words), *broker]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=120.0)


def await_program(site: Site, **wanted: object) -> dict[str, Any]:
    def find() -> dict[str, Any] | None:
        shown = site.state["program"] or {}
        return shown if wanted.items() <= shown.items() else None

    return until(find, f"a program that is {wanted}; state {site.state}")


def left_s(site: Site) -> float:
    left = float(site.ear.on("telemetry/drive")[-1].content["remaining_s"])
    assert 0.0 < left < 3700.0
    return left


def test_a_program_goes_on_without_its_client_and_a_trip_ends_it(
    make_site: MakeSite, tmp_path: Path
) -> None:
    site = make_site(QUICK_MOTOR)
    site.start("--initial-voltage", "280")
    file = tmp_path / "scene.toml"
    file.write_text(PROGRAM.replace("to = 3.2", "to = 9.2"))
    refused = program(site, "start", "motor", file)
    assert (refused.returncode, "step 2: ramp to = 9.2 V is outside" in refused.stderr) == (1, True)
    file.write_text(PROGRAM)
    assert program(site, "start", "motor", file).returncode == 1  # it is not enabled
    site.run_drive()
    assert program(site, "start", "motor", file).returncode == 0
    await_program(site, name="scene", step=4, status="running")
    assert site.state["mode"] == "adaptive"
    assert "stop it before setpoint" in site.ask("setpoint", 3.0)["reason"]
    assert program(site, "pause", "motor").returncode == 0
    await_program(site, step=4, status="paused")
    assert program(site, "skip", "motor").returncode == 0
    await_program(site, step=6, status="running")
    until(lambda: left_s(site) <= 3600.0, "the last step is shown")
    site.let_periods_pass(2)
    assert site.ear.on("telemetry/load")[-1].content["reference"] == 2.6
    site.disturb("fault", "3")
    site.await_state(state="tripped", enabled=False)
    await_program(site, step=6, status="ended", reason="tripped")
    site.disturb("fault", "0")
    until(lambda: site.ask("reset")["accepted"], "the reset is accepted")
    site.run_drive()
    assert site.state["program"]["status"] == "ended"
    assert site.stop_daemon() == 0
    schema = validators()["state"]
    for message in site.ear.on("state"):
        schema.validate(message.content)
    events = [event.detail for event in site.session().events if event.kind == "program"]
    assert events[-1] == "scene ended: tripped, step 6 of 6: hold for 3600 s"
    replayed = site.replay()
    assert replayed.stdout.splitlines()[1:] == ["every command is bit-equal"]
