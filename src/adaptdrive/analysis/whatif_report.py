"""A session and the same with other settings, as a table, as values, and as a figure."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adaptdrive.analysis import style
from adaptdrive.analysis.figure import as_png
from adaptdrive.analysis.whatif import Comparison

_ROWS = (
    ("overshoot, median", "overshoot", 100.0, "%"),
    ("settling to 5 %, median", "settling_s", 1.0, "s"),
    ("steps not settled", "unsettled", 1.0, ""),
    ("rms error", "error", 1.0, "y"),
    ("rms change of {}", "effort_V", 1.0, "v"),
    ("highest {}", "highest_V", 1.0, "v"),
)


def as_text(comparison: Comparison) -> str:
    """Return the comparison as a table."""
    info = comparison.found.session.info
    units = {"y": info.output_unit, "v": info.manipulated.unit}
    courses = (comparison.recorded, comparison.repeated, comparison.changed)
    rows = [f"{'':<28}{'recorded':>12}{'simulated':>12}{'changed':>12}"]
    for name, key, factor, quantity in _ROWS:
        values = (factor * getattr(one.quality, key) for one in courses)
        texts = ("-" if math.isnan(value) else f"{value:.4g}" for value in values)
        named = name.format(info.manipulated.name)
        label = f"{named} {units.get(quantity, quantity)}".rstrip()
        rows.append(f"{label:<28}" + "".join(f"{text:>12}" for text in texts))
    time_s = comparison.recorded.time_s
    rows.append(
        f"{comparison.recorded.quality.steps} steps of the set-point, between "
        f"{time_s[0]:.0f} s and {time_s[-1]:.0f} s of the session, its longest part without a gap"
    )
    rows += (
        [f"the changed loop trips: {comparison.changed.fault}"] if comparison.changed.fault else []
    )
    return "\n".join(rows)


def as_json(comparison: Comparison) -> dict[str, Any]:
    """Return the comparison as values for JSON; unknown numbers are null."""
    courses = {
        "recorded": comparison.recorded,
        "simulated": comparison.repeated,
        "changed": comparison.changed,
    }
    return {
        name: {
            key: value if math.isfinite(value) else None
            for key, value in asdict(one.quality).items()
        }
        | {"fault": one.fault}
        for name, one in courses.items()
    }


def draw_comparison(comparison: Comparison, settings: tuple[str, ...]) -> bytes:
    """Draw output and boost voltage of a session, as recorded and with other settings.

    Args:
        comparison: What to draw.
        settings: The settings, for the title.

    Returns:
        A PNG.
    """
    with style.journal():
        figure = Figure(figsize=(style.WIDTH_in, 4.6), layout="constrained")
        output, volts = figure.subplots(2, 1, sharex=True, height_ratios=(1.4, 1.0))
        _draw(output, comparison, "output")
        output.plot(
            comparison.recorded.time_s,
            comparison.recorded.reference,
            drawstyle="steps-post",
            label="set-point",
            **style.TRUTH,
        )
        _draw(volts, comparison, "boost_voltage_V")
        info = comparison.found.session.info
        unit, given = info.output_unit, info.manipulated
        output.set_ylabel(f"output ({unit})" if unit else "output")
        output.set_title(", ".join(settings) or "recorded settings")
        volts.set_title(f"{given.name}, means over slow periods")
        volts.set_ylabel(given.axis)
        volts.set_xlabel("time since the first tick (s)")
        style.legend_above(output, columns=4)
        figure.align_ylabels([output, volts])
        return as_png(figure)


def _draw(axes: Axes, comparison: Comparison, name: str) -> None:
    courses = (
        ("recorded", comparison.recorded, style.REFERENCE),
        ("simulated", comparison.repeated, style.FIXED),
        ("changed", comparison.changed, style.ADAPTIVE),
    )
    for label, one, look in courses:
        axes.plot(one.time_s, getattr(one, name), label=label, **look)
