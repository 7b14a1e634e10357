"""The open-loop response of a model, its margins, and their spread by the covariance."""

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adaptdrive.analysis import figures
from adaptdrive.analysis.curves import Array
from adaptdrive.analysis.load_report import known
from adaptdrive.analysis.model import LoopMargins, Model

BAND = (2.5, 97.5)
"""Percentiles of the loads within the covariance, at the ends of a band."""

_UNITS = {"gain": "", "phase_deg": "°", "delay_s": " s"}
"""Margins, with their units in a text."""

_DECADES = 3
_POINTS = 600


@dataclass(frozen=True, slots=True)
class LoopSpread:
    """A loop, and those of the loads that are drawn from the covariance.

    Attributes:
        model: The model.
        margins: Its margins.
        bands: Each margin at both percentiles of `BAND`; empty where no covariance is known.
        loads: How many loads were drawn.
        stable: How many of these the controller keeps stable.
        rad_per_s: Frequencies, three decades up to half the sampling rate.
        curves: Magnitude in dB and phase in degrees of L there, by frequency.
        band: The same at both percentiles, NaN where no covariance is known.
    """

    model: Model
    margins: LoopMargins
    bands: dict[str, list[float]]
    loads: int
    stable: int
    rad_per_s: Array
    curves: Array
    band: Array


def spread_of(model: Model) -> LoopSpread:
    """Return the response of a loop, and how far the covariance of its load spreads it."""
    omega = np.geomspace(10.0**-_DECADES, 1.0, _POINTS) * math.pi / model.period_s
    drawn = list(model.drawn())
    margins = [one.margins for one in drawn]
    values = {name: [getattr(one, name) for one in margins] for name in _UNITS if drawn}
    curves = [_curves(one, omega) for one in drawn] or [np.full((2, _POINTS), math.nan)]
    return LoopSpread(
        model=model,
        margins=model.margins,
        bands={n: np.percentile(one, BAND, method="nearest").tolist() for n, one in values.items()},
        loads=len(drawn),
        stable=sum(one.is_stable for one in drawn),
        rad_per_s=omega,
        curves=_curves(model, omega),
        band=np.percentile(curves, BAND, axis=0),
    )


def _curves(model: Model, rad_per_s: Array) -> Array:
    response = model.response(rad_per_s)
    phase_deg = np.degrees(np.unwrap(np.angle(response)))
    return np.stack((20.0 * np.log10(np.abs(response)), phase_deg))


def as_text(spread: LoopSpread) -> str:
    """Return the margins, each with the ends of its band in brackets."""
    rows = [f"open loop of {spread.model.name}, T = {spread.model.period_s:.4g} s"]
    for name, unit in _UNITS.items():
        ends = spread.bands.get(name)
        band = f" ({ends[0]:.3g} to {ends[1]:.3g})" if ends else ""
        place = spread.margins.gain_rad_per_s if name == "gain" else spread.margins.phase_rad_per_s
        label, value = f"{name.partition('_')[0]} margin", getattr(spread.margins, name)
        rows.append(f"{label:<14}{value:.3g}{unit}{band}, {place:.3g} rad/s")
    if spread.loads:
        share = f"{BAND[1] - BAND[0]:g} % of {spread.loads} loads drawn from the covariance"
        rows.append(f"in brackets   {share}, {spread.stable} of them stable")
    return "\n".join(rows)


def as_json(spread: LoopSpread) -> dict[str, Any]:
    """Return the margins as values for JSON; those that do not exist are null."""
    margins = {name: known(value) for name, value in asdict(spread.margins).items()}
    bands = {name: [known(one) for one in ends] for name, ends in spread.bands.items()}
    return {"margins": margins, "bands": bands, "loads": spread.loads, "stable": spread.stable}


def draw_loop(spread: LoopSpread) -> bytes:
    """Draw the open-loop response with its margins and its band.

    Returns:
        A PNG.
    """
    found, model = spread.margins, spread.model
    with figures.journal():
        figure = Figure(figsize=(figures.WIDTH_in, 5.0), layout="constrained")
        magnitude, phase = figure.subplots(2, 1, sharex=True)
        _draw_curve(magnitude, spread, 0)
        _draw_margin(magnitude, 0.0, found.gain_rad_per_s, -20.0 * math.log10(found.gain))
        magnitude.set_title(f"{model.name}: open loop, gain margin {found.gain:.3g}")
        magnitude.set_ylabel("magnitude (dB)")
        figures.legend_above(magnitude, columns=3)
        _draw_curve(phase, spread, 1)
        _draw_margin(phase, -180.0, found.phase_rad_per_s, found.phase_deg - 180.0)
        phase.set_title(f"Phase margin {found.phase_deg:.3g}°, delay margin {found.delay_s:.3g} s")
        phase.set_ylabel("phase (°)")
        phase.set_xlabel("frequency (rad/s)")
        phase.set_xlim(spread.rad_per_s[0], spread.rad_per_s[-1])
        figure.align_ylabels([magnitude, phase])
        return figures.as_png(figure)


def _draw_curve(axes: Axes, spread: LoopSpread, row: int) -> None:
    if spread.loads:
        look = {"color": figures.ADAPTIVE["color"], "alpha": 0.2, "linewidth": 0.0}
        label = f"{BAND[1] - BAND[0]:g} % within the covariance"
        axes.fill_between(spread.rad_per_s, *spread.band[:, row], label=label, **look)
    axes.semilogx(spread.rad_per_s, spread.curves[row], label="model", **figures.ADAPTIVE)


def _draw_margin(axes: Axes, level: float, rad_per_s: float, end: float) -> None:
    """Draw the level that a margin is counted from, and the margin; one that is infinite is not."""
    axes.axhline(level, **figures.TRUTH)
    if math.isfinite(rad_per_s):
        axes.plot([rad_per_s] * 2, [level, end], marker=".", label="margin", **figures.FIXED)
