"""The panel in a real browser, on a real broker with users, with a daemon and a simulated drive."""

from __future__ import annotations

import json
import os
import signal
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

import paho.mqtt.publish as paho
import pytest
from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion
from playwright.sync_api import Page, WebSocketRoute, expect

from tests.scenes.panel.browser import PANEL as SCRIPTS
from tests.scenes.panel.browser import PATIENCE_MS, Panel, PanelSite
from tests.scenes.panel.conftest import MakePanel
from tests.scenes.system.site import PATIENT_DRIVE, publish, until
from tests.support import MosquittoLauncher, free_port, stop_process

pytestmark = pytest.mark.slow


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


def test_a_page_that_is_loaded_again_stays_logged_in_until_another_user_is_asked_for(
    operator: Panel,
) -> None:
    operator.page.reload()
    operator.expect_text(".age", "live")
    operator.page.get_by_role("link", name="all drives").click()
    operator.page.get_by_role("button", name="Other user").click()
    expect(operator.page.get_by_role("button", name="Log in")).to_be_visible()


def test_a_broker_without_users_asks_for_no_login(
    make_panel: MakePanel, tmp_path: Path, mosquitto_launcher: MosquittoLauncher
) -> None:
    port = free_port(socket.SOCK_STREAM)
    page = ("protocol websockets", f"http_dir {SCRIPTS}", "allow_anonymous true")
    listener = "\n".join((f"listener {port} 127.0.0.1", *page))
    launcher = MosquittoLauncher(mosquitto_launcher.program, tmp_path, listener)
    broker = launcher.start(free_port(socket.SOCK_STREAM))
    panel = make_panel()
    panel.page.goto(f"http://127.0.0.1:{port}/index.html")
    expect(panel.page.get_by_role("heading", name="Drives")).to_be_visible()
    panel.page.goto("about:blank")
    stop_process(broker)


def test_the_list_opens_a_drive_from_its_whole_row_and_stops_it(
    operator: Panel, panel_site: PanelSite
) -> None:
    panel_site.site.run_drive()
    operator.page.get_by_role("link", name="all drives").click()
    row = operator.page.get_by_role("row").filter(has_text="motor")
    expect(row).to_contain_text("running")
    row.get_by_role("button", name="STOP").click()
    operator.expect_text(".answer", "disable: accepted")
    expect(row).to_contain_text("standby")
    row.get_by_role("cell").nth(4).click(force=True)  # the link lies above it
    operator.expect_state("standby")


def test_plots_are_zoomed_by_a_drag_and_a_command_is_marked(operator: Panel) -> None:
    page = operator.page
    for mode in ("adaptive", "fixed"):
        page.get_by_role("button", name=mode, exact=True).click()
        operator.expect_text(".answer", f"mode {mode}: accepted")
    operator.expect_text(".key", "▸")
    operator.expect_text(".key", "fixed")
    plot = page.locator(".u-over").first
    plot.scroll_into_view_if_needed()
    place = plot.bounding_box()
    assert place is not None
    middle = place["y"] + place["height"] / 2
    page.mouse.move(place["x"] + 0.5 * place["width"], middle)
    page.mouse.down()
    page.mouse.move(place["x"] + 0.9 * place["width"], middle, steps=5)
    page.mouse.up()
    page.get_by_role("button", name="Show all").click()
    expect(page.get_by_role("button", name="Show all")).to_be_hidden()


@pytest.mark.parametrize("width", [390, 1280])
def test_nothing_is_wider_than_the_window_and_the_set_point_comes_before_the_numbers(
    operator: Panel, width: int
) -> None:
    page = operator.page
    page.set_viewport_size({"width": width, "height": 860})
    wide = page.evaluate("document.documentElement.scrollWidth")
    assert wide <= width
    field = page.get_by_label("set-point, V").bounding_box()
    numbers = page.locator(".details").bounding_box()
    assert field is not None
    assert numbers is not None
    assert field["y"] < numbers["y"] or field["x"] > numbers["x"]


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


def test_a_letter_that_chooses_a_shape_is_no_stop(operator: Panel, panel_site: PanelSite) -> None:
    panel_site.site.run_drive()
    operator.expect_state("running")
    operator.page.get_by_text("Waveform", exact=True).click()
    shape = operator.page.get_by_label("shape")
    shape.press("s")
    operator.page.get_by_role("button", name="fixed").click()  # whose answer comes after any other
    operator.expect_text(".answer", "mode fixed: accepted")
    expect(shape).to_have_value("sine")
    assert panel_site.site.state["state"] == "running"
    rest(panel_site)


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


def test_a_simulated_plant_is_disturbed_from_the_page(
    operator: Panel, make_panel: MakePanel, panel_site: PanelSite
) -> None:
    operator.page.get_by_role("button", name="add a disk").click()
    operator.expect_text(".answer", "add a disk: accepted")
    operator.page.get_by_role("button", name="remove a disk").click()
    operator.expect_text(".answer", "remove a disk: accepted")
    operator.page.get_by_role("button", name="remove a disk").click()
    operator.expect_text(".answer", "remove a disk: refused: disks = 0 must lie in 1…10")
    asked = [one["disks"] for one in panel_site.site.device_events("disturbed")]
    assert asked[-2:] == [1, -1]
    viewer = make_panel()
    viewer.log_in(panel_site.address, "viewer")
    viewer.open_drive()
    viewer.expect_text(".age", "live")
    expect(viewer.page.get_by_role("button", name="add a disk")).to_be_hidden()


def estimates(panel: Panel) -> list[str]:
    return [panel.value(name) for name in ("gain", "tau sum", "input offset")]


def test_a_trip_is_shown_with_its_remedy_and_reset(operator: Panel, panel_site: PanelSite) -> None:
    site = panel_site.site
    site.run_drive()
    operator.expect_state("running")
    site.kill(site.device)
    operator.expect_state("tripped")
    operator.expect_text(".alarm", "Trip: ")
    operator.expect_text(".alarm", "What to do: ")
    operator.expect_text(".age", "drive silent")
    operator.page.get_by_role("button", name="Reset trip").click()
    operator.expect_text(".answer", "refused: cause is still there")
    site.start_device("--initial-voltage", "280", *PATIENT_DRIVE)
    site.await_measurement()
    operator.page.get_by_role("button", name="Reset trip").click()
    operator.expect_state("standby")
    expect(operator.page.locator(".alarm")).to_be_hidden()


def test_what_was_lost_comes_back(operator: Panel, panel_site: PanelSite) -> None:
    site = panel_site.site
    site.kill(site.broker)
    operator.expect_text(".notice", "The broker cannot be reached")
    stop_in_vain(operator)
    restart_broker(operator, panel_site)
    site.kill(site.daemon)
    operator.expect_state("offline")
    site.start_daemon()
    operator.expect_state("standby")
    operator.expect_text(".age", "live")


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


def test_a_command_to_a_silent_drive_expires_by_the_clock_of_its_daemon(
    make_panel: MakePanel, panel_site: PanelSite
) -> None:
    """The machine of the page is an hour behind, and the daemon goes on without measurements."""
    panel, device = make_panel(), panel_site.site.device
    assert device is not None
    panel.page.add_init_script("Date.now = ((now) => () => now() - 3_600_000)(Date.now);")
    panel.log_in(panel_site.address, "operator")
    panel.open_drive()
    panel.expect_text(".age", "live")
    os.kill(device.pid, signal.SIGSTOP)
    try:
        panel.expect_text(".age", "drive silent")
        panel.page.get_by_role("button", name="fixed").click()
        panel.expect_text(".answer", "mode fixed: accepted")
    finally:
        os.kill(device.pid, signal.SIGCONT)
        rest(panel_site)


def test_nothing_is_asked_of_a_drive_that_is_not_heard(
    operator: Panel, panel_site: PanelSite
) -> None:
    """A frozen daemon hears what was asked meanwhile when it goes on."""
    with panel_site.site.stalled(panel_site.site.daemon):
        operator.expect_text(".age", "no data")
        operator.page.get_by_role("button", name="fixed").click()
        operator.expect_text(".answer", "mode fixed: not sent: the drive is not heard")
    rest(panel_site)


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


def stop_over_a_lost_network(make_panel: MakePanel, panel_site: PanelSite) -> tuple[Panel, Network]:
    """Press STOP while nothing passes between the page and its broker."""
    panel = make_panel()
    network = Network(panel.page)
    panel.log_in(panel_site.address, "operator")
    panel.open_drive()
    panel_site.site.run_drive()
    panel.expect_state("running")
    network.lost = True
    panel.page.get_by_role("button", name="STOP").click()
    panel.expect_text(".answer", "disable: no answer within 5 s")
    return panel, network


def test_a_stop_that_a_silent_network_has_lost_is_sent_again(
    make_panel: MakePanel, panel_site: PanelSite
) -> None:
    """The page itself ends a connection on which nothing more comes."""
    panel, network = stop_over_a_lost_network(make_panel, panel_site)
    expect(panel.page.locator(".notice")).to_be_visible(timeout=PATIENCE_MS)
    assert panel_site.site.state["state"] == "running"
    network.lost = False
    panel.expect_state("standby")


def test_a_stop_without_an_answer_is_sent_again_on_the_same_connection(
    make_panel: MakePanel, panel_site: PanelSite
) -> None:
    """Too short a loss for the page to end its connection: MQTT alone does not send it again."""
    panel, network = stop_over_a_lost_network(make_panel, panel_site)
    network.lost = False
    panel.expect_state("standby")


def test_an_address_that_names_no_drive_leaves_the_page_alive(operator: Panel) -> None:
    operator.page.evaluate("location.hash = '#100%'")
    operator.expect_state("unknown")
    operator.page.evaluate("location.hash = '#motor'")
    operator.expect_text(".age", "live")


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


def open_deaf(operator: Panel, port: int) -> None:
    """Open a drive that publishes and answers nothing, until the page names that."""
    publish(port, "adaptdrive/deaf/availability", "online")
    operator.page.get_by_role("link", name="all drives").click()
    operator.open_drive("deaf")

    def names_it() -> bool:
        hostile(port, "adaptdrive/deaf/telemetry/drive", {"time": NOW, "age_s": 0.0})
        return operator.page.get_by_text("No command is answered.").is_visible()

    until(names_it, "the page names why no command is answered", 60.0)


def test_a_drive_that_answers_no_command_is_shown_with_both_causes(
    operator: Panel, panel_site: PanelSite
) -> None:
    port = panel_site.site.broker_port
    open_deaf(operator, port)
    viewer = operator.page.locator(".viewer")
    expect(viewer).to_contain_text("this user may look and not command")
    expect(viewer).to_contain_text("the daemon receives no commands")
    publish(port, "adaptdrive/deaf/availability", "offline")


def test_the_controls_come_back_with_the_first_answer(
    operator: Panel, panel_site: PanelSite
) -> None:
    port = panel_site.site.broker_port
    open_deaf(operator, port)
    expect(operator.page.get_by_role("button", name="Enable")).to_be_hidden()
    with answering(port, "deaf"):
        expect(operator.page.locator(".viewer")).to_be_hidden(timeout=PATIENCE_MS)
        expect(operator.page.get_by_role("button", name="Enable")).to_be_visible()
    publish(port, "adaptdrive/deaf/availability", "offline")


@contextmanager
def answering(port: int, drive: str) -> Iterator[None]:
    """Accept each command of a drive, as its daemon does."""

    def answer(client: Client, _: object, message: MQTTMessage) -> None:
        reply = {"id": json.loads(message.payload)["id"], "accepted": True, "reason": ""}
        client.publish(f"adaptdrive/{drive}/reply", json.dumps(reply), qos=1)

    client = Client(CallbackAPIVersion.VERSION2)
    client.on_message = answer
    client.connect("127.0.0.1", port)
    client.subscribe(f"adaptdrive/{drive}/command/+", qos=1)
    client.loop_start()
    try:
        yield
    finally:
        client.disconnect()
        client.loop_stop()


def test_a_gain_has_the_unit_of_the_output_for_each_volt(
    operator: Panel, panel_site: PanelSite
) -> None:
    port = panel_site.site.broker_port
    operator.page.get_by_role("link", name="all drives").click()
    output = {"name": "speed", "unit": "rad/s"}
    load = {"time": NOW, "estimates": {"gain": {"value": 0.3, "std": 0.01}}}
    publish(port, "adaptdrive/fan/availability", "online")
    hostile(port, "adaptdrive/fan/state", {"time": NOW, "state": "running", "output": output})
    hostile(port, "adaptdrive/fan/telemetry/load", load)
    operator.open_drive("fan")
    operator.expect_text(".details .values", "(rad/s)/V")
    operator.expect_text("#panel", "estimate: gain, (rad/s)/V")
    publish(port, "adaptdrive/fan/availability", "offline")


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


MARKUP = "<img src=x onerror=alert(1)><script>alert(2)</script>"
KEYS = {
    "state": (
        "state",
        "mode",
        "controller",
        "reason",
        "trip",
        "stop",
        "time",
        "since",
        "clock",
        "waveform",
    ),
    "telemetry/load": ("time", "output", "reference", "estimates", "controller", "reason"),
    "telemetry/drive": ("time", "output", "bus", "sensors", "lateness_us", "ticks"),
    "event": ("time", "kind", "severity", "detail"),
    "history": ("rows", "time"),
}
NOW = "2026-11-22T00:00:00Z"
ODD: tuple[Any, ...] = (MARKUP, 5, None, [], {}, {MARKUP: MARKUP}, [MARKUP], 1e308, NOW, True)


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
    trip = {"time": MARKUP, "text": MARKUP, "remedy": MARKUP}
    state = {
        "state": MARKUP,
        "time": NOW,
        "trip": MARKUP,
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


def hostile(port: int, topic: str, content: object) -> None:
    hostile_raw(port, topic, json.dumps(content).encode())


def hostile_raw(port: int, topic: str, payload: bytes) -> None:
    paho.single(topic, payload, qos=1, hostname="127.0.0.1", port=port)


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


def test_a_page_opened_late_shows_the_last_hour(
    make_panel: MakePanel, panel_site: PanelSite
) -> None:
    site = panel_site.site
    site.run_drive()
    site.demand("setpoint", 3.0)  # below its reach the drive coasts, without slow steps
    site.let_periods_pass(14)  # past a boundary of the 12 s in which two are kept
    opened_s = time.time()
    panel = make_panel()
    panel.log_in(panel_site.address, "viewer")
    panel.open_drive()
    # one row is the retained message
    until(lambda: rows_before(panel, opened_s) > 1, "the page shows the past")
    rest(panel_site)


def rows_before(panel: Panel, time_s: float) -> int:
    """Count the slow steps on the page that are older than a time."""
    times = panel.page.evaluate("() => Drives.named('motor').slowRows.map(row => row.time)")
    return sum(datetime.fromisoformat(one).timestamp() < time_s for one in times)
