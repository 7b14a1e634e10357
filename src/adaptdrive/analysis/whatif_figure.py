"""The figure of a session and of the same with other settings."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adaptdrive.analysis import style
from adaptdrive.analysis.figure import as_png
from adaptdrive.analysis.whatif import Comparison


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
        unit = comparison.found.session.info.output_unit
        output.set_ylabel(f"output ({unit})" if unit else "output")
        output.set_title(", ".join(settings) or "recorded settings")
        volts.set_title(r"$v_{bst}$, means over slow periods")
        volts.set_ylabel("voltage (V)")
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
