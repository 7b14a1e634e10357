"""The live view of one drive: one screen, made from what was received."""

from __future__ import annotations

import asyncio
import functools
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any, NoReturn

from rich.console import Console
from rich.layout import Layout
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from adaptdrive.aside import in_thread
from adaptdrive.errors import ConfigurationError, Flaw
from adaptdrive.operation.estimate_names import quantity_and_unit
from adaptdrive.operation.payloads import number, part, printable, unconfirmed_stop
from adaptdrive.watch.plot import REFERENCE_STYLE, STYLES, plot
from adaptdrive.watch.record import Payload, WatchRecord
from adaptdrive.watch.tables import (
    DIM,
    STATE_STYLES,
    boxed,
    event_line,
    event_lines,
    figure,
    lines,
    rows,
)
from adaptdrive.watch.telling import LONGEST_S

KEYS = "s STOP   e e enable   r reset   f fixed   a adaptive   m manual   + - set-point   q quit"
FIGURES_ROWS = 8
_SHORTEST_WINDOW_S, _LONGEST_WINDOW_S = 30.0, 600.0
_EVENTS, _TALL, _WIDE = 6, 32, 110
REFRESH_S = 0.25
_REFUSED = ("wrong_length", "wrong_checksum", "counter_stuck", "out_of_range", "exceptions")


def refuse_dumb_terminal() -> None:
    """Refuse a terminal in which the cursor cannot be moved.

    Raises:
        ConfigurationError: The environment names such a terminal.
    """
    if Console(force_terminal=True).is_dumb_terminal:
        flaw = Flaw(os.environ["TERM"], "a terminal of this kind shows no picture")
        raise ConfigurationError("TERM", [flaw])


async def draw(screen_of: Callable[[tuple[int, int]], Layout]) -> NoReturn:
    """Fill the terminal four times a second, until cancelled.

    A terminal that takes no output, such as one that is stopped or behind a lost connection, holds
    up nothing but its picture: a thread writes to it.

    Args:
        screen_of: Returns the screen for a terminal of some width and height, in characters.

    Raises:
        ConfigurationError: The terminal shows no picture.
    """
    refuse_dumb_terminal()
    # one column for each letter that the terminal does not have, too
    output = os.fdopen(
        os.dup(sys.stdout.fileno()), "w", encoding=sys.stdout.encoding, errors="replace"
    )
    console = Console(file=output, force_terminal=True)
    live = Live(
        console=console,
        screen=True,
        auto_refresh=False,
        redirect_stdout=False,
        redirect_stderr=False,
    )
    try:
        await _write(live.start)
        while True:
            shown = screen_of((console.size.width, console.size.height))
            await _write(functools.partial(live.update, shown, refresh=True))
            await asyncio.sleep(REFRESH_S)
    finally:
        with suppress(TimeoutError, OSError):
            await asyncio.wait_for(_write(live.stop), LONGEST_S)
            output.close()


def _write(call: Callable[[], None]) -> asyncio.Future[None]:
    """Write to the terminal, in a thread that may hang."""
    return asyncio.wrap_future(in_thread(call, "adaptdrive-screen"))


def screen(record: WatchRecord, size: tuple[int, int]) -> Layout:
    """Return the whole screen.

    Args:
        record: What was received.
        size: Width and height of the terminal in characters.
    """
    width, height = size
    events = _EVENTS if height >= _TALL else 3
    header = list(_header(record))
    footer = _footer(record)
    fixed = len(header) + FIGURES_ROWS + events + len(footer)
    layout = Layout()
    layout.split_column(
        Layout(lines(header), size=len(header)),
        Layout(_plot_panel(record, (width, height - fixed))),
        Layout(_figures(record, wide=width >= _WIDE), size=FIGURES_ROWS),
        Layout(_events(record, events), size=events),
        Layout(lines(footer), size=len(footer)),
    )
    return layout


def _header(record: WatchRecord) -> Iterator[Text]:
    state = record.state
    name = printable(state.get("state") if record.availability == "online" else record.availability)
    style = STATE_STYLES.get(name, "bold yellow")
    line = Text.assemble((f" {record.drive} ", "bold reverse"), " ", (f" {name} ", style), "  ")
    if state:
        if stop := unconfirmed_stop(state):
            line.append(f"stop {stop}  ", "bold yellow")
        _add_controller(line, state)
    elif record.availability == "unknown" and not record.problem:
        line.append("nothing heard of this drive; see adaptdrive list for the names")
    if not record.live and (state or record.problem):
        line.append("   OLD DATA", "bold red")
        line.append(f" {record.problem}", "red")
    yield line
    if state.get("trip"):
        last = part(state, "last_trip")
        yield Text(f" trip: {printable(state['trip'])}", "red")
        yield Text(f" remedy: {printable(last.get('remedy') or 'see the manual')}")


def _add_controller(line: Text, state: Payload) -> None:
    controller, mode = printable(state.get("controller")), printable(state.get("mode"))
    line.append(controller, f"bold {STYLES.get(controller, '')}")
    line.append(" controller in force")
    if controller != mode:
        line.append(f", {mode} asked for: {printable(state.get('reason'))}", "yellow")


def _plot_panel(record: WatchRecord, size: tuple[int, int]) -> Panel:
    points = list(record.points)
    now_s = points[-1].time_s if points else 0.0
    since_s = now_s - points[0].time_s if points else 0.0
    window_s = min(max(since_s, _SHORTEST_WINDOW_S), _LONGEST_WINDOW_S)
    unit = f" in {record.unit}" if record.unit else ""
    title = Text(printable(f"{record.output_name}{unit}"))
    for name, style in {**STYLES, "reference": REFERENCE_STYLE}.items():
        title.append(f"  ━ {name}", style)
    content = plot(points, [], now_s, window_s, (size[0] - 4, size[1] - 2))
    return boxed(title, content)


def _figures(record: WatchRecord, *, wide: bool) -> Table:
    grid = Table.grid(expand=True)
    contents = {
        "drive": _drive(record),
        "estimates, ± 2 σ": _estimates(record, wide=wide),
        "health": _health(record),
    }
    for _ in contents:
        grid.add_column(ratio=1)
    grid.add_row(*(boxed(title, table, FIGURES_ROWS, 0) for title, table in contents.items()))
    return grid


def _drive(record: WatchRecord) -> Table:
    state, fast, load = record.state, record.fast, record.load
    limits, wave = part(state, "limits"), part(state, "waveform")
    table = rows("l", "r", "r")
    table.add_row(_text(record.output_name), _text(_value(fast.get("output"), record.unit)), "")
    reference = load.get("reference") if wave else state.get("setpoint")
    wanted = printable(wave.get("shape")) if wave else _range(limits.get("setpoint"))
    table.add_row("set-point", _text(_value(reference, record.unit)), _text(wanted))
    table.add_row("V_c", _value(load.get("boost_reference_V"), "V"), _range(limits.get("boost_V")))
    table.add_row("v_bst", _value(fast.get("boost_voltage_V"), "V"), "")
    table.add_row("power", _value(fast.get("load_power_W"), "W"), _range(limits.get("power_W")))
    return table


def _estimates(record: WatchRecord, *, wide: bool) -> Table:
    """Return the estimates, with their units where the terminal is wide enough for them."""
    table = rows("l", "r", "r")
    found = part(record.load, "estimates")
    for name in list(found)[: FIGURES_ROWS - 3]:
        estimate = part(found, name)
        spread = f"± {figure(2.0 * number(estimate.get('std')))}"
        quantity, unit = quantity_and_unit(name, found, record.unit)
        named = f"{quantity}, {unit}" if unit and wide else quantity
        table.add_row(_text(named), figure(number(estimate.get("value"))), spread)
    verdict = "accepted" if record.load.get("accepted") else record.load.get("reason") or "-"
    table.add_row("verdict", _text(verdict), "")
    return table


def _health(record: WatchRecord) -> Table:
    fast = record.fast
    lateness, bus = part(fast, "lateness_us"), part(fast, "bus")
    sensors = part(fast, "sensors")
    down = [name for name in sensors if not part(sensors, name).get("up")]
    times = "/".join(figure(1e-3 * number(lateness.get(name))) for name in ("p50", "p99", "max"))
    table = rows("l", "r")
    table.add_row("late, ms", times)
    counted = f"{fast.get('missed')}/{fast.get('held')} of {fast.get('ticks')}"
    table.add_row("missed/held", _text(counted))
    table.add_row("refused", f"{sum(number(bus.get(name, 0)) for name in _REFUSED):.0f}")
    table.add_row("sensor buses", _text(f"down: {', '.join(down)}" if down else len(sensors)))
    table.add_row("age", _value(fast.get("age_s"), "s"))
    return table


def _events(record: WatchRecord, count: int) -> Text:
    shown = [
        event_line(
            printable(event.get("time"))[11:19],
            printable(event.get("kind")),
            printable(event.get("detail")),
            str(event.get("severity")),
        )
        for event in list(record.events)[-count:]
    ]
    return event_lines(shown)


def _footer(record: WatchRecord) -> tuple[Text, ...]:
    own = Text(f" {printable(record.answer)}", "bold"), Text(f" {KEYS}", DIM)
    offered = "   ".join(
        f"{digit} {printable(one.get('text'))}" for digit, one in enumerate(record.features, 1)
    )
    return (*own, Text(f" simulated plant: {offered}", DIM)) if offered else own


def _text(value: object) -> Text:
    return Text(printable(value))


def _value(value: object, unit: str) -> str:
    return f"{figure(number(value))} {unit}".rstrip()


def _range(limits: Any) -> str:  # noqa: ANN401 - a part of a payload
    if not isinstance(limits, list) or len(limits) != 2:
        return ""
    low, high = ("" if one is None else f"{number(one):g}" for one in limits)
    return f"{low}…{high}"
