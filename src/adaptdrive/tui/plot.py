"""A plot of output and reference in braille characters: two by four dots in each cell."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from math import isfinite

from rich.text import Text

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


@dataclass(frozen=True, slots=True)
class Mark:
    """Something that was done to the drive, worth a mark in the plot."""

    time_s: float
    text: str


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
    marked = canvas.text_line((one.time_s, f"▼{one.text} ") for one in marks)
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
