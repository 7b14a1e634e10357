"""Messages received of one drive, and their plot in braille characters."""

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from itertools import groupby, islice
from math import isfinite
from typing import Any

from rich.text import Text

from adaptdrive.mqtt.client import LIVE_S
from adaptdrive.mqtt.commands import display_in, number, part
from adaptdrive.util.quantity import Display

# A plot of output and reference in braille characters: two by four dots in each cell.

AXIS_STYLE = "bright_black"
MARK_STYLE = "magenta"


@dataclass(frozen=True, slots=True)
class Form:
    """Style of a curve; without colours its line still distinguishes it.

    Attributes:
        style: Colour.
        sign: The line in the legend.
        height: Dots of its thickness.
        apart: Columns of dots from one drawn one to the next.
    """

    style: str
    sign: str
    height: int = 1
    apart: int = 1


REFERENCE = Form("bright_black", "┄", apart=3)
OFF = Form("red", "┈", apart=2)
CONTROLLERS = {"fixed": Form("yellow", "─"), "adaptive": Form("green", "━", height=2)}
FORMS = CONTROLLERS | {"manual": Form("cyan", "╍", height=2, apart=2)}

_DOTS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))
_BLANK = 0x2800
_LABEL_WIDTH = 6
_LEAST_SHARE = 0.03
"""Least height of the plot, as a share of the values in it."""

_MARGIN = 0.06
_OTHER_ROWS = 2  # marks above, times below
_APART_s = (10, 20, 30, 60, 120, 300, 600, 1800, 3600)
_LEVELS = 3


@dataclass(frozen=True, slots=True)
class PlotPoint:
    """Output and reference at one time, in the unit of the output; NaN where it is not known.

    Attributes:
        controller: The controller in force, `off` when there is none.
    """

    time_s: float
    reference: float
    output: float
    controller: str = "fixed"


Mark = tuple[float, str]
"""Time in s and text of something that was done to the drive, worth a mark in the plot."""


class Canvas:
    """Cells of dots; each cell has the style of what was drawn there last.

    Attributes:
        now_s: Right edge.
        window_s: Time from the left edge to the right one.
        low: Lower edge.
        high: Upper edge.
        columns: Width in cells.
        rows: Height in cells.
    """

    def __init__(
        self, now_s: float, window_s: float, edges: tuple[float, float], size: tuple[int, int]
    ) -> None:
        self.now_s, self.window_s = now_s, window_s
        self.low, self.high = edges
        self.columns, self.rows = size
        self._bits = [[0] * self.columns for _ in range(self.rows)]
        self._styles = [[""] * self.columns for _ in range(self.rows)]

    def column(self, time_s: float) -> int:
        """Dot column of a time."""
        share = 1.0 - (self.now_s - time_s) / self.window_s
        return round(share * (2 * self.columns - 1))

    def row(self, value: float) -> int:
        """Dot row of a value, the highest one at the top."""
        share = (self.high - value) / (self.high - self.low)
        return round(min(max(share, 0.0), 1.0) * (4 * self.rows - 1))

    def dot(self, column: int, row: int, style: str) -> None:
        """Set one dot; one outside is left out."""
        cell, line = column // 2, row // 4
        if 0 <= line < self.rows and 0 <= cell < self.columns:
            self._bits[line][cell] |= _DOTS[column % 2][row % 4]
            self._styles[line][cell] = style

    def text_line(self, texts: Iterable[tuple[float, str]]) -> str:
        """Return a line as wide as the plot, with texts at their times; later ones win."""
        line = [" "] * (_LABEL_WIDTH + self.columns)
        for time_s, text in texts:
            start = _LABEL_WIDTH + self.column(time_s) // 2
            if start >= _LABEL_WIDTH:
                line[start : start + len(text)] = text
        return "".join(line)[: _LABEL_WIDTH + self.columns]

    def lines(self) -> Iterator[Text]:
        """The canvas, one line of text after the other."""
        for bits, styles in zip(self._bits, self._styles, strict=True):
            line = Text()
            start = 0
            for style, run in groupby(styles):
                end = start + len(list(run))
                line.append("".join(chr(_BLANK | b) for b in bits[start:end]), style)
                start = end
            yield line


def plot(
    points: Sequence[PlotPoint],
    marks: Sequence[Mark],
    now_s: float,
    window_s: float,
    size: tuple[int, int],
) -> Text:
    """Plot output and reference.

    Args:
        points: What to show, in the order of time.
        marks: What was done to the drive.
        now_s: Time of the right edge.
        window_s: Time from the left edge to the right one.
        size: Width and height in characters.
    """
    width, height = size
    columns, rows = width - _LABEL_WIDTH, height - _OTHER_ROWS
    shown = [point for point in points if now_s - point.time_s <= window_s]
    if not shown or columns < 10 or rows < 2:
        return Text("waiting for the drive …", AXIS_STYLE)
    canvas = Canvas(now_s, window_s, _range(shown), (columns, rows))
    _trace(canvas, [(p.time_s, p.reference, REFERENCE) for p in shown])
    _trace(canvas, [(p.time_s, p.output, FORMS.get(p.controller, OFF)) for p in shown])
    references = [one for one, _ in groupby(p.reference for p in shown) if isfinite(one)]
    labels = _labels(canvas, references[-_LEVELS:])
    labelled = [
        Text.assemble((label.rjust(_LABEL_WIDTH), AXIS_STYLE), line)
        for label, line in zip(labels, canvas.lines(), strict=True)
    ]
    marked = canvas.text_line((time_s, f"▼{text} ") for time_s, text in marks)
    return Text("\n").join([Text(marked, MARK_STYLE), *labelled, _times(canvas)])


def _range(points: Sequence[PlotPoint]) -> tuple[float, float]:
    values = [value for p in points for value in (p.reference, p.output) if isfinite(value)]
    low, high = min(values, default=0.0), max(values, default=0.0)
    missing = max(0.0, _LEAST_SHARE * max(abs(low), abs(high), 0.01) - (high - low))
    margin = 0.5 * missing + _MARGIN * (high - low)
    return low - margin, high + margin


def _trace(canvas: Canvas, values: Sequence[tuple[float, float, Form]]) -> None:
    """Draw a curve: dots reach vertically and horizontally from one value to the next."""
    before: tuple[int, int] | None = None
    for time_s, value, form in values:
        if not isfinite(value):
            before = None
            continue
        column, row = canvas.column(time_s), canvas.row(value)
        first_column, first = before or (column, row)
        for between in range(first_column, column):
            _draw(canvas, form, between, (first, first))
        _draw(canvas, form, column, (min(first, row), max(first, row)))
        before = column, row


def _draw(canvas: Canvas, form: Form, column: int, rows: tuple[int, int]) -> None:
    """Draw one column of a curve, where its form has dots."""
    low, high = rows
    if column % form.apart == 0 or high - low > 1:
        for row in range(low, high + form.height):
            canvas.dot(column, row, form.style)


def _labels(canvas: Canvas, references: Iterable[float]) -> list[str]:
    """Values next to the rows: both edges, and the references, which matter more."""
    labels = [""] * canvas.rows
    for value in (canvas.low, canvas.high, *references):
        labels[canvas.row(value) // 4] = f"{value:.{2 if abs(value) < 100.0 else 1}f} "
    return labels


def _times(canvas: Canvas) -> Text:
    """Times before now along the lower edge."""
    apart_s = next(s for s in _APART_s if canvas.window_s <= 5 * s)
    unit, length_s = ("s", 1) if apart_s < 300 else ("min", 60)
    backs_s = range(apart_s, int(canvas.window_s) + 1, apart_s)
    texts = [(canvas.now_s - back_s, f"-{back_s // length_s} {unit}") for back_s in backs_s]
    return Text(f"{canvas.text_line(texts)[:-3]}now", AXIS_STYLE)


# Messages received of one drive, as the live view needs them.

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
    _received_s: float = -math.inf
    _plotted_s: float = -math.inf

    @property
    def unit(self) -> str:
        """Unit of the output."""
        return str(part(self.state, "output").get("unit") or "")

    @property
    def display(self) -> Display:
        """Unit in which people see the output."""
        return display_in(self.state)

    @property
    def output_name(self) -> str:
        """Name of the output."""
        return str(part(self.state, "output").get("name") or "output")

    @property
    def age_s(self) -> float:
        """Age of the drive's last measurement; before the first, of the daemon's last message."""
        since_s, held_s = self.monotonic() - self._received_s, number(self.fast.get("age_s"))
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
                self.fast, self._received_s = content, self.monotonic()
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
