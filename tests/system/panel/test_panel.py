"""The panel in a real browser, on a real broker with users, with a daemon and a simulated drive."""

from __future__ import annotations

import json
import os
import signal
from datetime import datetime
from typing import Any

import paho.mqtt.publish as paho
import pytest
from playwright.sync_api import Page, WebSocketRoute, expect

from adaptdrive.mqtt import contract
from tests.system.daemon.site import publish, until
from tests.system.panel.browser import PATIENCE_MS, Panel, PanelSite, violations
from tests.system.panel.conftest import MakePanel
from tests.unit.mqtt.peers import HEALTH, WORN


@pytest.fixture
def operator(make_panel: MakePanel, panel_site: PanelSite) -> Panel:
    panel = make_panel()
    panel.log_in(panel_site.address, "operator")
    panel.open_drive()
    panel.expect_text(".age", "live")
    return panel


def rest(panel_site: PanelSite) -> None:
    """Leave the drive in standby, whatever the test did; a busy machine may refuse a `reset`."""
    panel_site.site.ask("disable")

    def at_rest() -> bool:
        panel_site.site.ask("reset")
        return bool(panel_site.site.state["state"] == "standby")

    try:
        until(at_rest, "standby")
    except AssertionError as problem:
        raise AssertionError(f"{problem}; it is {panel_site.site.state}") from None


def stop_in_vain(operator: Panel) -> None:
    """Press STOP while there is no broker."""
    operator.page.get_by_role("button", name="STOP").click()
    operator.expect_text(".answer", "disable: not sent: no broker")


def restart_broker(operator: Panel, panel_site: PanelSite) -> None:
    """Start the broker again, and wait until page and daemon are connected to it."""
    panel_site.site.start_broker()
    expect(operator.page.locator(".notice")).to_be_hidden(timeout=PATIENCE_MS)
    panel_site.site.await_availability("online")
    operator.expect_text(".age", "live")


def test_a_wrong_password_is_refused(make_panel: MakePanel, panel_site: PanelSite) -> None:
    panel = make_panel()
    panel.log_in(panel_site.address, "operator", "guess")
    panel.expect_text(".answer", "refuses")
    panel.log_in(panel_site.address, "operator")
    expect(panel.page.get_by_role("heading", name="Drives")).to_be_visible()


def test_an_axis_shows_the_range_of_its_limits(
    make_panel: MakePanel, panel_site: PanelSite
) -> None:
    page = make_panel().page
    page.goto(panel_site.address)
    shown = "([limits, low, high]) => Plots.reach(() => limits)(null, low, high)"
    for limits, values, wanted in (
        ([0, 14], (0, 7), [0, 14]),
        ([0, 14], (7, 7), [0, 14]),  # a constant has no scale of its own
        ([0, 14], (None, None), [0, 14]),
        ([0, 14], (-0.1, 15), [-0.1, 15]),
        (None, (7, 7), [6.3, 7.7]),
    ):
        assert page.evaluate(shown, [limits, *values]) == pytest.approx(wanted)
    low, high = page.evaluate(shown, [[0, 14], 3.0, 4.0])  # a step that would hardly be seen
    assert 2.0 <= low < 3.0
    assert 4.0 < high <= 5.0


def test_an_operator_runs_the_drive_and_sees_the_estimate_move(
    operator: Panel, panel_site: PanelSite
) -> None:
    page = operator.page
    operator.expect_state("standby")
    page.get_by_role("button", name="Enable").click()
    operator.expect_state("standby")  # one press energises nothing
    page.get_by_role("button", name="Enable: press again").click()
    operator.expect_state("running")
    operator.expect_text(".answer", "enable: accepted")
    page.get_by_role("button", name="adaptive").click()
    expect(page.get_by_role("button", name="adaptive")).to_have_attribute("aria-pressed", "true")
    page.get_by_label("set-point, V").fill("9")
    page.get_by_label("set-point, V").evaluate("field => { field.form.noValidate = true; }")
    page.get_by_role("button", name="Set", exact=True).first.click()
    operator.expect_text(".answer", "refused: setpoint = 9 V is outside")
    page.get_by_label("set-point, V").fill("3.2")
    expect(page.locator(".answer")).to_be_empty()  # it was about the other value
    assert page.locator(".range small").all_inner_texts() == ["0", "4.5"]
    page.get_by_role("button", name="Set", exact=True).first.click()
    operator.expect_text(".answer", "setpoint 3.2: accepted")
    first = estimates(operator)
    until(lambda: estimates(operator) != first, "the estimates move", 60.0)
    expect(page.locator("figure.plot canvas").first).to_be_visible()
    assert panel_site.site.state["setpoint"] == 3.2
    page.keyboard.press("Escape")
    page.locator("h1").click()
    page.keyboard.press("s")
    operator.expect_state("standby")


def estimates(panel: Panel) -> list[str]:
    return [panel.value(name) for name in ("gain", "tau sum", "input offset")]


def test_a_trip_is_shown_with_its_remedy_and_reset(operator: Panel, panel_site: PanelSite) -> None:
    site = panel_site.site
    site.run_drive()
    operator.expect_state("running")
    site.kill(site.device)
    operator.expect_state("tripped")
    tripped = datetime.fromisoformat(site.state["last_trip"]["time"]).astimezone()
    operator.expect_text(".alarm", f"Trip, {tripped:%Y-%m-%d %H:%M:%S}: ")
    expect(operator.page.locator(".latest li").filter(has_text="stale").first).to_be_in_viewport()
    operator.expect_text(".alarm .kind", "no-message")
    explained = "kind of this trip: adaptdrive explain no-message"
    expect(operator.page.locator(".alarm .kind")).to_have_attribute("title", explained)
    expect(operator.page.locator(".latest .kind").first).to_have_text("no-message")
    operator.expect_text(".alarm", "What to do: ")
    operator.expect_text(".age", "drive silent")
    operator.page.locator(".alarm").get_by_role("button", name="Reset trip").click()
    operator.expect_text(".answer", "refused: cause is still there")
    site.start_device("--initial-voltage", "280")
    site.await_measurement()
    operator.page.get_by_role("button", name="Reset trip").click()
    operator.expect_state("standby")
    expect(operator.page.locator(".alarm")).to_be_hidden()


def test_what_was_asked_before_a_loss_of_the_broker_does_not_act_after_it(
    operator: Panel, panel_site: PanelSite
) -> None:
    """The broker hangs and dies with the enable; STOP is pressed before the page is back."""
    site = panel_site.site
    assert site.broker is not None
    os.kill(site.broker.pid, signal.SIGSTOP)
    for name in ("Enable", "Enable: press again"):
        operator.page.get_by_role("button", name=name, exact=True).click()
    site.kill(site.broker)
    operator.expect_text(".answer", "enable: no answer: the connection to the broker was lost")
    stop_in_vain(operator)
    restart_broker(operator, panel_site)
    operator.page.get_by_role("button", name="fixed").click()  # after what would be sent again
    operator.expect_text(".answer", "mode fixed: accepted")
    assert not site.state["enabled"]
    operator.expect_state("standby")


class Network:
    """The way of a page to its broker, which can lose all that is sent."""

    def __init__(self, page: Page) -> None:
        self.lost = False
        page.route_web_socket("**", self._join)

    def _join(self, page: WebSocketRoute) -> None:
        broker = page.connect_to_server()
        page.on_message(lambda message: self._pass(broker, message))
        broker.on_message(lambda message: self._pass(page, message))

    def _pass(self, to: WebSocketRoute, message: str | bytes) -> None:
        if not self.lost:
            to.send(message)


def test_a_viewer_sees_everything_and_changes_nothing(
    make_panel: MakePanel, panel_site: PanelSite
) -> None:
    panel_site.site.run_drive()
    panel_site.site.demand("setpoint", 3.0)  # below its reach the drive coasts, without slow steps
    panel = make_panel()
    panel.log_in(panel_site.address, "viewer")
    panel.open_drive()
    panel.expect_state("running")
    expect(panel.page.get_by_text("This user may look and not command.")).to_be_visible()
    expect(panel.page.get_by_role("button", name="Enable")).to_be_hidden()
    panel.page.get_by_role("button", name="STOP").click()
    panel.expect_text(".answer", "disable: not allowed for this user")
    known = len(panel_site.site.ear.on("telemetry/load"))
    panel_site.site.ear.next_on("telemetry/load", after=known)
    assert panel_site.site.state["state"] == "running"
    assert panel_site.site.state["enabled"]
    rest(panel_site)


MARKUP = "<img src=x onerror=alert(1)><script>alert(2)</script>"
KEYS = {
    "health": ("time", "quantities", "times_s", "courses"),
    "state": (
        "state",
        "mode",
        "controller",
        "reason",
        "trip",
        "trip_kind",
        "stop",
        "time",
        "since",
        "clock",
        "waveform",
    ),
    "telemetry/load": ("time", "output", "reference", "estimates", "controller", "reason"),
    "telemetry/drive": ("time", "output", "bus", "sensors", "lateness_us", "ticks"),
    "event": ("time", "kind", "severity", "detail", "trip_kind"),
    "history": ("rows", "time"),
}
NOW = "2026-11-22T00:00:00Z"
ODD: tuple[Any, ...] = (MARKUP, 5, None, [], {}, {MARKUP: MARKUP}, [MARKUP], 1e308, NOW, True)


def hostile(port: int, topic: str, content: object) -> None:
    hostile_raw(port, topic, json.dumps(content).encode())


def hostile_raw(port: int, topic: str, payload: bytes) -> None:
    paho.single(topic, payload, qos=1, hostname="127.0.0.1", port=port)


@pytest.mark.proof
def test_the_stop_key_stops_from_a_field_of_a_number_and_with_caps_lock(
    operator: Panel, panel_site: PanelSite
) -> None:
    setpoint = operator.page.get_by_label("set-point, V")
    for key in ("s", "S"):
        panel_site.site.run_drive()
        operator.expect_state("running")
        setpoint.fill("3.2")
        setpoint.press("Enter")
        operator.expect_text(".answer", "setpoint 3.2: accepted")
        setpoint.press(key)
        operator.expect_state("standby")
        expect(setpoint).to_have_value("3.2")


@pytest.mark.proof
def test_a_double_click_and_a_held_key_are_one_press(
    operator: Panel, panel_site: PanelSite
) -> None:
    keyboard = operator.page.keyboard
    enable, again = (
        operator.page.get_by_role("button", name=name, exact=True)
        for name in ("Enable", "Enable: press again")
    )
    enable.dblclick()
    expect(again).to_be_visible()
    again.click()
    operator.expect_state("running")
    rest(panel_site)
    operator.expect_state("standby")  # a slow page would show the run before, and enable after it
    enable.focus()
    for _ in range(3):
        keyboard.down("Enter")
    keyboard.up("Enter")
    expect(again).to_be_visible()
    keyboard.press("Enter")
    operator.expect_state("running")
    rest(panel_site)


@pytest.mark.proof
def test_nothing_is_asked_of_a_drive_that_is_not_heard(
    operator: Panel, panel_site: PanelSite
) -> None:
    """A frozen daemon hears what was asked meanwhile when it goes on."""
    with panel_site.site.stalled(panel_site.site.daemon):
        operator.expect_text(".age", "no data")
        operator.page.get_by_role("button", name="fixed").click()
        operator.expect_text(".answer", "mode fixed: not sent: the drive is not heard")
    rest(panel_site)


@pytest.mark.proof
def test_a_stop_that_a_silent_network_has_lost_is_sent_again(
    make_panel: MakePanel, panel_site: PanelSite
) -> None:
    """The page itself ends a connection on which nothing more comes."""
    panel = make_panel()
    network = Network(panel.page)
    panel.log_in(panel_site.address, "operator")
    panel.open_drive()
    panel_site.site.run_drive()
    panel.expect_state("running")
    network.lost = True
    panel.page.get_by_role("button", name="STOP").click()
    panel.expect_text(".answer", "disable: no answer within 5 s")
    expect(panel.page.locator(".notice")).to_be_visible(timeout=PATIENCE_MS)
    assert panel_site.site.state["state"] == "running"
    network.lost = False
    panel.expect_state("standby")


@pytest.mark.proof
def test_a_drive_that_has_not_confirmed_its_stop_is_not_shown_as_off(
    operator: Panel, panel_site: PanelSite
) -> None:
    port = panel_site.site.broker_port
    operator.page.get_by_role("link", name="all drives").click()
    publish(port, "adaptdrive/lost/availability", "online")
    hostile(port, "adaptdrive/lost/state", {"time": NOW, "state": "standby", "stop": "awaited"})
    row = operator.page.get_by_role("row").filter(
        has=operator.page.get_by_role("link", name="lost")
    )
    expect(row).to_contain_text("standby, stop awaited")
    operator.open_drive("lost")
    expect(operator.page.locator(".chip")).to_have_text("standby")
    open_stop = operator.page.locator(".unconfirmed")
    expect(open_stop).to_have_text("stop awaited: the bridge is not reported off")
    hostile(port, "adaptdrive/lost/state", {"time": NOW, "state": "standby", "stop": "confirmed"})
    expect(open_stop).to_have_text("")
    publish(port, "adaptdrive/lost/availability", "offline")


def test_the_health_of_the_load_is_plotted_with_what_it_means(
    operator: Panel, panel_site: PanelSite
) -> None:
    health = contract.health_message(HEALTH) | {"quantities": {"friction": WORN}}
    hostile_raw(panel_site.site.broker_port, "adaptdrive/motor/health", contract.encode(health))
    operator.page.get_by_text("dry friction and load torque up 1 ± 0.04 % a week").wait_for()
    plot = operator.page.locator("figure", has_text="health: change since the first days")
    assert plot.locator("canvas").count() == 1
    assert plot.locator(".u-legend").inner_text().count("friction") == 1


@pytest.mark.proof
def test_no_payload_becomes_a_script_or_stops_the_page(
    operator: Panel, panel_site: PanelSite
) -> None:
    site = panel_site.site
    operator.page.get_by_role("link", name="all drives").click()
    for drive in ("evil", "motor"):
        for topic, keys in KEYS.items():
            for odd in ODD:
                hostile(site.broker_port, f"adaptdrive/{drive}/{topic}", dict.fromkeys(keys, odd))
    for raw in (b"", b"\xc3\xa9", b"[]", b"null", b'"x"', MARKUP.encode(), b"{" * 5000):
        for topic in (*KEYS, "availability", "reply"):
            hostile_raw(site.broker_port, f"adaptdrive/evil/{topic}", raw)
    publish(site.broker_port, "adaptdrive/evil/availability", "online")
    limits = {"setpoint": [MARKUP, {}], "pole": 7, "boost_V": None}
    trip = {"time": MARKUP, "kind": MARKUP, "text": MARKUP, "remedy": MARKUP}
    state = {
        "state": MARKUP,
        "time": NOW,
        "trip": MARKUP,
        "trip_kind": MARKUP,
        "last_trip": trip,
        "limits": limits,
        "modes": [MARKUP],
    }
    hostile(site.broker_port, "adaptdrive/evil/state", state | {"output": {"unit": MARKUP}})
    operator.page.get_by_role("link", name="evil").click()
    operator.page.get_by_text(MARKUP).first.wait_for()
    assert operator.page.locator("img, script[src='x'], #panel script").count() == 0
    operator.page.get_by_role("link", name="all drives").click()
    operator.open_drive()
    site.stop_daemon()
    site.start_daemon()
    operator.expect_state("standby")
    operator.expect_text(".age", "live")


@pytest.mark.proof
@pytest.mark.parametrize("width", [360, 1280, 3840])
def test_nothing_is_cut_off_at_any_width(
    make_panel: MakePanel, panel_site: PanelSite, width: int
) -> None:
    panel = make_panel(viewport={"width": width, "height": 900})
    panel.log_in(panel_site.address, "operator")
    panel.open_drive()
    panel.expect_text(".age", "live")
    assert panel.page.evaluate("document.documentElement.scrollWidth") <= width
    large = panel.page.locator(".large")
    assert large.evaluate("one => one.scrollWidth <= one.clientWidth")
    stop = panel.page.get_by_role("button", name="STOP").bounding_box()
    assert stop is not None
    assert stop["x"] + stop["width"] <= width
    assert stop["y"] + stop["height"] <= 900
    assert stop["height"] >= 44


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


def test_a_program_is_shown_with_its_step_and_turned_by_hand(
    operator: Panel, panel_site: PanelSite
) -> None:
    site = panel_site.site
    site.run_drive()
    steps = [{"do": "ramp", "to": 3.2, "slope": 5.0}, {"do": "hold", "for_s": 7200.0}]
    site.demand("program", {"name": "bath", "steps": [*steps, *steps]})
    row = operator.page.locator(".now .values div").filter(has_text="program bath")
    expect(row).to_contain_text("step 2 of 4: hold for 7200 s", timeout=PATIENCE_MS)
    expect(row).to_contain_text("left")
    operator.page.locator("summary", has_text="Program").click()
    operator.page.get_by_role("button", name="Pause").click()
    expect(row).to_contain_text("bath paused", timeout=PATIENCE_MS)
    operator.page.get_by_role("button", name="End program").click()
    expect(row).to_contain_text("ended: stopped", timeout=PATIENCE_MS)
    rest(panel_site)
