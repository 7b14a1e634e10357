"""Recorded sessions in the panel: from a daemon and its archiver to a page of a real mosquitto."""

from __future__ import annotations

import csv
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import expect

from adaptdrive.recording.reader import read_session
from adaptdrive.recording.session import session_directories
from tests.support import MosquittoLauncher
from tests.system.daemon.site import Site, until
from tests.system.panel.browser import PANEL, Panel, panel_site_in, violations
from tests.system.panel.conftest import MakePanel


@dataclass
class Recorded:
    """A drive with two sessions, the first of which ended in a trip, and a third that runs."""

    site: Site
    address: str
    folder: Path

    @property
    def sessions(self) -> list[Path]:
        return list(session_directories(self.folder))


@pytest.fixture(scope="module")
def _recorded(
    tmp_path_factory: pytest.TempPathFactory, _mosquitto_program: MosquittoLauncher
) -> Iterator[Recorded]:
    folder = tmp_path_factory.mktemp("recorded")
    page = shutil.copytree(PANEL, folder / "page")
    sessions = page / "sessions" / "motor"
    settings = {"recording.directory": f'"{sessions}"'}
    with panel_site_in(folder, _mosquitto_program.program, settings, page) as found:
        site = found.site
        site.run_drive()
        site.demand("setpoint", 3.0)
        site.let_periods_pass(4)
        site.kill(site.device)
        site.await_state(state="tripped")
        until(lambda: list(sessions.glob("*/trip-*/overview.json")), "the record of the trip")
        site.stop_daemon()
        site.start_device("--initial-voltage", "280")
        site.start_daemon()
        site.await_measurement()
        site.run_drive()
        site.demand("setpoint", 4.0)
        site.let_periods_pass(4)
        site.stop_daemon()
        site.start_daemon()
        site.await_measurement()
        until(lambda: len(list(sessions.glob("*/overview.json"))) == 3, "the third session")
        yield Recorded(site, found.address, sessions)


@pytest.fixture
def recorded(outside: None, _recorded: Recorded) -> Recorded:
    return _recorded


@pytest.fixture
def viewer(make_panel: MakePanel, recorded: Recorded) -> Panel:
    """The list of the sessions."""
    panel = make_panel()
    panel.log_in(recorded.address, "viewer")
    panel.open_drive()
    panel.page.get_by_role("link", name="sessions", exact=True).click()
    expect(panel.page.locator("tbody tr")).to_have_count(3)
    return panel


def open_first(viewer: Panel) -> None:
    """Open the session that ended in a trip: it is the last one of the list."""
    viewer.page.locator("tbody tr").last.locator("a.whole").click()
    expect(viewer.page.locator("figure.plot canvas").first).to_be_visible()


def test_a_session_is_opened_and_zoomed(viewer: Panel, recorded: Recorded) -> None:
    page, first = viewer.page, recorded.sessions[0]
    expect(page.locator("tbody tr").last).to_contain_text("orderly")
    expect(page.locator("tbody tr").last.locator(".trip")).to_have_count(1)
    open_first(viewer)
    expect(page.get_by_role("heading", name=first.name)).to_be_visible()
    every = page.locator(".recorded li")
    count = every.count()
    assert count > 5
    over = page.locator(".u-over").first
    box = over.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 0.9 * box["width"], box["y"] + 20)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.98 * box["width"], box["y"] + 20, steps=4)
    page.mouse.up()
    until(lambda: every.count() < count, "fewer events are in the part that is shown")
    page.get_by_role("button", name="Show all").click()
    expect(every).to_have_count(count)
    page.get_by_role("button", name="zoom in").press("Enter")
    page.get_by_role("button", name="zoom out").press("Enter")
    expect(every).to_have_count(count)


def test_what_is_downloaded_has_the_extremes_of_every_tick(
    viewer: Panel, recorded: Recorded, tmp_path: Path
) -> None:
    page, first = viewer.page, recorded.sessions[0]
    open_first(viewer)
    with page.expect_download() as points:
        page.get_by_role("button", name="CSV: ticks").click()
    assert points.value.suggested_filename == f"{first.name}-ticks.csv"
    with points.value.path().open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    ticks = read_session(first).ticks
    for column, name in (("output", "output (V)"), ("boost_voltage_V", "boost_voltage_V (V)")):
        values = [float(row[name]) for row in rows if row[name]]
        recorded_values = ticks[column].to_numpy()
        wanted = np.nanmin(recorded_values), np.nanmax(recorded_values)
        assert (min(values), max(values)) == pytest.approx(wanted, rel=1e-6)
    page.locator("summary").filter(has_text="Parquet").click()
    with page.expect_download() as whole:
        page.get_by_role("link", name="ticks-0001.parquet").click()
    assert whole.value.path().read_bytes() == (first / "ticks-0001.parquet").read_bytes()


def test_two_sessions_are_laid_over_each_other(viewer: Panel, recorded: Recorded) -> None:
    page = viewer.page
    for place in (1, 2):
        page.locator("tbody input").nth(place).check()
    page.get_by_role("button", name="Overlay two").click()
    for one in recorded.sessions[:2]:
        expect(page.get_by_role("heading", name=one.name)).to_be_visible()
    labels = page.locator("figure.plot").first.locator(".u-label")
    expect(labels).to_have_text(["time", "1: output", "1: reference", "2: output", "2: reference"])
    running = page.locator(".recorded li").filter(has_text="running")
    for number in ("1: ", "2: "):
        event = running.filter(has=page.get_by_role("button", name=number)).first
        event.get_by_role("button", name="0\u202fs here").click()
    for number in ("1: ", "2: "):  # both now begin to run at the same time
        event = running.filter(has=page.get_by_role("button", name=number)).first
        expect(event.get_by_role("button").first).to_have_text(f"{number}0\u202fs")


def test_a_trip_leads_to_its_record(make_panel: MakePanel, recorded: Recorded) -> None:
    site, panel = recorded.site, make_panel()
    panel.log_in(recorded.address, "viewer")
    panel.open_drive()
    site.run_drive()
    panel.expect_state("running")
    known = len(list(recorded.folder.glob("*/trip-*/overview.json")))
    site.kill(site.device)
    panel.expect_state("tripped")
    link = panel.page.get_by_role("link", name="its record").first
    expect(link).to_be_visible()
    until(
        lambda: len(list(recorded.folder.glob("*/trip-*/overview.json"))) > known,
        "the record of the trip",
    )
    panel.page.get_by_role("link", name="record of this trip").click()
    newest = recorded.sessions[-1]
    (record,) = newest.glob("trip-*")
    heading = panel.page.get_by_role("heading", name=f"{newest.name}/{record.name}")
    expect(heading).to_be_visible()
    expect(panel.page.locator(".recorded [data-severity=alarm]").first).to_be_visible()
    site.start_device("--initial-voltage", "280")
    site.await_measurement()


def test_sessions_that_are_not_reachable_are_said(viewer: Panel, recorded: Recorded) -> None:
    away = recorded.folder.rename(recorded.folder.with_name("away"))
    try:
        viewer.page.reload()
        viewer.expect_text(".answer", "not reachable: status 404 for sessions/motor/index.json")
        viewer.expect_text("body", "adaptdrive panel --sessions FOLDER")
    finally:
        away.rename(recorded.folder)


@pytest.mark.proof
def test_everybody_can_read_and_operate_sessions(
    viewer: Panel, recorded: Recorded, axe: str
) -> None:
    page = viewer.page
    assert violations(viewer, axe) == []
    first, second = (one.name for one in recorded.sessions[:2])
    for what in (first, f"{first}+{second}", "none"):
        page.evaluate("hash => { location.hash = hash; }", f"#motor/sessions/{what}")
        page.locator(".recorded, .answer[data-kind=refused]").first.wait_for()
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        assert violations(viewer, axe) == []
    viewer.expect_text(".answer", "none is not among the sessions: it was removed")
