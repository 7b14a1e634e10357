"""Pictures of the panel for the manual: `python -m tests.panel.pictures docs/images`."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from playwright.sync_api import Browser, ViewportSize

from tests.panel.browser import Panel, PanelSite, browser_of, open_panel, panel_site_in

DESK = ViewportSize(width=1280, height=900)
PHONE = ViewportSize(width=360, height=780)
RUN_S = 75.0
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
        _take(browser, site, folder, "running")
        site.site.kill(site.site.device)
        site.site.await_state(state="tripped")
        _take(browser, site, folder, "tripped")


def _take_login(browser: Browser, site: PanelSite, folder: Path) -> None:
    panel = open_panel(browser, viewport=DESK)
    panel.page.goto(site.address)
    panel.page.get_by_role("button", name="Log in").wait_for()
    _write(panel, folder / "panel-login.png")


def _take(browser: Browser, site: PanelSite, folder: Path, state: str) -> None:
    for name, viewport, scheme in (
        ("light", DESK, "light"),
        ("dark", DESK, "dark"),
        ("phone", PHONE, "light"),
    ):
        panel = open_panel(browser, viewport=viewport, color_scheme=scheme)
        panel.log_in(site.address, "operator")
        panel.page.get_by_role("heading", name="Drives").wait_for()
        time.sleep(1.5)
        if name == "light":
            _write(panel, folder / f"panel-site-{state}.png")
        panel.open_drive()
        panel.expect_state(state)
        time.sleep(2.5)
        _write(panel, folder / f"panel-{state}-{name}.png")


def _write(panel: Panel, path: Path) -> None:
    panel.page.screenshot(path=path)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
