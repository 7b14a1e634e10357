"""The page under the rules of axe-core: contrast, labels, structure; in light, dark, both sizes."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.scenes.panel.browser import Panel, PanelSite
from tests.scenes.panel.conftest import MakePanel

pytestmark = pytest.mark.slow

SIZES = ((1280, 860), (360, 740))
JUDGE = """async () => (await axe.run(document)).violations.flatMap(
  one => one.nodes.map(node => `${one.id}: ${node.target}: ${node.failureSummary}`))"""


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


def test_everybody_can_read_and_operate_the_page(
    make_panel: MakePanel, panel_site: PanelSite, axe: str
) -> None:
    panel, site = make_panel(), panel_site.site
    panel.page.goto(panel_site.address)
    assert violations(panel, axe) == []
    panel.fill_in("operator")
    panel.page.get_by_role("heading", name="Drives").wait_for()
    assert violations(panel, axe) == []
    panel.open_drive()
    panel.expect_text(".age", "live")
    for summary in panel.page.locator("summary").all():
        summary.click()
    panel.page.get_by_role("button", name="Set", exact=True).last.click()
    assert violations(panel, axe) == []
    with site.stalled(site.daemon):
        panel.expect_text(".age", "no data")
        assert violations(panel, axe) == []
