"""Pictures of the panel for the manual: `python -m tests.panel.pictures docs/images`."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

from PIL import Image
from playwright.sync_api import Browser, ViewportSize

from tests.panel.browser import Panel, PanelSite, browser_of, open_panel, panel_site_in

Scheme = Literal["light", "dark"]

DESK = ViewportSize(width=1280, height=900)
PHONE = ViewportSize(width=360, height=780)
COLOURS = 64
SETTLED_S = 2.5
RUN_S = 70.0
"""Long enough for a step of the reference and a trusted estimate."""


def main(folder: Path) -> None:
    """Take all pictures."""
    with (
        TemporaryDirectory() as name,
        panel_site_in(Path(name), "/usr/sbin/mosquitto") as site,
        browser_of("/usr/bin/chromium") as browser,
    ):
        _take_login(browser, site, folder)
        site.site.run_drive()
        site.site.demand("mode", "adaptive")
        site.site.demand("setpoint", 3.2)
        time.sleep(RUN_S / 2)
        site.site.demand("setpoint", 3.0)
        time.sleep(RUN_S / 2)
        _take(browser, site, "running", folder / "panel-running-light.png", "light", DESK)
        site.site.kill(site.site.device)
        site.site.await_state(state="tripped")
        _take(browser, site, "tripped", folder / "panel-tripped-dark.png", "dark", DESK)
        _take(browser, site, "tripped", folder / "panel-tripped-phone.png", "light", PHONE)
        _take_list(browser, site, folder)


def _take_login(browser: Browser, site: PanelSite, folder: Path) -> None:
    panel = open_panel(browser, viewport=DESK)
    panel.page.goto(site.address)
    panel.page.get_by_role("button", name="Log in").wait_for()
    _write(panel, folder / "panel-login.png")


def _take_list(browser: Browser, site: PanelSite, folder: Path) -> None:
    panel = open_panel(browser, viewport=ViewportSize(width=1280, height=300))
    panel.log_in(site.address, "operator")
    panel.expect_text("table", "tripped")
    _write(panel, folder / "panel-site-tripped.png")


def _take(  # noqa: PLR0917 - one picture
    browser: Browser,
    site: PanelSite,
    state: str,
    path: Path,
    scheme: Scheme,
    viewport: ViewportSize,
) -> None:
    panel = open_panel(browser, viewport=viewport, color_scheme=scheme)
    panel.log_in(site.address, "operator")
    panel.open_drive()
    panel.expect_state(state)
    time.sleep(SETTLED_S)
    _write(panel, path)


def _write(panel: Panel, path: Path) -> None:
    panel.page.screenshot(path=path)
    with Image.open(path) as image:
        small = image.convert("RGB").quantize(COLOURS)
    small.save(path, optimize=True)
    panel.page.context.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
