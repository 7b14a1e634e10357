"""One browser and one site for each file of tests of the panel."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol

import pytest
from playwright.sync_api import Browser

from tests.support import MosquittoLauncher
from tests.system.panel.browser import (
    Panel,
    PanelSite,
    browser_of,
    chromium,
    open_panel,
    panel_site_in,
)


class MakePanel(Protocol):
    """Opens a window with the options of a Playwright context."""

    def __call__(self, **options: Any) -> Panel: ...


@pytest.fixture(scope="module")  # its event loop would keep the tests of other files from running
def browser() -> Iterator[Browser]:
    program = chromium()
    if program is None:
        pytest.skip("chromium is not installed")
    with browser_of(program) as found:
        yield found


@pytest.fixture
def make_panel(browser: Browser) -> Iterator[MakePanel]:
    """Open windows; each script error or violation of the policy fails the test."""
    panels: list[Panel] = []

    def make(**options: Any) -> Panel:
        panels.append(open_panel(browser, **options))
        return panels[-1]

    yield make
    for panel in panels:
        panel.page.context.close()
    assert [error for panel in panels for error in panel.errors] == []


@pytest.fixture(scope="module")
def _panel_site(
    tmp_path_factory: pytest.TempPathFactory, _mosquitto_program: MosquittoLauncher
) -> Iterator[PanelSite]:
    with panel_site_in(tmp_path_factory.mktemp("panel"), _mosquitto_program.program) as found:
        yield found


@pytest.fixture
def panel_site(outside: None, _panel_site: PanelSite) -> PanelSite:
    """One drive for all tests of a file."""
    return _panel_site


@pytest.fixture(scope="module")
def axe() -> str:
    """The rules as a script."""
    npm = shutil.which("npm")
    if npm is None:
        pytest.skip("npm is not installed")
    command = [npm, "root", "--global"]
    root = subprocess.run(command, check=True, capture_output=True, text=True, timeout=60).stdout
    rules = Path(root.strip()) / "axe-core" / "axe.min.js"
    if not rules.exists():
        pytest.skip("axe-core is not installed (npm install --global axe-core)")
    return rules.read_text(encoding="utf-8")
