"""Pictures of each state of the panel for the manual: `python -m tools.pages.pictures docs/images`.

Each picture holds four views of one state: desk and telephone, light and dark.
"""

from __future__ import annotations

import sys
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

from PIL import Image
from playwright.sync_api import Browser, ViewportSize

from tests.system.panel.browser import Panel, PanelSite, browser_of, open_panel, panel_site_in

Scheme = Literal["light", "dark"]

DESK = ViewportSize(width=1280, height=860)
PHONE = ViewportSize(width=360, height=860)
SCHEMES: tuple[Scheme, Scheme] = ("light", "dark")
COLOURS = 256
SCALE = 0.7
SETTLE_MS = 1500
PERIODS = 14
"""Slow periods from a step of the reference to the picture."""


def main(folder: Path) -> None:
    """Take all pictures."""
    with (
        TemporaryDirectory() as name,
        panel_site_in(Path(name), "/usr/sbin/mosquitto") as site,
        browser_of("/usr/bin/chromium") as browser,
    ):
        panel = open_panel(browser)
        panel.page.goto(site.address)
        panel.page.get_by_role("button", name="Log in").wait_for()
        _take(panel, folder, "login")
        panel.fill_in("operator")
        panel.page.get_by_role("heading", name="Drives").wait_for()
        _take_running(panel, site, folder)
        _take_viewer(browser, site, folder)
        _take_lost(panel, site, folder)


def _take_running(panel: Panel, site: PanelSite, folder: Path) -> None:
    site.site.run_drive()
    site.site.demand("setpoint", 3.0)
    site.site.let_periods_pass(PERIODS // 2)
    site.site.demand("setpoint", 3.1)
    site.site.let_periods_pass(PERIODS)
    panel.open_drive()
    panel.expect_state("running")
    _take(panel, folder, "fixed")
    site.site.demand("mode", "adaptive")
    site.site.demand("setpoint", 3.2)
    site.site.let_periods_pass(PERIODS)
    site.site.await_state(controller="adaptive")
    _take(panel, folder, "adaptive")


def _take_viewer(browser: Browser, site: PanelSite, folder: Path) -> None:
    viewer = open_panel(browser)
    viewer.log_in(site.address, "viewer")
    viewer.open_drive()
    viewer.page.get_by_text("This user may look and not command.").wait_for()
    _take(viewer, folder, "viewer")
    viewer.page.context.close()


def _take_lost(panel: Panel, site: PanelSite, folder: Path) -> None:
    """Lose the drive, which trips, then hold the daemon up, then end it."""
    site.site.kill(site.site.device)
    panel.expect_state("tripped")
    panel.expect_text(".age", "drive silent")
    _take(panel, folder, "tripped")
    panel.page.get_by_role("link", name="all drives").click()
    panel.expect_text("table", "tripped")
    _take(panel, folder, "site")
    panel.open_drive()
    with site.site.stalled(site.site.daemon):
        panel.expect_text(".age", "no data")
        _take(panel, folder, "stale")
    site.site.kill(site.site.daemon)
    panel.expect_state("offline")
    _take(panel, folder, "offline")


def _take(panel: Panel, folder: Path, state: str) -> None:
    """Put the four views of what is shown now beside each other."""
    sheet = Image.new("RGB", (DESK["width"] + PHONE["width"], 2 * DESK["height"]))
    for row, scheme in enumerate(SCHEMES):
        top = row * DESK["height"]
        sheet.paste(_view(panel, DESK, scheme), (0, top))
        sheet.paste(_view(panel, PHONE, scheme), (DESK["width"], top))
    size = int(sheet.width * SCALE), int(sheet.height * SCALE)
    small = sheet.resize(size, Image.Resampling.LANCZOS)
    # rare colours are those that matter; one step of k-means brings the backgrounds back
    few = small.quantize(COLOURS, Image.Quantize.MAXCOVERAGE, kmeans=1)
    few.save(folder / f"panel-{state}.png", optimize=True)


def _view(panel: Panel, size: ViewportSize, scheme: Scheme) -> Image.Image:
    panel.page.set_viewport_size(size)
    panel.page.emulate_media(color_scheme=scheme)
    panel.page.evaluate("ms => new Promise(done => setTimeout(done, ms))", SETTLE_MS)
    with Image.open(BytesIO(panel.page.screenshot())) as image:
        return image.convert("RGB")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
