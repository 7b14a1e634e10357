"""Figures: their style, and figure and report of a session."""

import base64
import io
import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from datetime import UTC, datetime
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from adaptdrive.analysis import replay
from adaptdrive.analysis.curves import Curves, find_window, read_curves
from adaptdrive.app.loads import build_load
from adaptdrive.config import Configuration
from adaptdrive.recording import reader
from adaptdrive.util import files, quantity
from adaptdrive.util.errors import escaped
from adaptdrive.util.trends import HealthReport

# Style of all figures (figures.mplstyle), and the looks of their lines.

Look = dict[str, Any]

WIDTH_in = 7.16
"""Both columns of a journal page."""

DPI = 300

REFERENCE: Look = {"color": "0.62", "linewidth": 1.0}
FIXED: Look = {"color": "#b4472e", "linewidth": 0.9}
ADAPTIVE: Look = {"color": "#1d4e79", "linewidth": 0.9}
DIRECT: Look = {"color": "#c79a2b", "linewidth": 0.9}
TRUTH: Look = {"color": "0.25", "linewidth": 0.8, "linestyle": (0, (4, 2))}
PARAMETERS = ("#1d4e79", "#b4472e", "#4c8b57")


def journal() -> AbstractContextManager[None]:
    """Within this context figures look as they should."""
    return style.context(Path(__file__).with_name("figures.mplstyle"))


def letter(axes: Axes, name: str, title: str) -> None:
    """Name a panel."""
    axes.set_title(rf"$\mathbf{{({name})}}$  {title}")


def labelled(name: str, unit: str) -> str:
    """Return the label of an axis; a quantity without a unit has its name alone."""
    return f"{name} ({unit})" if unit else name


def legend_above(axes: Axes, columns: int) -> None:
    """Put the legend next to the panel's title, where it hides no data."""
    axes.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=columns,
        borderpad=0.0,
        borderaxespad=0.1,
    )


# The figure of a session: output, voltages, estimates, and which controller was in force.

_TRIP: Look = {"color": "#c1121f", "linewidth": 1.0}
_CHANGE: Look = {"color": "0.4", "linewidth": 0.7, "linestyle": ":"}
_CHANGES = {"mode", "controller", "fallback"}
_MOST_LABELS = 6
_MOST_CHANGES = 100
"""Changes of mode that are marked across the curves; more would hide them."""

_SHADES = {
    "adaptive": ADAPTIVE["color"],
    "manual": DIRECT["color"],
    "fixed": FIXED["color"],
    "accepted": "#4c8b57",
    "not accepted": "0.85",
}
_SIGMAS = 2.0
_UNITS_OF_TIME = ((600.0, 1.0, "s"), (4.0 * 3600.0, 60.0, "min"), (math.inf, 3600.0, "h"))
_SYMBOLS = {
    "gain": r"$\hat{g}$",
    "tau_s": r"$\hat{\tau}$",
    "tau_sum_s": r"$\hat{\tau}_m+\hat{\tau}_f$",
    "tau_product_s2": r"$\hat{\tau}_m\hat{\tau}_f$",
    "resistance_K_per_W": r"$\hat{R}$",
}


def draw_session(session: reader.Session, configuration: Configuration, curves: Curves) -> bytes:
    """Draw a session, or the part of it that its curves show.

    Args:
        session: The session.
        configuration: The one that it ran with.
        curves: What to show.

    Returns:
        A PNG.
    """
    with journal():
        figure = Figure(figsize=(WIDTH_in, 6.4), layout="constrained")
        axes = figure.subplots(4, 1, sharex=True, height_ratios=(1.5, 1.2, 1.2, 0.45))
        begin_s, end_s, started = curves.window
        span_s = end_s - begin_s
        scale_s, unit = next((s, u) for most, s, u in _UNITS_OF_TIME if span_s <= most)
        _draw_output(axes[0], session, curves, scale_s)
        _draw_given(axes[1], session.info.manipulated, curves, scale_s)
        _draw_estimates(axes[2], configuration, curves, scale_s)
        _draw_strip(axes[3], curves, scale_s)
        axes[3].set_xlim(0.0, span_s / scale_s)
        _mark(axes, session, curves, scale_s)
        axes[3].set_xlabel(f"time since {started:%Y-%m-%d %H:%M:%S} UTC ({unit})")
        figure.align_ylabels(list(axes[:3]))
        return as_png(figure)


def as_png(figure: Figure) -> bytes:
    """Return a figure as a PNG."""
    FigureCanvasAgg(figure)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=200, metadata={"Software": None})
    return buffer.getvalue()


def _draw_output(axes: Axes, session: reader.Session, curves: Curves, scale_s: float) -> None:
    looks = {"reference": REFERENCE, "output": ADAPTIVE}
    display = session.info.shown
    for name, look in looks.items():
        time_s, values = curves.ticks[name]
        shown = display.scale * values + display.offset
        axes.plot(time_s / scale_s, shown, label=name, **look)
    axes.set_title(f"{session.info.drive}: output and reference")
    axes.set_ylabel(labelled("output", display.unit))
    legend_above(axes, columns=2)


def _draw_given(axes: Axes, given: quantity.Given, curves: Curves, scale_s: float) -> None:
    time_s, boost_V = curves.ticks["boost_voltage_V"]
    axes.plot(time_s / scale_s, boost_V, label=given.name, **(FIXED | {"linewidth": 0.6}))
    if len(curves.slow_s):
        slow = curves.broken(curves.slow_s / scale_s)
        asked = curves.broken(curves.slow["boost_reference_V"])
        applied = curves.broken(curves.slow["applied_V"])
        axes.step(slow, asked, where="post", label=given.asked, **REFERENCE)
        axes.plot(slow, applied, label="applied, mean", **ADAPTIVE)
    axes.set_title(f"{given.title.capitalize()} of the drive")
    axes.set_ylabel(given.axis)
    legend_above(axes, columns=3)


def _draw_estimates(
    axes: Axes, configuration: Configuration, curves: Curves, scale_s: float
) -> None:
    load = build_load(configuration)
    nominal = load.physical(list(load.numerator), list(load.denominator))
    time, known = curves.broken(curves.slow_s / scale_s), []
    for name, usual, colour in zip(load.names, nominal, PARAMETERS, strict=False):
        if name not in curves.estimates:
            continue
        value, std = (curves.broken(series) / usual for series in curves.estimates[name])
        known.append(value)
        axes.plot(time, value, color=colour, linewidth=0.9, label=_SYMBOLS.get(name, name))
        band = _SIGMAS * np.abs(std)
        axes.fill_between(time, value - band, value + band, color=colour, alpha=0.15, linewidth=0)
    axes.axhline(1.0, **TRUTH)
    axes.set_ylim(*_limits(known))
    axes.set_title(f"Estimates over nominal, with bands of {_SIGMAS:g} standard deviations")
    axes.set_ylabel("ratio")
    if curves.estimates:
        legend_above(axes, columns=3)


def _limits(series: list[NDArray[np.float64]]) -> tuple[float, float]:
    """Limits that hold what is usual; an estimate that has just begun may be anywhere."""
    values = np.concatenate([*series, np.ones(1)])
    low, high = np.nanpercentile(values, (2.0, 98.0))
    low, high = min(low, 1.0), max(high, 1.0)
    margin = max(0.1, 0.15 * (high - low))
    return low - margin, high + margin


def _draw_strip(axes: Axes, curves: Curves, scale_s: float) -> None:
    verdicts = curves.slow.get("accepted", ())
    rows = {
        "verdict": ["accepted" if one else "not accepted" for one in verdicts],
        "controller": list(map(str, curves.slow.get("controller", ()))),
    }
    for height, values in enumerate(rows.values()):
        for first, last, what in _runs(values, curves.breaks):
            begin_s, end_s = curves.slow_s[first], curves.slow_s[last] + curves.period_s
            span = (begin_s / scale_s, (end_s - begin_s) / scale_s)
            axes.broken_barh([span], (height + 0.1, 0.8), color=_SHADES[what], linewidth=0)
    axes.set_yticks([0.5, 1.5], list(rows))
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(0.0, 2.0)
    for what in ("adaptive", "fixed", "manual", "accepted", "not accepted"):
        axes.fill_between([], [], color=_SHADES[what], label=what, linewidth=0)
    axes.set_title("In force")
    legend_above(axes, columns=5)


def _runs(values: list[str], breaks: NDArray[np.int64]) -> Iterator[tuple[int, int, str]]:
    """Yield first, last and value of each stretch of equal values without a break."""
    ends = set(breaks.tolist()) | {len(values)}
    first = 0
    for index in range(1, len(values) + 1):
        if index in ends or values[index] != values[first]:
            yield first, index - 1, values[first]
            first = index


def _mark(axes: Sequence[Axes], session: reader.Session, curves: Curves, scale_s: float) -> None:
    begin_s, end_s, _ = curves.window
    shown = [event for event in session.events if begin_s <= event.monotonic_s <= end_s]
    trips = [event for event in shown if event.kind == "trip"]
    changes = [event for event in shown if event.kind in _CHANGES]
    for events, look in ((changes, _CHANGE), (trips, _TRIP)):
        times = [(event.monotonic_s - begin_s) / scale_s for event in events]
        marked = axes if len(times) <= _MOST_CHANGES else axes[-1:]
        for one in marked if times else ():
            one.vlines(times, 0.0, 1.0, transform=one.get_xaxis_transform(), **look)
    for event in trips[:_MOST_LABELS]:
        text = f"trip: {event.trip_kind or 'kind unknown'}"
        _label(axes[0], (event.monotonic_s - begin_s) / scale_s, text, _TRIP["color"])


def _label(axes: Axes, time: float, text: str, color: str) -> None:
    axes.annotate(
        text,
        (time, 0.98),
        xycoords=("data", "axes fraction"),
        xytext=(-2.0, 0.0),
        textcoords="offset points",
        rotation=90,
        ha="right",
        va="top",
        fontsize=7.0,
        color=color,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8, "alpha": 0.8},
    )


def draw_course(course: Sequence[tuple[float, float, float]], title: str) -> bytes:
    """Draw the last measurements of a running drive.

    Args:
        course: Time in s, output and reference of each.
        title: Title.

    Returns:
        A PNG.
    """
    time_s, output, reference = np.array(course).reshape(-1, 3).T
    with journal():
        figure = Figure(figsize=(WIDTH_in, 2.6), layout="constrained")
        axes = figure.subplots()
        axes.plot(time_s - time_s[-1:], reference, label="reference", **REFERENCE)
        axes.plot(time_s - time_s[-1:], output, label="output", **ADAPTIVE)
        axes.set_title(title)
        axes.set_xlabel("time since the last measurement (s)")
        legend_above(axes, columns=2)
        return as_png(figure)


# Figure and report of a session; the report is one HTML file that needs nothing else.

_MOST_ROWS = 1000


def _facts(session: reader.Session, curves: Curves) -> str:
    info, (begin_s, end_s, _) = session.info, curves.window
    rows = [
        ("session", session.path.name),
        ("shown", f"{end_s - begin_s:.6g} s"),
        ("ended", info.ended.value),
        ("not recorded", str(info.dropped)),
        ("adaptdrive", info.version),
    ]
    return _table((), [*rows, ("damaged", session.damage)] if session.damage else rows)


def _events(session: reader.Session, curves: Curves) -> str:
    begin_s, end_s, _ = curves.window
    shown = [
        one for one in session.events if not (one.monotonic_s < begin_s or one.monotonic_s > end_s)
    ]
    rows = [(f"{one.time:%H:%M:%S.%f}"[:-3], one.kind, one.detail) for one in shown]
    return _table(("UTC", "kind", "detail"), rows, [one.severity for one in shown])


def _commands(session: reader.Session) -> str:
    rows = [
        (
            f"{one.time:%H:%M:%S.%f}"[:-3],
            f"{one.verb} {one.value}",
            one.user or "unknown",
            "accepted" if one.accepted else f"refused: {one.reason}",
        )
        for one in session.commands
    ]
    return _table(("UTC", "command", "sender, unverified", "answer"), rows)


def _table(
    heads: Sequence[str], rows: Sequence[Iterable[str]], kinds: Sequence[str] | None = None
) -> str:
    if not rows:
        return "<p>none</p>"
    head = "".join(f"<th>{escape(name)}</th>" for name in heads)
    cells = ["".join(f"<td>{escape(cell)}</td>" for cell in row) for row in rows[:_MOST_ROWS]]
    classes = kinds or itertools.repeat("")
    body = "".join(
        f'<tr class="{escape(kind)}">{row}</tr>' for row, kind in zip(cells, classes, strict=False)
    )
    left_out = f"<p>and {len(rows) - _MOST_ROWS} more</p>" if len(rows) > _MOST_ROWS else ""
    return f"<table><tr>{head}</tr>{body}</table>{left_out}"


def plot(
    path: Path, begin_s: float | None = None, end_s: float | None = None, into: Path | None = None
) -> tuple[Path, Path]:
    """Draw a session and write its report.

    Args:
        path: Directory of the session.
        begin_s: First second shown, None for the first.
        end_s: Last second shown, None for the last.
        into: Folder for the files; that of the session when None.

    Returns:
        The PNG and the HTML file.

    Raises:
        AdaptdriveError: The session cannot be read, or holds nothing there.
        OSError: The files cannot be written.
    """
    session = reader.read_session(path)
    configuration = replay.reconfigured(session.config_text, path / "config.toml", ())
    curves = read_curves(session, find_window(session, begin_s, end_s))
    png = draw_session(session, configuration, curves)
    folder = path if into is None else into
    figure, report = folder / "figure.png", folder / "report.html"
    template = Path(__file__).with_name("report.html").read_text(encoding="utf-8")
    page = template.format(
        title=escape(f"{session.info.drive}, {curves.window[2]:%Y-%m-%d %H:%M:%S} UTC"),
        facts=_facts(session, curves),
        png=base64.b64encode(png).decode(),
        events=_events(session, curves),
        commands=_commands(session),
        config=escape(session.config_text),
    )
    files.replace_result(figure, png)
    files.replace_result(report, escaped(page).encode())
    return figure, report


# The health of a load.

_ROW_in = 1.35


def draw_health(drive: str, found: HealthReport) -> bytes:
    """Draw the load over the weeks, each quantity in per cent of its first seven days.

    Returns:
        A PNG.
    """
    times, rows = [datetime.fromtimestamp(one, UTC) for one in found.times_s], len(found.courses)
    with journal():
        figure = Figure((WIDTH_in, _ROW_in * max(1, rows) + 0.4), layout="constrained")
        panels = figure.subplots(max(1, rows), 1, sharex=True, squeeze=False)[:, 0]
        for axes, (name, course) in zip(panels, found.courses.items(), strict=False):
            one = found.quantities[name]
            axes.plot(times, np.array(course, float), ".", color=ADAPTIVE["color"])
            if one.since is not None:
                axes.axvline(one.since, **FIXED)
            axes.set_title(f"{drive}: {one.meaning or name}")
            axes.set_ylabel("%")
        panels[-1].set_xlabel("UTC")
        panels[-1].tick_params(axis="x", labelrotation=20)
        return as_png(figure)
