"""Hostile payloads on each topic that the page reads; the long form is a benchmark."""

from __future__ import annotations

import json

import pytest

from tests.scenes.panel.browser import PanelSite
from tests.scenes.panel.conftest import MakePanel
from tests.scenes.panel.storm import (
    EVIL,
    NOW,
    log_in,
    marked,
    marked_messages,
    require_unhurt,
    show,
    storm,
)
from tests.scenes.system.site import publish

pytestmark = pytest.mark.slow

SEED = 7
PAYLOADS = 150
ON_LIST_ONLY = marked("state.mode")
"""The page of a drive shows the reason why another controller is in force in its place."""


def test_hostile_payloads_neither_run_nor_freeze_nor_break_the_page(
    make_panel: MakePanel, panel_site: PanelSite
) -> None:
    panel = make_panel()
    log_in(panel, panel_site.address)
    with storm(panel, panel_site.site.broker_port, SEED) as blast:
        for place in (EVIL, "", EVIL):
            show(panel, place)
            blast.blow(PAYLOADS)
            show(panel, place)
            require_unhurt(panel)
        panel.page.get_by_role("button", name="STOP").click()
        panel.expect_text(".answer", "disable: ")
    show(panel, "motor")
    panel.expect_text(".age", "live")
    require_unhurt(panel)


def test_markup_in_each_field_is_shown_as_text(
    make_panel: MakePanel, panel_site: PanelSite
) -> None:
    port = panel_site.site.broker_port
    panel = make_panel()
    log_in(panel, panel_site.address)
    show(panel, "marked")
    publish(port, "adaptdrive/marked/availability", "online")
    for name, message in marked_messages().items():
        publish(port, f"adaptdrive/marked/{name}", json.dumps(message))
        for field in fields_of(message):
            if field != ON_LIST_ONLY:
                panel.expect_text("#panel", field)
    rows = [{"time": NOW, "estimates": {marked("past"): {"value": 1, "std": 1}}}]
    publish(port, "adaptdrive/marked/history", json.dumps({"rows": rows}))
    publish(port, "adaptdrive/marked/availability", marked(""))
    panel.expect_text(".chip", marked("")[:20])
    show(panel, "")
    panel.expect_text("table", ON_LIST_ONLY)
    panel.expect_text("table", marked("")[:20])
    require_unhurt(panel)


def fields_of(message: object) -> list[str]:
    """All markup in a message, keys included."""
    if isinstance(message, dict):
        return [found for pair in message.items() for one in pair for found in fields_of(one)]
    return [message] if isinstance(message, str) and message.startswith("<") else []
