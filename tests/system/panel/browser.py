"""A browser, the panel's page from a real mosquitto with users, and the drive that it shows."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from playwright.sync_api import Browser, Page, expect, sync_playwright

from tests.support import MosquittoLauncher, free_port
from tests.system.access.broker import PEOPLE, SHIPPED, password
from tests.system.daemon.site import PATIENT, QUICK_MOTOR, Site

PANEL = Path(__file__).parents[3] / "src" / "adaptdrive" / "panel"
PATIENCE_MS = 120_000
SETTINGS = {
    **PATIENT,
    **QUICK_MOTOR,
    "estimator.settle_s": "1.0",
    "supervisor.warm_up_s": "4.0",
}


@dataclass
class Panel:
    """The page of one user in one window.

    Attributes:
        page: The page.
        errors: Errors of scripts, and what the policy of the page has stopped.
    """

    page: Page
    errors: list[str] = field(default_factory=list)

    def note(self, line: str) -> None:
        """Keep a line of the console that reports a violation of the policy."""
        if "Content Security" in line:
            self.errors.append(line)

    def log_in(self, address: str, user: str, secret: str | None = None) -> None:
        self.page.goto(address)
        self.fill_in(user, secret)

    def fill_in(self, user: str, secret: str | None = None) -> None:
        """Log in on the page that is open."""
        self.page.get_by_label("user").fill(user)
        self.page.get_by_label("password").fill(password(user) if secret is None else secret)
        self.page.get_by_role("button", name="Log in").press("Enter")

    def open_drive(self, name: str = "motor") -> None:
        self.page.get_by_role("link", name=name, exact=True).click()
        self.page.get_by_role("heading", name=name).wait_for()

    def expect_state(self, state: str) -> None:
        expect(self.page.locator(".chip")).to_have_text(state, timeout=PATIENCE_MS)

    def expect_text(self, place: str, text: str) -> None:
        found = self.page.locator(place)
        expect(found).to_contain_text(text, timeout=PATIENCE_MS)

    def value(self, name: str) -> str:
        """The present value with a name."""
        row = self.page.locator(".values div").filter(has_text=name).first
        return row.locator("dd").first.inner_text()


@contextmanager
def browser_of(program: str) -> Iterator[Browser]:
    """Start Chromium without a window."""
    with sync_playwright() as playwright:
        root = ["--no-sandbox"] if os.getuid() == 0 else []
        found = playwright.chromium.launch(executable_path=program, args=root)
        yield found
        found.close()


def chromium() -> str | None:
    return shutil.which("chromium")


def open_panel(browser: Browser, **options: Any) -> Panel:
    """Open a window of its own, with the options of a Playwright context."""
    page = browser.new_context(**options).new_page()
    page.set_default_timeout(PATIENCE_MS)
    panel = Panel(page)
    page.on("pageerror", lambda error: panel.errors.append(str(error)))
    page.on("dialog", lambda dialog: panel.errors.append(f"dialog: {dialog.message}"))
    page.on("console", lambda line: panel.note(line.text))
    return panel


@dataclass
class PanelSite:
    """A drive with its daemon and a broker that serves the panel.

    Attributes:
        site: The processes.
        address: Of the page.
    """

    site: Site
    address: str


@contextmanager
def panel_site_in(
    folder: Path,
    mosquitto: str,
    settings: Mapping[str, str] = MappingProxyType({}),
    page: Path = PANEL,
) -> Iterator[PanelSite]:
    """Start a drive, its daemon with further settings, and a broker that serves the panel."""
    port = free_port(socket.SOCK_STREAM)
    launcher = MosquittoLauncher(mosquitto, folder, web_listener(folder, port, page))
    ports = free_port(socket.SOCK_STREAM), free_port(socket.SOCK_DGRAM)
    with closing(Site(folder, launcher, *ports, {**SETTINGS, **settings})) as site:
        site.start("--initial-voltage", "280")
        yield PanelSite(site, f"http://127.0.0.1:{port}/index.html")


def web_listener(folder: Path, port: int, page: Path = PANEL) -> str:
    """Return the settings of a listener that serves the page, with the shipped rights."""
    users = folder / "users"
    users.touch()
    for user in PEOPLE:
        command = ["mosquitto_passwd", "-b", str(users), user, password(user)]
        subprocess.run(command, check=True, capture_output=True, timeout=60)
    rights = folder / "rights"
    rights.write_bytes((SHIPPED / "adaptdrive.acl").read_bytes())
    lines = (
        f"listener {port} 127.0.0.1",
        "protocol websockets",
        f"http_dir {page}",
        "allow_anonymous false",
        f"password_file {users}",
        f"acl_file {rights}",
        "user root",
    )
    return "\n".join(lines) + "\n"


SIZES = ((1280, 860), (360, 740))
JUDGE = """async () => (await axe.run(document)).violations.flatMap(
  one => one.nodes.map(node => `${one.id}: ${node.target}: ${node.failureSummary}`))"""


def violations(panel: Panel, axe: str) -> list[Any]:
    """Return what is wrong in each size and colour scheme."""
    session = panel.page.context.new_cdp_session(panel.page)  # past the policy of the page
    found: list[Any] = []
    for width, height in SIZES:
        panel.page.set_viewport_size({"width": width, "height": height})
        for scheme in ("light", "dark"):
            panel.page.emulate_media(color_scheme="dark" if scheme == "dark" else "light")
            panel.page.wait_for_timeout(500)  # until the page has drawn with its new colours
            session.send("Runtime.evaluate", {"expression": axe})
            found += [(width, scheme, one) for one in panel.page.evaluate(JUDGE)]
    return found
