"""The live view: one screen on the state of the control, made from a record."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from textwrap import wrap

from rich.layout import Layout
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from adaptdrive.runtime.trips import remedy
from adaptdrive.watch.plot import CONTROLLER_STYLES, REFERENCE_STYLE, plot
from adaptdrive.watch.tables import (
    DIM,
    STATE_STYLES,
    boxed,
    event_line,
    event_lines,
    figure,
    lines,
    number,
    overshoot,
    percent,
    rows,
)
from adaptdrive_sim.demo.heard import QuantilesMessage, known
from adaptdrive_sim.demo.record import DemoRecord
from adaptdrive_sim.demo.settings import DRIVE
from adaptdrive_sim.demo.subject import Subject

WIDE, TALL = 110, 32
FIGURES_ROWS = 7
_SHORTEST_WINDOW_s = 30.0
_ESTIMATES = (
    ("gain", "gain", "V/V"),
    ("tau_sum_s", "τm+τf", "s"),
    ("tau_product_s2", "τm·τf", "s²"),
)


@dataclass(frozen=True, slots=True)
class ViewContext:
    """Surroundings of the live view, as shown.

    Attributes:
        bus: The bus in use.
        broker: The broker in use, HOST:PORT.
        program: How to call `adaptdrive` from another terminal.
        duration_s: Seconds until the end, None when it goes on.
        longest_window_s: Longest time that the plot shows.
        subject: The load, None for the motor on a bus.
        panel: Address of the web page, empty where there is none.
    """

    bus: str
    broker: str
    program: str
    duration_s: float | None
    longest_window_s: float
    subject: Subject | None = None
    panel: str = ""

    @property
    def drive(self) -> str:
        """Name of the drive."""
        return self.subject.drive if self.subject else DRIVE


def screen(record: DemoRecord, around: ViewContext, size: tuple[int, int]) -> Layout:
    """The whole screen.

    Args:
        record: What was received.
        around: Where this takes place.
        size: Width and height of the terminal in characters.
    """
    width, height = size
    header, hints = _header(record, around, width), list(_hints(record, around, size))
    events = 6 if height >= TALL else 3
    fixed = len(header) + FIGURES_ROWS + events + len(hints)
    layout = Layout()
    layout.split_column(
        Layout(lines(header), size=len(header)),
        Layout(_plot_panel(record, around, (width, height - fixed))),
        Layout(_figures(record, around, wide=width >= WIDE), size=FIGURES_ROWS),
        Layout(_events(record, events), size=events),
        Layout(lines(hints), size=len(hints)),
    )
    return layout


def _header(record: DemoRecord, around: ViewContext, width: int) -> list[Text]:
    """The state of the drive, and a caption of at most two lines."""
    caption = wrap(_caption(record, around), max(20, width - 2))[:2]
    return [_status(record, around), *(Text(f" {line}", "italic") for line in caption or [""])]


def _status(record: DemoRecord, around: ViewContext) -> Text:
    state = record.state
    name = state.state if state else "starting"
    style = STATE_STYLES.get(name, "bold yellow")
    line = Text.assemble((f" {around.drive} ", "bold reverse"), " ", (f" {name} ", style))
    if state is not None:
        line.append_text(_controller(state.controller, state.mode, state.reason, state.trip))
    line.append(f"   {_elapsed(record, around)}", DIM)
    if not record.connected:
        line.append("   broker not heard", "bold red")
    return line


def _caption(record: DemoRecord, around: ViewContext) -> str:
    if around.subject is None and record.state is not None and record.state.trip is not None:
        return f"The drive is off and safe. What to do: {remedy(record.state.trip)}."
    return record.caption


def _controller(controller: str, mode: str, reason: str, trip: str | None) -> Text:
    if trip:
        return Text(f"  {trip}", "red")
    text = Text("  ")
    text.append(controller, f"bold {CONTROLLER_STYLES.get(controller, '')}")
    text.append(" controller in force")
    if controller != mode:
        text.append(f", {mode} asked for: {reason}", "yellow")
    return text


def _elapsed(record: DemoRecord, around: ViewContext) -> str:
    if record.first is None:
        return ""
    elapsed_s = record.clock() - record.first.time_s
    whole = f" of {_minutes(around.duration_s)}" if around.duration_s is not None else ""
    return f"{_minutes(elapsed_s)}{whole}"


def _minutes(time_s: float) -> str:
    return f"{int(time_s) // 60}:{int(time_s) % 60:02d}"


def _plot_panel(record: DemoRecord, around: ViewContext, size: tuple[int, int]) -> Panel:
    now_s, points = record.clock(), list(record.trace)
    since_s = now_s - points[0].time_s if points else 0.0
    window_s = min(max(since_s, _SHORTEST_WINDOW_s), around.longest_window_s)
    title = Text(around.subject.title if around.subject else "speed in tachometer volts")
    for name, style in {**CONTROLLER_STYLES, "reference": REFERENCE_STYLE}.items():
        title.append(f"  ━ {name}", style)
    inner = (size[0] - 4, size[1] - 2)
    content = plot(points, list(record.marks), now_s, window_s, inner)
    return boxed(title, content)


def _figures(record: DemoRecord, around: ViewContext, *, wide: bool) -> Table:
    if around.subject is not None:
        contents = around.subject.figures()
    else:
        contents = {
            "drive": _drive(record, wide=wide),
            "the load": _estimates(record, wide=wide),
            "overshoot": _overshoots(record),
        }
    grid = Table.grid(expand=True)
    for ratio in (28, 30, 22):
        grid.add_column(ratio=ratio)
    pad = 1 if wide else 0
    grid.add_row(*(boxed(title, one, FIGURES_ROWS, pad) for title, one in contents.items()))
    return grid


def _drive(record: DemoRecord, *, wide: bool) -> Table:
    table, drive, load = rows("l", "r"), record.drive, record.load
    output = known(drive.output) if drive else math.nan
    shaft = f" {record.truth.speed_rad_s:.0f} rad/s" if wide and record.truth else ""
    table.add_row("speed", f"{number(output, 3)} V{shaft}")
    table.add_row("reference", f"{number(load.reference if load else math.nan, 3)} V")
    voltage = known(drive.boost_voltage_V) if drive else math.nan
    asked = load.boost_reference_V if load else math.nan
    table.add_row(
        "boost asked/is" if wide else "boost", f"{number(asked, 0)} / {number(voltage, 0)} V"
    )
    table.add_row("late p50/p99/max, ms" if wide else "late, ms", _lateness(record.lateness))
    table.add_row("ticks missed/held" if wide else "missed/held", _losses(record, wide=wide))
    return table


def _lateness(reports: Sequence[QuantilesMessage]) -> str:
    """Lateness over the last reports: their median, their 99th percentile, and the worst tick."""
    if not reports:
        return "unknown"
    middles = sorted(known(report.p50) for report in reports)
    worst = sorted(known(report.max) for report in reports)
    # A report covers about a dozen ticks: the 99th percentile of them all is among the maxima.
    p99 = worst[int(0.88 * (len(worst) - 1))]
    times = (middles[len(middles) // 2], p99, worst[-1])
    return "/".join(f"{time_us / 1e3:.1f}" for time_us in times)


def _losses(record: DemoRecord, *, wide: bool) -> str:
    """Half cycles without a tick, and ticks that stood in for a late frame."""
    counts = record.control
    if counts is None:
        return "–"
    whole = f" of {counts.ticks}" if wide else ""
    return f"{counts.missed}/{counts.held}{whole}"


def _estimates(record: DemoRecord, *, wide: bool) -> Table:
    table = rows("l", "r", "r", "r")
    table.add_row("", "learned" if wide else "found", "truth", "error", style="bold")
    disks = str(record.truth.disks) if record.truth else "–"
    table.add_row("disks", figure(_learned_disks(record)), disks, "")
    truth = record.truth.parameters if record.truth else {}
    estimates = record.load.estimates if record.load else {}
    for name, symbol, unit in _ESTIMATES:
        found = estimates.get(name)
        value, real = known(found.value) if found else math.nan, truth.get(name, math.nan)
        label = Text(f"{symbol} {unit}")
        table.add_row(label, figure(value), figure(real), percent(value / real - 1.0))
    return table


def _learned_disks(record: DemoRecord) -> float:
    """The inertia that the estimates amount to, in disks; the filter's time is known."""
    if record.load is None or record.truth is None:
        return math.nan
    total = record.load.estimates.get("tau_sum_s")
    truth = record.truth
    per_disk_s = truth.tau_motor_s / truth.disks
    return (known(total.value) - truth.tau_filter_s) / per_disk_s if total else math.nan


def _overshoots(record: DemoRecord) -> Table:
    table = rows("l", "r", "r")
    fixed, adaptive = (Text(name, style) for name, style in CONTROLLER_STYLES.items())
    table.add_row("disks", fixed, adaptive, style="bold")
    for disks in (1, 2, 3):
        found = (record.halves.overshoot(name, disks) for name in CONTROLLER_STYLES)
        table.add_row(str(disks), *(overshoot(one) for one in found))
    return table


def _events(record: DemoRecord, rows: int) -> Text:
    lines = [
        event_line(f"{event.time.astimezone():%H:%M:%S}", event.kind, event.detail, event.severity)
        for event in list(record.events)[-rows:]
    ]
    return event_lines(lines)


def _hints(record: DemoRecord, around: ViewContext, size: tuple[int, int]) -> Iterator[Text]:
    if around.subject is not None:
        yield from (Text(f" {line}", DIM) for line in around.subject.foot)
        return
    tall = size[1] >= TALL
    if around.panel:
        yield Text.assemble((" panel  ", DIM), around.panel)
        end = "" if tall else "       Ctrl-C ends"
        yield Text(f"        open it in a browser; log in without a name{end}", DIM)
    if tall or not around.panel:
        yield Text(f" bus {around.bus}   broker {around.broker}   Ctrl-C ends", DIM)
    yield Text.assemble((" try    ", DIM), f"{around.program} {_call(record, around)}")
    if tall:
        yield from (Text(f"        {line}") for line in _more_calls(around))


def _call(record: DemoRecord, around: ViewContext) -> str:
    """The command that is of use now."""
    state = record.state
    if state is not None and state.trip is not None:
        return f"reset {DRIVE} --broker {around.broker}, then enable"
    other = "fixed" if state is not None and state.mode == "adaptive" else "adaptive"
    return f"mode {DRIVE} {other} --broker {around.broker}"


def _more_calls(around: ViewContext) -> Iterator[str]:
    yield f"{around.program}-sim disturb {DRIVE} add-disk --broker {around.broker}"
    host, _, port = around.broker.rpartition(":")
    message = '{"id": "1", "value": 3.1}'
    topic = f"adaptdrive/{DRIVE}/command/setpoint"
    yield f"mosquitto_pub -h {host} -p {port} -t {topic} -m '{message}'"
