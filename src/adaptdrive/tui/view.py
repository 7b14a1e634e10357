"""The live view of one drive: one screen, made from what was received."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from textwrap import wrap
from typing import Any

from rich.layout import Layout
from rich.table import Table
from rich.text import Text

from adaptdrive.mqtt.commands import (
    OFFSET,
    given_in,
    is_known,
    number,
    part,
    printable,
    program_text,
    quantity_and_unit,
    unconfirmed_stop,
)
from adaptdrive.tui.record import FORMS, OFF, REFERENCE, Payload, PlotPoint, WatchRecord, plot
from adaptdrive.tui.terminal import KeyCommand
from adaptdrive.util.quantity import Display

# Elements of the tables of the live view.

DIM = "bright_black"
"""Style of what is less important: frames, times, hints."""

_LONGEST = 1e6
"""Least number that is written with a power of ten."""

STATE_STYLES = {"running": "bold green", "tripped": "bold white on red"}


def rows(*columns: str) -> Table:
    """Return a table without lines; `l` and `r` align its columns."""
    table = Table.grid(expand=True, padding=(0, 1))
    for column in columns:
        table.add_column(justify="right" if column == "r" else "left", no_wrap=True)
    return table


def figure(value: float, digits: int = 3) -> str:
    """Return a number with so many digits, or with all that it has before the point."""
    if not math.isfinite(value):
        return "–"
    if 10.0**digits <= abs(value) < _LONGEST:
        return f"{value:.0f}"
    return f"{value:#.{digits}g}".rstrip(".")


def cut(line: Text) -> Text:
    """Let a line end in an ellipsis where the terminal is too narrow for it."""
    line.no_wrap, line.overflow = True, "ellipsis"
    return line


def lines(texts: Iterable[Text]) -> Text:
    """Return texts below each other, each of which is cut where the terminal is too narrow."""
    return cut(Text("\n").join(texts))


def flow(items: Iterable[str], width: int) -> list[str]:
    """Return lines of items, each of which begins a new line where it does not fit."""
    found: list[str] = []
    for item in items:
        if found and len(found[-1]) + len(item) + 2 <= width:
            found[-1] += f"  {item}"
        else:
            found += wrap(item, width, initial_indent=" ", subsequent_indent=" ")
    return found


def titled(title: str | Text, content: Table | Text) -> Table:
    """Return content below its title and a line."""
    grid = Table.grid(expand=True)
    head = Text.assemble(("─ ", DIM), title, (" " + "─" * 200, DIM))
    head.no_wrap, head.overflow = True, "crop"
    grid.add_row(head)
    grid.add_row(content)
    return grid


# The live view of one drive: one screen, made from what was received.

KEYS = (
    *("s STOP", "ee enable", "r reset", "f fixed", "a adaptive"),
    *("m manual", "+- set-point", "q quit"),
)
_ROWS = 6
_SHORTEST_WINDOW_S, _LONGEST_WINDOW_S = 30.0, 600.0
_EVENTS, _WIDE = 6, 110
_LEAST_PLOT = 9
_TRIP_LINES = 2
_SEVERITY_STYLES = {"warning": "yellow", "alarm": "bold red"}
_REFUSED = ("wrong_length", "wrong_checksum", "counter_stuck", "out_of_range", "exceptions")


Takes = Callable[[str], KeyCommand | bool]
"""Sees a key first; returns the command that it asks for, or whether it was for it."""


@dataclass(frozen=True, slots=True)
class ViewExtras:
    """What a view shows in addition to a drive.

    Attributes:
        keys: What each key does.
        lead: Lines below that of the drive.
        tables: More tables than those of the drive, by title.
        longest_s: Longest time that the plot shows.
        cover: Takes the place of the tables, where it is there.
        plant: Whether the keys of a simulated plant are named.
        takes: Sees each key first.
    """

    keys: Sequence[str] = KEYS
    lead: Sequence[Text] = ()
    tables: Mapping[str, Table] = field(default_factory=dict)
    longest_s: float = _LONGEST_WINDOW_S
    cover: Text | None = None
    plant: bool = True
    takes: Takes = lambda _: False


WATCH = ViewExtras()


def faint(texts: Iterable[str]) -> list[Text]:
    """Return lines for below that of the drive."""
    return [Text(f" {line}", DIM) for line in texts]


def screen(record: WatchRecord, size: tuple[int, int], around: ViewExtras = WATCH) -> Layout:
    """Return the whole screen.

    Args:
        record: What was received.
        size: Width and height of the terminal in characters.
        around: What is shown around the drive.
    """
    width, height = size
    header = [*_header(record, width), *around.lead]
    footer = _footer(record, around, width)
    middle = _middle(record, around, size)
    rows = _ROWS + 1
    events = min(_EVENTS, max(1, height - rows - len(header) - len(footer) - _LEAST_PLOT))
    fixed = len(header) + rows + events + len(footer)
    layout = Layout()
    layout.split_column(
        Layout(lines(header), size=len(header)),
        Layout(_plot(record, around.longest_s, (width, height - fixed))),
        Layout(middle, size=rows),
        Layout(_events(record, events), size=events),
        Layout(lines(footer), size=len(footer)),
    )
    return layout


def _header(record: WatchRecord, width: int) -> Iterator[Text]:
    """Return the line of the drive, of which only the end may be cut, and those of a trip."""
    state = record.state
    online = record.availability == "online"
    name = printable(state.get("state") if online else record.availability)
    style = STATE_STYLES.get(name, "bold yellow")
    line = Text.assemble((f" {record.drive} ", "bold reverse"), " ", (f" {name} ", style), "  ")
    if stop := state and unconfirmed_stop(state):
        line.append(f"stop {stop}  ", "bold yellow")
    if not record.live and (state or record.problem):
        line.append("OLD DATA ", "bold red")
        line.append(f"{record.problem} ".lstrip(), "red")
    if state:
        _add_controller(line, state)
    elif record.availability == "unknown" and not record.problem:
        line.append("nothing heard of this drive; see adaptdrive list")
    yield line
    if program := program_text(state, record.fast):
        yield Text(f" program {program}")
    if state.get("trip"):
        remedy = part(state, "last_trip").get("remedy") or "see the manual"
        kind = f" [{printable(state['trip_kind'])}]" if state.get("trip_kind") else ""
        trip = f"trip{kind}: {printable(state['trip'])}"
        texts = {trip: "red", f"remedy: {printable(remedy)}": ""}
        for text, style in texts.items():
            yield from (Text(one, style) for one in flow([text], width)[:_TRIP_LINES])


def _add_controller(line: Text, state: Payload) -> None:
    controller, mode = printable(state.get("controller")), printable(state.get("mode"))
    line.append(controller, f"bold {FORMS.get(controller, OFF).style}")
    line.append(" controller in force")
    if controller != mode:
        line.append(f", {mode} asked for: {printable(state.get('reason'))}", "yellow")


def _plot(record: WatchRecord, longest_s: float, size: tuple[int, int]) -> Table:
    unit = f" in {record.display.unit}" if record.display.unit else ""
    title = Text(printable(f"{record.output_name}{unit}"))
    for name, form in {**FORMS, "off": OFF, "reference": REFERENCE}.items():
        title.append(f"  {form.sign * 2} {name}", form.style)
    title.append(" ")
    return plotted(record, title, size, longest_s)


def plotted(
    record: WatchRecord, title: Text, size: tuple[int, int], longest_s: float = _LONGEST_WINDOW_S
) -> Table:
    """Return the plot of what was received below its title.

    Args:
        record: What was received.
        title: The title.
        size: Width and height of both in characters.
        longest_s: Longest time that it shows.
    """
    points, now_s = _shown(record), record.now_s
    since_s = now_s - points[0].time_s if points else 0.0
    window_s = min(max(since_s, _SHORTEST_WINDOW_S), longest_s)
    room = size[0] - 1, size[1] - 1
    return titled(title, plot(points, list(record.marks), now_s, window_s, room))


def _shown(record: WatchRecord) -> list[PlotPoint]:
    """Return the points of the plot in the unit in which people see them."""
    shown = record.display.shown
    return [
        PlotPoint(one.time_s, shown(one.reference), shown(one.output), one.controller)
        for one in record.points
    ]


def _middle(record: WatchRecord, around: ViewExtras, size: tuple[int, int]) -> Table | Text:
    """Return the tables, side by side, or what covers them."""
    if around.cover is not None:
        return around.cover
    wide = size[0] >= _WIDE
    ranges = wide or not around.tables
    contents = {
        "drive": _drive(record, ranges=ranges),
        "estimates": _estimates(record, wide=wide),
        **around.tables,
    }
    grid = Table.grid(expand=True, padding=(0, 1))
    for _, ratio in zip(contents, (20, 36, 22), strict=False):
        grid.add_column(ratio=ratio)
    grid.add_row(*(titled(name, one) for name, one in contents.items()))
    return grid


def _drive(record: WatchRecord, *, ranges: bool) -> Table:
    state, fast, load = record.state, record.fast, record.load
    limits, wave = part(state, "limits"), part(state, "waveform")
    reference = load.get("reference") if wave else state.get("setpoint")
    given, display = given_in(state), record.display
    levels = _range(limits.get("setpoint"), display)
    wanted = printable(wave.get("shape")) if wave else levels
    output, reference = (display.shown(number(one)) for one in (fast.get("output"), reference))
    found = (
        (record.output_name, output, display.unit, ""),
        ("set-point", reference, display.unit, wanted),
        (given.asked, load.get("boost_reference_V"), given.unit, _range(limits.get("boost_V"))),
        (given.name, fast.get("boost_voltage_V"), given.unit, ""),
        ("power", fast.get("load_power_W"), "W", _range(limits.get("power_W"))),
    )
    table = rows("l", "r", "r") if ranges else rows("l", "r")
    for name, value, unit, limit in found:
        cells = (_text(name), _text(_value(value, unit)), _text(limit))
        table.add_row(*cells[: 3 if ranges else 2])
    return table


def _estimates(record: WatchRecord, *, wide: bool) -> Table:
    """Return each estimate with its spread, and the truth where a simulator knows it.

    The last row is how far the response to a step may be off by all that they leave open.
    """
    found, truth = part(record.load, "estimates"), record.truth
    given = given_in(record.state)
    table = rows("l", "r", "r", "r") if truth else rows("l", "r", "r")
    accepted = "accepted" if record.load.get("accepted") else "not accepted" if found else ""
    head = (accepted, "learned", "± 2 σ", "truth")
    table.add_row(*head[: 4 if truth else 3], style=DIM)
    for name in list(found)[: _ROWS - 1]:
        estimate = part(found, name)
        quantity, unit = quantity_and_unit(name, found, record.unit, given.unit)
        named = f"{quantity}, {unit}" if unit and wide else quantity
        learned, spread = number(estimate.get("value")), 2.0 * number(estimate.get("std"))
        known = name == OFFSET or is_known(estimate)
        shown = (figure(learned), figure(spread, 2)) if known else ("not known", "")
        real = (figure(number(truth.get(name))),) if truth else ()
        table.add_row(_text(named), *shown, *real)
    off = 100.0 * number(record.load.get("response_spread"))
    if math.isfinite(off):
        table.add_row("response", f"± {figure(off, 2)} %")
    return table


def _health(record: WatchRecord) -> Iterator[str]:
    """Return what is counted, in the words of `telemetry/drive`."""
    fast = record.fast
    lateness, bus, sensors = (part(fast, name) for name in ("lateness_us", "bus", "sensors"))
    times = "/".join(f"{1e-3 * number(lateness.get(name)):.2f}" for name in ("p50", "p99", "max"))
    yield f"late {times.replace('nan', '–')} ms"
    yield printable(f"missed {fast.get('missed', '–')}")
    yield printable(f"held {fast.get('held', '–')} of {fast.get('ticks', '–')}")
    yield f"refused {sum(number(bus.get(name, 0)) for name in _REFUSED):.0f}"
    yield f"age {figure(1e3 * number(fast.get('age_s')))} ms"
    if down := [name for name in sensors if not part(sensors, name).get("up")]:
        yield printable(f"sensor buses down: {', '.join(down)}")
    if record.load and not record.load.get("accepted"):
        yield printable(record.load.get("reason"))


def _events(record: WatchRecord, count: int) -> Text:
    shown = [_event(one) for one in list(record.events)[-count:]]
    return lines(shown) if shown else Text(" no events yet", DIM)


def _event(event: Payload) -> Text:
    time, kind, detail = (printable(event.get(name)) for name in ("time", "kind", "detail"))
    style = _SEVERITY_STYLES.get(str(event.get("severity")), "")
    return Text.assemble((f" {time[11:19]} ", DIM), (f"{kind:<11} ", "bold"), (detail, style))


def _footer(record: WatchRecord, around: ViewExtras, width: int) -> list[Text]:
    """Return what is counted, the last answer, and the keys; digits disturb a simulated plant."""
    named = enumerate(record.features, 1) if around.plant else ()
    offered = [f"{digit} {printable(one.get('text'))}" for digit, one in named]
    plant = [f"simulated plant: {offered[0]}", *offered[1:]] if offered else []
    return [
        *(Text(line, DIM) for line in flow(_health(record), width)),
        Text(f" {printable(record.answer)}", "bold"),
        *(Text(line, DIM) for line in (*flow(around.keys, width), *flow(plant, width))),
    ]


def _text(value: object) -> Text:
    return Text(printable(value))


def _value(value: object, unit: str) -> str:
    return f"{figure(number(value))} {unit}".rstrip()


_PLAIN = Display()


def _range(limits: Any, display: Display = _PLAIN) -> str:  # noqa: ANN401 - of a payload
    if not isinstance(limits, list) or len(limits) != 2:
        return ""
    low, high = ("" if one is None else f"{display.shown(number(one)):g}" for one in limits)
    return f"{low}…{high}"
