"""The load of a record as a table, and as values for JSON."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from adaptdrive.analysis.record_load import RecordLoad
from adaptdrive.control.signals import Estimate
from adaptdrive.identification.result import IdentifiedLoad

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
    rows += ["", *checks(load, found.unit), *warnings(load), ""]
    rows += ["[load.model]  # proposed"] if found.nominal else []
    rows += [f"{name} = {one.value:.5g}  # ± {one.std:.2g}" for name, one in found.model.items()]
    return "\n".join(rows)


def checks(load: IdentifiedLoad, unit: str) -> Iterator[str]:
    """Yield what judges a fit.

    Args:
        load: The fit.
        unit: Of the output.
    """
    used_s = sum(len(part) for part in load.residuals) * load.block_s
    white = "white"
    if load.whiteness < _NOT_WHITE:
        white = "not white: the deviations are wider for it, and may still be too small"
    noise = f"{load.noise_std:.3g} {unit}".rstrip()
    rows = {
        "data": f"{used_s:.6g} s in {len(load.residuals)} parts, means of {load.block_s:.4g} s",
        "fit": _percent(load.fit),
        "cross-check": f"{_percent(load.cross_fit)} of the last 30 % from the first 70 %",
        "residuals": f"{noise}, {white} (p = {load.whiteness:.2g})",
        "noise model": f"order {len(load.noise) - 1}",
        "dead time": f"{load.delay_s:.3g} ± {load.delay_std_s:.2g} s",
        "input offset": _pm(load.input_offset),
    }
    for name, text in rows.items():
        yield f"{name:<16}{text}"


def warnings(load: IdentifiedLoad) -> Iterator[str]:
    """Yield a line for each parameter of which both fits differ by more than chance."""
    for name in load.disputed:
        one, other = load.parameters[name], load.simulated_parameters[name]
        yield (
            f"{'warning':<16}{name} is {_pm(one)} by prediction errors and {_pm(other)} by "
            "simulation: the record has slower movements than the load, or a controller moved the "
            "input by its noise; what the model is for decides"
        )


def as_json(found: RecordLoad) -> dict[str, Any]:
    """Return the result as values for JSON; unknown numbers are null."""
    load = found.load
    return {
        "record": found.name,
        "parameters": _values(load.parameters),
        "simulated": _values(load.simulated_parameters),
        "disputed": list(load.disputed),
        "online": _values(found.online),
        "nominal": found.nominal,
        "model": _values(found.model),
        "input_offset": _values({"offset": load.input_offset})["offset"],
        "delay_s": load.delay_s,
        "delay_std_s": load.delay_std_s,
        "noise": list(load.noise),
        "noise_std": load.noise_std,
        "whiteness": load.whiteness,
        "fit": _known(load.fit),
        "cross_fit": _known(load.cross_fit),
        "block_s": load.block_s,
    }


def _values(estimates: Mapping[str, Estimate]) -> dict[str, dict[str, float | None]]:
    return {
        name: {"value": _known(one.value), "std": _known(one.std)}
        for name, one in estimates.items()
    }


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _pm(estimate: Estimate) -> str:
    if math.isnan(estimate.value):
        return "-"
    return f"{estimate.value:.5g} ± {estimate.std:.2g}"


def _percent(share: float) -> str:
    return "-" if math.isnan(share) else f"{100.0 * share:.1f} %"
