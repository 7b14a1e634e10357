"""Messages received of one drive, as the live view needs them."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from itertools import islice
from typing import Any

from adaptdrive.mqtt.client import LIVE_S
from adaptdrive.mqtt.commands import number, part
from adaptdrive.tui.plot import Mark, PlotPoint

Payload = dict[str, Any]

POINTS = 6000
EVENTS = 50
MOST_FEATURES = 9

LATENCY = "latency"
"""Kind of the event that counts late ticks: only the last one is shown."""

_OFF = "off"


@dataclass(slots=True)
class WatchRecord:
    """Received messages.

    Attributes:
        drive: Name of the drive.
        monotonic: Clock for the age of what was received, in seconds.
        availability: `online`, `offline`, or `unknown`.
        state: Payload of `state`.
        load: Payload of `telemetry/load`.
        fast: Payload of `telemetry/drive`.
        events: The last events.
        points: Output and reference over the time of the daemon's clock.
        features: Disturbances that a simulated device offers.
        truth: What a simulated device publishes of its plant; empty for a real drive.
        answer: Last command and what the daemon answered.
        marks: What was done to the drive, for the plot.
        problem: Why the broker is not heard, empty while it is.
    """

    drive: str
    monotonic: Callable[[], float]
    availability: str = "unknown"
    state: Payload = field(default_factory=dict)
    load: Payload = field(default_factory=dict)
    fast: Payload = field(default_factory=dict)
    events: deque[Payload] = field(default_factory=lambda: deque(maxlen=EVENTS))
    points: deque[PlotPoint] = field(default_factory=lambda: deque(maxlen=POINTS))
    features: list[Payload] = field(default_factory=list)
    truth: Payload = field(default_factory=dict)
    marks: deque[Mark] = field(default_factory=lambda: deque(maxlen=EVENTS))
    answer: str = ""
    problem: str = ""
    _heard_s: float = -math.inf
    _plotted_s: float = -math.inf

    @property
    def unit(self) -> str:
        """Unit of the output."""
        return str(part(self.state, "output").get("unit") or "")

    @property
    def output_name(self) -> str:
        """Name of the output."""
        return str(part(self.state, "output").get("name") or "output")

    @property
    def age_s(self) -> float:
        """Age of the drive's last measurement; before the first, of the daemon's last message."""
        since_s, held_s = self.monotonic() - self._heard_s, number(self.fast.get("age_s"))
        return since_s if math.isnan(held_s) else since_s + held_s

    @property
    def live(self) -> bool:
        """True if what is shown may be taken for the present."""
        return self.availability == "online" and self.age_s <= LIVE_S

    @property
    def now_s(self) -> float:
        """Present time by the clock of the drive; it advances while nothing is heard."""
        last_s = self.points[-1].time_s if self.points else 0.0
        since_s = self.monotonic() - self._plotted_s
        return last_s + (since_s if math.isfinite(since_s) else 0.0)

    def take(self, name: str, content: Payload) -> None:
        """Take a message.

        Args:
            name: Topic below that of the drive.
            content: Its payload.
        """
        match name:
            case "availability":
                self.availability = str(content[name])
            case "state":
                self.state = content
            case "telemetry/load":
                self.load = content
            case "telemetry/drive":
                self.fast, self._heard_s = content, self.monotonic()
                self._add(content)
            case "event":
                self._note(content)
            case "simulator":
                self.truth, self.features = content, _features(content)
            case "history":
                self._remember(content)

    def _note(self, event: Payload) -> None:
        """Keep an event; a count of late ticks takes the place of the last one."""
        if event.get("kind") == LATENCY:
            earlier = [one for one in self.events if one.get("kind") != LATENCY]
            self.events.clear()
            self.events.extend(earlier)
        self.events.append(event)

    def _add(self, content: Payload) -> None:
        """Add a point; a drive that does not run follows no reference."""
        controller, reference = _OFF, None
        if self.state.get("state") == "running":
            controller = str(self.state.get("controller"))
            wave = self.state.get("waveform")
            reference = self.load.get("reference") if wave else self.state.get("setpoint")
        point = _point(content, reference, controller)
        if point is not None:
            self.points.append(point)
            self._plotted_s = self.monotonic()

    def _remember(self, content: Payload) -> None:
        """Put the slow steps from before the first point in front of it, as far as there is room.

        A full queue discards at its other end, where the newest points are.
        """
        first_s = self.points[0].time_s if self.points else math.inf
        found = (
            _point(row, row.get("reference"), str(row.get("controller")))
            for row in _tables(content.get("rows"))
        )
        older = [point for point in found if point is not None and point.time_s < first_s]
        room = POINTS - len(self.points)
        self.points.extendleft(islice(reversed(older), room))


def _tables(content: object) -> list[Payload]:
    """Return the tables in a list of a payload."""
    return [one for one in content if isinstance(one, dict)] if isinstance(content, list) else []


def _features(content: Payload) -> list[Payload]:
    """Return the disturbances that can be read, at most one for each digit."""
    offered = _tables(content.get("features"))
    return [one for one in offered if isinstance(one.get("request"), dict)][:MOST_FEATURES]


def _point(content: Payload, reference: object, controller: str) -> PlotPoint | None:
    """Return a point of the plot, None where the output is missing."""
    output_now, wanted = number(content.get("output")), number(reference)
    if math.isnan(output_now):
        return None
    try:
        time_s = datetime.fromisoformat(str(content.get("time"))).timestamp()
    except (ValueError, OverflowError):
        return None
    return PlotPoint(time_s, wanted, output_now, controller)
