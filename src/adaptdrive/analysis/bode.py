"""The open-loop response of a model, its margins, and their spread by the covariance."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adaptdrive.analysis import figures
from adaptdrive.analysis.curves import Array
from adaptdrive.analysis.model import LoopMargins, Model

BAND = (2.5, 97.5)
"""Percentiles of the loads within the covariance, at the ends of a band."""

_UNITS = {"gain": "", "phase_deg": "°", "delay_s": " s"}
"""Margins, with their units in a text."""

_SHADE: figures.Look = {"color": figures.ADAPTIVE["color"], "alpha": 0.2, "linewidth": 0.0}
_DECADES = 3
_POINTS = 600


@dataclass(frozen=True, slots=True)
class LoopSpread:
    """The margins of a loop, and those of the loads that are drawn from the covariance.

    Attributes:
        margins: Of the loop.
        bands: Each margin at both percentiles of `BAND`; empty where no covariance is known.
        loads: How many loads were drawn.
        stable: How many of these the controller keeps stable.
    """

    margins: LoopMargins
    bands: dict[str, list[float]]
    loads: int
    stable: int


def spread_of(model: Model, drawn: Sequence[Model]) -> LoopSpread:
    """Return the margins of a loop, and how far the loads that were drawn spread them."""
    margins = [one.margins for one in drawn]
    values = {name: [getattr(one, name) for one in margins] for name in _UNITS if drawn}
    bands = {n: np.percentile(one, BAND, method="nearest").tolist() for n, one in values.items()}
    return LoopSpread(model.margins, bands, len(drawn), sum(one.is_stable for one in drawn))


def curves_of(model: Model, rad_per_s: Array) -> Array:
    """Return magnitude in dB and phase in degrees of L, by frequency."""
    response = model.response(rad_per_s)
    phase_deg = np.degrees(np.unwrap(np.angle(response)))
    return np.stack((20.0 * np.log10(np.abs(response)), phase_deg))


def as_text(model: Model, spread: LoopSpread) -> str:
    """Return the margins, each with the ends of its band in brackets."""
    rows, found = [f"open loop of {model.name}, T = {model.period_s:.4g} s"], spread.margins
    for name, unit in _UNITS.items():
        ends = spread.bands.get(name)
        band = f" ({ends[0]:.3g} to {ends[1]:.3g})" if ends else ""
        place = found.gain_rad_per_s if name == "gain" else found.phase_rad_per_s
        label = f"{name.partition('_')[0]} margin"
        rows.append(f"{label:<14}{getattr(found, name):.3g}{unit}{band}, {place:.3g} rad/s")
    if not model.is_stable:
        rows.append("the loop is not stable around this load: it has no margins")
    if spread.loads:
        share = f"{BAND[1] - BAND[0]:g} % of {spread.loads} loads drawn from the covariance"
        rows.append(f"in brackets   {share}, {spread.stable} of them stable")
    return "\n".join(rows)


def draw_loop(model: Model, drawn: Sequence[Model], found: LoopMargins) -> bytes:
    """Draw the open-loop response with its margins, and the band of the loads that were drawn.

    Args:
        model: The loop.
        drawn: The same around other loads, none for no band.
        found: Its margins.

    Returns:
        A PNG.
    """
    omega = np.geomspace(10.0**-_DECADES, 1.0, _POINTS) * math.pi / model.period_s
    curves, others = curves_of(model, omega), [curves_of(one, omega) for one in drawn]
    with figures.journal():
        figure = Figure(figsize=(figures.WIDTH_in, 5.0), layout="constrained")
        magnitude, phase = axes = figure.subplots(2, 1, sharex=True)
        for row, one in enumerate(axes):
            if others:
                ends = np.percentile([other[row] for other in others], BAND, axis=0)
                one.fill_between(omega, *ends, label="95 % within the covariance", **_SHADE)
            one.semilogx(omega, curves[row], label="model", **figures.ADAPTIVE)
        _draw_margin(magnitude, 0.0, found.gain_rad_per_s, -20.0 * math.log10(found.gain))
        magnitude.set_title(f"{model.name}: open loop, gain margin {found.gain:.3g}")
        magnitude.set_ylabel("magnitude (dB)")
        figures.legend_above(magnitude, columns=3)
        _draw_margin(phase, -180.0, found.phase_rad_per_s, found.phase_deg - 180.0)
        phase.set_title(f"Phase margin {found.phase_deg:.3g}°, delay margin {found.delay_s:.3g} s")
        phase.set_ylabel("phase (°)")
        phase.set_xlabel("frequency (rad/s)")
        phase.set_xlim(omega[0], omega[-1])
        figure.align_ylabels([magnitude, phase])
        return figures.as_png(figure)


def _draw_margin(axes: Axes, level: float, rad_per_s: float, end: float) -> None:
    """Draw the level that a margin is counted from, and the margin; one that is infinite is not."""
    axes.axhline(level, **figures.TRUTH)
    if math.isfinite(rad_per_s):
        axes.plot([rad_per_s] * 2, [level, end], marker=".", label="margin", **figures.FIXED)
