"""A drive whose output people see and type in rpm: in the page, at the command line, in records."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import expect

from tests.support import MosquittoLauncher
from tests.system.panel.browser import Panel, PanelSite, panel_site_in
from tests.system.panel.conftest import MakePanel

SETTINGS = {"load.output_display": '{ unit = "rpm", scale = 400.0 }'}


@pytest.fixture
def shaft(
    outside: None, tmp_path: Path, _mosquitto_program: MosquittoLauncher
) -> Iterator[PanelSite]:
    """The motor of the example, of which 1 V of its tachometer is 400 rpm."""
    with panel_site_in(tmp_path, _mosquitto_program.program, SETTINGS) as found:
        yield found


def command(shaft: PanelSite, *words: str) -> str:
    """What a command of the operator prints."""
    broker = f"127.0.0.1:{shaft.site.broker_port}"
    return run(*words, "--broker", broker)


def run(*words: str) -> str:
    line = [sys.executable, "-m", "adaptdrive.cli", *words]
    done = subprocess.run(line, check=False, capture_output=True, text=True, timeout=60)
    return done.stdout + done.stderr


def typed_into(panel: Panel, level: str) -> None:
    field = panel.page.get_by_label("set-point, rpm")
    field.evaluate("field => { field.form.noValidate = true; }")
    field.fill(level)
    panel.page.get_by_role("button", name="Set", exact=True).first.click()


def test_people_see_and_type_rpm_and_the_daemon_has_volts(
    make_panel: MakePanel, shaft: PanelSite
) -> None:
    site = shaft.site
    site.run_drive()
    panel = make_panel()
    panel.log_in(shaft.address, "operator")
    panel.open_drive()
    panel.expect_text(".age", "live")
    assert panel.page.locator(".range small").all_inner_texts() == ["0", "1800"]
    typed_into(panel, "3600")
    panel.expect_text(
        ".answer", "setpoint 3600 rpm: refused: setpoint = 3600 rpm is outside 0…1800"
    )
    typed_into(panel, "1200")
    panel.expect_text(".answer", "setpoint 1200 rpm: accepted")
    site.await_state(setpoint=3.0)
    expect(panel.page.locator("p.large")).to_contain_text("rpm")
    at_the_command_line(shaft)
    typed_into(panel, "1700")
    site.await_state(setpoint=4.25)
    site.demand("setpoint", 3.0)  # a program that names no unit
    site.await_state(setpoint=3.0)
    site.demand("disable")
    assert site.stop_daemon() == 0
    found = site.session()
    values = {one.value for one in found.commands if one.verb == "setpoint" and one.accepted}
    typed = {value.partition(" {")[0] for value in values}
    assert {"1200 rpm", "1000.0 rpm", "900.0 rpm", "3.5 V", "3.0"} <= typed
    assert '900.0 rpm {"slope": 4000.0}' in values
    assert found.info.output_unit == "V"
    assert found.info.display is not None
    assert found.info.display.unit == "rpm"
    assert "0…1800 rpm" in run("check", str(site.config))
    columns = recorded(panel, site.session_folder() / "overview.json")
    assert {columns[name]["unit"] for name in ("output", "reference")} == {"rpm"}
    assert 1690.0 < max(filter(None, columns["reference"]["values"])) < 1701.0


def recorded(panel: Panel, overview: Path) -> dict[str, Any]:
    """The curves of a session as the page reads them."""
    panel.page.route("**/overview.json", lambda route: route.fulfill(path=overview))
    found = panel.page.evaluate("Sessions.overview('motor', 'last')")
    return {one["name"]: one for one in found["tables"]["ticks"]["columns"]}


def at_the_command_line(shaft: PanelSite) -> None:
    assert "1200 rpm" in command(shaft, "status", "motor")
    assert "accepted" in command(shaft, "setpoint", "motor", "1000", "--ramp", "4000/s")
    shaft.site.await_state(setpoint=2.5)
    assert "accepted" in command(shaft, "setpoint", "motor", "900rpm", "--ramp", "4000rpm/s")
    shaft.site.await_state(setpoint=2.25)
    assert "accepted" in command(shaft, "setpoint", "motor", "3.5V")
    shaft.site.await_state(setpoint=3.5)
    refused = command(shaft, "setpoint", "motor", "5Hz")
    assert "unit = 'Hz': the output is in rpm or V" in refused
