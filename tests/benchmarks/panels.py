"""Twenty drives at ten messages a second in five browsers: what broker, page and daemon pay.

One drive is real: a daemon with a simulated drive. The others repeat its messages.
The same drives without a browser are what the daemon's late ticks are held against.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from playwright.sync_api import Browser, CDPSession

from tests.benchmarks.rows import Extent, Row
from tests.benchmarks.tools import cpu_s, process
from tests.panel.browser import Panel, browser_of, open_panel, panel_site_in
from tests.system.site import Site

DRIVES = 20
PLACES = ("", "", "", "#motor", "#replica3")
"""What the browsers show: three the list, two a drive."""

SETTLE_S = 5.0
LIMIT = 30.0


@dataclass(frozen=True)
class Cost:
    """CPU shares in percent of one processor, and ticks, over some time.

    Attributes:
        broker: Of the broker.
        page: Of the main thread of each page: messages, scripts, layout and style.
        browser: Of all processes of each browser, with raster and compositor without a GPU.
        late: Missed and stand-in ticks of the real daemon.
    """

    broker: float
    page: list[float]
    browser: list[float]
    late: int


def rows(extent: Extent) -> Iterator[Row]:
    """All rows of this file."""
    seconds = extent.pick(60.0, 10.0, 2.0)
    places = extent.pick(PLACES, PLACES, PLACES[2:4])
    alone, watched = measure(seconds, places)
    target = f"less than {LIMIT:.0f} %"
    name = f"CPU share of a broker of {DRIVES} drives and {len(places)} panels"
    yield Row(name, watched.broker, "%", alone.broker, "no panel", target, watched.broker < LIMIT)
    for place, page, browser in zip(places, watched.page, watched.browser, strict=True):
        shown = f"the page of {place[1:]}" if place else "the list"
        note = f"all processes of the browser, which draws without a GPU: {browser:.1f} %"
        name = f"CPU share of a panel that shows {shown}, {DRIVES} drives"
        yield Row(name, page, "%", target=target, met=page < LIMIT, note=note)
    note = f"in {seconds:.0f} s each; missed and stand-in ticks"
    name = "late ticks of a daemon that is watched"
    yield Row(name, watched.late, "", alone.late, "no panel", "none more", note=note)


def measure(seconds: float, places: tuple[str, ...]) -> tuple[Cost, Cost]:
    """Return the cost without panels, and with them."""
    with TemporaryDirectory() as name, ExitStack() as stack:
        found = stack.enter_context(panel_site_in(Path(name), "/usr/sbin/mosquitto"))
        site = found.site
        site.run_drive()
        replicas = [sys.executable, "-m", "tests.benchmarks.replicas", str(site.broker_port)]
        stack.enter_context(process([*replicas, "motor", str(DRIVES - 1)]))
        time.sleep(SETTLE_S)
        alone = _measure(site, [], seconds)
        first = stack.enter_context(browser_of("/usr/bin/chromium"))
        more = [stack.enter_context(_another(first)) for _ in places[1:]]
        browsers = zip((first, *more), places, strict=True)
        meters = [Meter(one, found.address, place) for one, place in browsers]
        time.sleep(SETTLE_S)
        return alone, _measure(site, meters, seconds)


@contextmanager
def _another(browser: Browser) -> Iterator[Browser]:
    """Start another browser of the same program."""
    kind = browser.browser_type
    started = kind.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
    yield started
    started.close()


class Meter:
    """One browser with one panel, and the CPU time that both have used."""

    def __init__(self, browser: Browser, address: str, place: str) -> None:
        self._panel: Panel = open_panel(browser)
        self._panel.log_in(address, "operator")
        self._panel.page.get_by_role("link", name="motor", exact=True).wait_for()
        self._panel.page.evaluate("place => { location.hash = place; }", place)
        context = self._panel.page.context
        self._page: CDPSession = context.new_cdp_session(self._panel.page)
        self._page.send("Performance.enable")
        self._browser: CDPSession = browser.new_browser_cdp_session()

    def page_s(self) -> float:
        """CPU time of the page's main thread."""
        found = self._page.send("Performance.getMetrics")["metrics"]
        return float(next(one["value"] for one in found if one["name"] == "TaskDuration"))

    def browser_s(self) -> float:
        """CPU time of all processes of the browser."""
        found = self._browser.send("SystemInfo.getProcessInfo")["processInfo"]
        return sum(cpu_s(one["id"]) for one in found)


def _measure(site: Site, panels: list[Meter], seconds: float) -> Cost:
    assert site.broker is not None
    broker = site.broker.pid

    def used() -> list[float]:
        pages, browsers = (one.page_s() for one in panels), (one.browser_s() for one in panels)
        return [cpu_s(broker), *pages, *browsers]

    late, before, began_s = _late(site), used(), time.monotonic()
    time.sleep(seconds)
    passed_s = time.monotonic() - began_s
    shares = [100.0 * (now - then) / passed_s for now, then in zip(used(), before, strict=True)]
    count = len(panels)
    return Cost(
        broker=shares[0],
        page=shares[1 : count + 1],
        browser=shares[count + 1 :],
        late=_late(site) - late,
    )


def _late(site: Site) -> int:
    """Missed and stand-in ticks of the daemon so far."""
    newest = site.ear.on("telemetry/drive")[-1].content
    return int(newest["missed"]) + int(newest["held"])
