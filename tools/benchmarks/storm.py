"""A storm of hostile payloads on the page of one user, and what the page must still be afterwards.

The payloads enter the page where its MQTT library hands messages over. A broker would be what is
measured: mosquitto 2.0.11 sends a few large payloads a second over a WebSocket.
"""

from __future__ import annotations

import base64
import json
import random
from collections.abc import Iterator
from contextlib import contextmanager

from paho.mqtt import client as paho
from paho.mqtt.enums import CallbackAPIVersion

from tests.system.panel.browser import Panel
from tools.benchmarks.hostile import READ, Hostile

EVIL = "evil"
"""A drive without a daemon: all that is heard of it is hostile."""

AT_ONCE = 50
SETTLE_MS = 300
"""Longer than the page takes to draw again."""

CAPTURE = """() => {
  const connect = mqtt.connect;
  window.mqtt = { connect: (...options) => (window.wire = connect(...options)) };
  let last = performance.now();
  window.longestBlock_ms = 0;
  setInterval(() => {
    const now = performance.now();
    window.longestBlock_ms = Math.max(window.longestBlock_ms, now - last - 20);
    last = now;
  }, 20);
}"""
"""Keeps the client of the MQTT library, and the longest time for which the page's loop stood."""

DELIVER = """batch => {
  for (const [topic, body, retain] of batch) {
    const payload = Uint8Array.from(atob(body), letter => letter.charCodeAt(0));
    window.wire.emit("message", topic, payload, { retain });
  }
}"""
FOREIGN = "script:not([src]), img, iframe, svg, object, embed, style, a[href^='javascript' i]"
"""Elements that the page does not make."""

ODD_DRIVES = ("<b>x</b>", "evil drive", "é", "x" * 65, "__proto__", "constructor")


class Storm:
    """Hostile payloads of a seed for the page of one user."""

    def __init__(self, panel: Panel, seed: int) -> None:
        self._panel = panel
        self._hostile = Hostile(seed)
        self._chance = random.Random(seed)

    def blow(self, count: int) -> None:
        """Deliver so many payloads; the page may draw after each batch."""
        for start in range(0, count, AT_ONCE):
            batch = [self._message() for _ in range(min(AT_ONCE, count - start))]
            self._panel.page.evaluate(DELIVER, batch)

    def _message(self) -> tuple[str, str, bool]:
        name = self._chance.choice(READ)
        drive = self._chance.choice(ODD_DRIVES) if self._chance.random() < 0.02 else EVIL
        body = base64.b64encode(self._hostile.draw(name)).decode()
        root = "adaptdrive-sim" if name.startswith("simulator/") else "adaptdrive"
        topic = f"{root}/{drive}/{name.removeprefix('simulator/')}"
        return topic, body, self._chance.random() < 0.1

    def answer(self, client: paho.Client, _: object, message: paho.MQTTMessage) -> None:
        """Answer a command of the page by its id, with an odd reply."""
        reply = {"id": json.loads(message.payload)["id"], "accepted": self._chance.random() < 0.5}
        reply |= {key: self._hostile.odd() for key in ("reason", "verb", "state")}
        client.publish(f"adaptdrive/{EVIL}/reply", json.dumps(reply), qos=1)


@contextmanager
def storm(panel: Panel, port: int, seed: int) -> Iterator[Storm]:
    """Prepare a storm on a page that is logged in on a broker, which also answers its commands."""
    blast = Storm(panel, seed)
    client = paho.Client(CallbackAPIVersion.VERSION2)
    client.on_message = blast.answer
    client.connect("127.0.0.1", port)
    client.subscribe(f"adaptdrive/{EVIL}/command/#", qos=1)
    client.loop_start()
    try:
        yield blast
    finally:
        client.disconnect()
        client.loop_stop()


def log_in(panel: Panel, address: str) -> None:
    """Log in, with the page's connection and the rhythm of its loop observed."""
    panel.page.goto(address)
    panel.page.evaluate(CAPTURE)
    panel.fill_in("operator")
    panel.page.get_by_role("heading", name="Drives").wait_for()


def show(panel: Panel, place: str) -> None:
    """Show the list, or the page of a drive, as its address does, and let it draw."""
    panel.page.evaluate("place => { location.hash = place; }", place)
    panel.page.evaluate("ms => new Promise(done => setTimeout(done, ms))", SETTLE_MS)


def require_unhurt(panel: Panel) -> None:
    """Require that nothing was executed, and that no element came from a payload."""
    assert panel.errors == []
    assert panel.page.evaluate("() => 'attacked' in window") is False
    assert panel.page.locator(f"#panel :is({FOREIGN})").count() == 0
    assert panel.page.evaluate("() => Object.keys(Object.prototype).length") == 0


def longest_block_ms(panel: Panel) -> float:
    """The longest time for which the page's loop stood, in milliseconds."""
    return float(panel.page.evaluate("() => window.longestBlock_ms"))
