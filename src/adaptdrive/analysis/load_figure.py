"""The figure of an identified load: measured and simulated output, residuals, their correlation."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from adaptdrive.analysis import style
from adaptdrive.analysis.figure import as_png
from adaptdrive.analysis.record_load import RecordLoad
from adaptdrive.identification.result import IdentifiedLoad

Array = NDArray[np.float64]

_LAGS = 40
_WHITE_BAND = 1.96


def draw_load(found: RecordLoad) -> bytes:
    """Draw the identified load of a record.

    Args:
        found: The load.

    Returns:
        A PNG.
    """
    with style.journal():
        figure = Figure(figsize=(style.WIDTH_in, 5.6), layout="constrained")
        output, residual, correlation = figure.subplots(3, 1, height_ratios=(1.6, 1.0, 1.0))
        residual.sharex(output)
        unit = found.unit
        _draw_output(output, found, f"output ({unit})" if unit else "output")
        _draw_residuals(residual, found, f"residual ({unit})" if unit else "residual")
        _draw_correlation(correlation, found.load)
        figure.align_ylabels([output, residual, correlation])
        return as_png(figure)


def _times_s(found: RecordLoad) -> list[Array]:
    """Return the middle of each block."""
    block_s = found.load.block_s
    return [
        end_s - block_s * (np.arange(len(part), dtype=np.float64)[::-1] + 0.5)
        for end_s, part in zip(found.ends_s, found.load.residuals, strict=True)
    ]


def _draw_output(axes: Axes, found: RecordLoad, label: str) -> None:
    parts = zip(_times_s(found), found.load.simulated, found.load.residuals, strict=True)
    for number, (time_s, simulated, residual) in enumerate(parts):
        names = ("measured", "simulated") if number == 0 else ("", "")
        axes.plot(time_s, simulated + residual, label=names[0], **style.REFERENCE)
        axes.plot(time_s, simulated, label=names[1], **style.ADAPTIVE)
    fit = f", fit {100.0 * found.load.fit:.1f} %" if math.isfinite(found.load.fit) else ""
    axes.set_title(f"{found.name}: measured and simulated output{fit}")
    axes.set_ylabel(label)
    style.legend_above(axes, columns=2)


def _draw_residuals(axes: Axes, found: RecordLoad, label: str) -> None:
    for time_s, residual in zip(_times_s(found), found.load.residuals, strict=True):
        axes.plot(time_s, residual, **(style.FIXED | {"linewidth": 0.5}))
    axes.axhline(0.0, **style.TRUTH)
    axes.set_title("Measured less simulated")
    axes.set_xlabel("time since the start of the record (s)")
    axes.set_ylabel(label)


def _draw_correlation(axes: Axes, load: IdentifiedLoad) -> None:
    errors = max(load.errors, key=len)
    lags = np.arange(1, min(_LAGS, len(errors) // 4) + 1)
    power = float(errors @ errors) or 1.0
    axes.bar(lags, [float(errors[lag:] @ errors[:-lag]) / power for lag in lags], color="0.4")
    band = _WHITE_BAND / math.sqrt(len(errors))
    axes.axhspan(-band, band, color=style.ADAPTIVE["color"], alpha=0.15, linewidth=0)
    axes.set_title(f"Autocorrelation of the prediction errors, p = {load.whiteness:.2g}")
    axes.set_xlabel(f"lag (blocks of {load.block_s:.4g} s)")
    axes.set_ylabel("correlation")
