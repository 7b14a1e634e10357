"""The load of a record as a table, as values for JSON, and as a figure."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adaptdrive.analysis import figures
from adaptdrive.analysis.record import RecordLoad
from adaptdrive.control.signals import Estimate
from adaptdrive.identification.excerpt import Array
from adaptdrive.identification.result import IdentifiedLoad

_LAGS = 40
_WHITE_BAND = 1.96
_NOT_WHITE = 0.01
"""Probability of white residuals below which they count as coloured."""

_UNKNOWN = Estimate(math.nan, math.nan)


def as_text(found: RecordLoad) -> str:
    """Return the result as a table, the checks, and the proposed values."""
    load = found.load
    rows = [f"{'parameter':<20}{'record':>24}{'simulation':>24}{'on-line':>24}{'[load.model]':>14}"]
    for name, value in load.parameters.items():
        pairs = (value, load.simulated_parameters[name], found.online.get(name, _UNKNOWN))
        nominal = f"{found.nominal[name]:.5g}" if name in found.nominal else "-"
        rows.append(f"{name:<20}{''.join(f'{_pm(one):>24}' for one in pairs)}{nominal:>14}")
    rows += ["", *checks(load, found.unit, found.left_out), ""]
    rows += ["[load.model]  # proposed"] if found.nominal else []
    rows += [f"{name} = {one.value:.5g}  # ± {one.std:.2g}" for name, one in found.model.items()]
    return "\n".join(rows)


def checks(load: IdentifiedLoad, unit: str, left_out: int = 0) -> Iterator[str]:
    """Yield what judges a fit, and a warning for each parameter of which both fits disagree.

    Args:
        load: The fit.
        unit: Of the output.
        left_out: Parts of the record that have too few samples.
    """
    means = f"means of {load.block_s:.4g} s"
    means += f", {left_out} parts of too few samples left out" if left_out else ""
    used_s = sum(len(part) for part in load.residuals) * load.block_s
    white = "white"
    if load.whiteness < _NOT_WHITE:
        white = "not white: the deviations are wider for it, and may still be too small"
    noise = f"{load.noise_std:.3g} {unit}".rstrip()
    rows = {
        "data": f"{used_s:.6g} s in {len(load.residuals)} parts, {means}",
        "fit": _percent(load.fit),
        "cross-check": f"{_percent(load.cross_fit)} of the last 30 % from the first 70 %",
        "residuals": f"{noise}, {white} (p = {load.whiteness:.2g})",
        "noise model": f"order {len(load.noise) - 1}",
        "dead time": f"{load.delay_s:.3g} ± {load.delay_std_s:.2g} s",
        "input offset": _pm(load.input_offset),
    }
    for name, text in rows.items():
        yield f"{name:<16}{text}"
    for name in load.disputed:
        one, other = load.parameters[name], load.simulated_parameters[name]
        yield (
            f"{'warning':<16}{name} is {_pm(one)} by prediction errors and {_pm(other)} by "
            "simulation: the record has slower movements than the load, or a controller moved the "
            "input by its noise; what the model is for decides"
        )


_OF_LOAD = (
    *("parameters", "disputed", "input_offset", "delay_s", "delay_std_s", "noise", "noise_std"),
    *("whiteness", "fit", "cross_fit", "block_s"),
)


def as_json(found: RecordLoad) -> dict[str, Any]:
    """Return the result for JSON."""
    values = {name: getattr(found.load, name) for name in _OF_LOAD}
    values |= {name: getattr(found, name) for name in ("online", "nominal", "model", "left_out")}
    simulated, parts = found.load.simulated_parameters, len(found.load.residuals)
    return {"record": found.name, "simulated": simulated, "parts": parts, **values}


def _pm(estimate: Estimate) -> str:
    if math.isnan(estimate.value):
        return "-"
    return f"{estimate.value:.5g} ± {estimate.std:.2g}"


def _percent(share: float) -> str:
    return "-" if math.isnan(share) else f"{100.0 * share:.1f} %"


def draw_load(found: RecordLoad) -> bytes:
    """Draw the identified load of a record.

    Args:
        found: The load.

    Returns:
        A PNG.
    """
    with figures.journal():
        figure = Figure(figsize=(figures.WIDTH_in, 5.6), layout="constrained")
        output, residual, correlation = figure.subplots(3, 1, height_ratios=(1.6, 1.0, 1.0))
        residual.sharex(output)
        _draw_output(output, found)
        _draw_residuals(residual, found)
        _draw_correlation(correlation, found.load)
        figure.align_ylabels([output, residual, correlation])
        return figures.as_png(figure)


def _times_s(found: RecordLoad) -> list[Array]:
    """Return the middle of each block."""
    block_s = found.load.block_s
    return [
        end_s - block_s * (np.arange(len(part), dtype=np.float64)[::-1] + 0.5)
        for end_s, part in zip(found.ends_s, found.load.residuals, strict=True)
    ]


def _draw_output(axes: Axes, found: RecordLoad) -> None:
    parts = zip(_times_s(found), found.load.simulated, found.load.residuals, strict=True)
    for number, (time_s, simulated, residual) in enumerate(parts):
        names = ("measured", "simulated") if number == 0 else ("", "")
        axes.plot(time_s, simulated + residual, label=names[0], **figures.REFERENCE)
        axes.plot(time_s, simulated, label=names[1], **figures.ADAPTIVE)
    fit = f", fit {100.0 * found.load.fit:.1f} %" if math.isfinite(found.load.fit) else ""
    axes.set_title(f"{found.name}: measured and simulated output{fit}")
    axes.set_ylabel(figures.labelled("output", found.unit))
    figures.legend_above(axes, columns=2)


def _draw_residuals(axes: Axes, found: RecordLoad) -> None:
    for time_s, residual in zip(_times_s(found), found.load.residuals, strict=True):
        axes.plot(time_s, residual, **(figures.FIXED | {"linewidth": 0.5}))
    axes.axhline(0.0, **figures.TRUTH)
    axes.set_title("Measured less simulated")
    axes.set_xlabel("time since the start of the record (s)")
    axes.set_ylabel(figures.labelled("residual", found.unit))


def _draw_correlation(axes: Axes, load: IdentifiedLoad) -> None:
    errors = max(load.errors, key=len)
    lags = np.arange(1, min(_LAGS, len(errors) // 4) + 1)
    power = float(errors @ errors) or 1.0
    axes.bar(lags, [float(errors[lag:] @ errors[:-lag]) / power for lag in lags], color="0.4")
    band = _WHITE_BAND / math.sqrt(len(errors))
    axes.axhspan(-band, band, color=figures.ADAPTIVE["color"], alpha=0.15, linewidth=0)
    axes.set_title(f"Autocorrelation of the prediction errors, p = {load.whiteness:.2g}")
    axes.set_xlabel(f"lag (blocks of {load.block_s:.4g} s)")
    axes.set_ylabel("correlation")
