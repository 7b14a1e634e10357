"""The load that a recorded session shows, beside the on-line estimates and the configured model."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from adaptdrive.analysis.curves import find_window, read_curves
from adaptdrive.analysis.excerpts import Stretch, block_samples, read_stretches
from adaptdrive.app.loads import build_load
from adaptdrive.config import Configuration
from adaptdrive.control.signals import Estimate
from adaptdrive.identification.identify import identify
from adaptdrive.identification.proposal import proposed_model
from adaptdrive.identification.result import IdentifiedLoad
from adaptdrive.recording.reader import Session, read_session
from adaptdrive.recording.what_if import reconfigured

NOT_WHITE = 0.01
"""Probability of white residuals below which they count as coloured."""

_FEWEST_BLOCKS = 10
"""Blocks of a part of a session below which it is left out."""


@dataclass(frozen=True, slots=True)
class SessionLoad:
    """The load of a recorded session.

    Attributes:
        session: The session.
        configuration: The one that it ran with.
        stretches: Parts of it that were used.
        load: The identified load.
        online: Last estimates of the daemon; NaN where there are none.
        nominal: Parameters of the configured model.
        model: Proposed keys of `[load.model]`.
    """

    session: Session
    configuration: Configuration
    stretches: list[Stretch]
    load: IdentifiedLoad
    online: dict[str, Estimate]
    nominal: dict[str, float]
    model: dict[str, Estimate]


def identify_session(
    path: Path, begin_s: float | None = None, end_s: float | None = None
) -> SessionLoad:
    """Identify the load of a recorded session.

    Args:
        path: Directory of the session.
        begin_s: First second used, from the first tick on; None for the first.
        end_s: Last second used, None for the last.

    Raises:
        AdaptdriveError: The session cannot be read, or does not show its load.
    """
    session = read_session(path)
    configuration = reconfigured(session.config_text, path / "config.toml", ())
    structure = build_load(configuration)
    stretches = read_stretches(session, begin_s, end_s)
    block = block_samples(stretches)
    long = [one for one in stretches if len(one.columns["output"]) >= _FEWEST_BLOCKS * block]
    load = identify([one.excerpt for one in long], structure, block=block)
    nominal = structure.physical(list(structure.numerator), list(structure.denominator))
    return SessionLoad(
        session=session,
        configuration=configuration,
        stretches=long,
        load=load,
        online=_online(session, structure.names, end_s),
        nominal=dict(zip(structure.names, nominal, strict=True)),
        model=proposed_model(load, configuration.load),
    )


def _online(session: Session, names: tuple[str, ...], end_s: float | None) -> dict[str, Estimate]:
    """Return the last on-line estimates before a time."""
    curves = read_curves(session, find_window(session, None, end_s))
    found = {}
    for name in names:
        known = [
            Estimate(float(value), float(std))
            for value, std in zip(*curves.estimates.get(name, ((), ())), strict=True)
            if math.isfinite(value)
        ]
        found[name] = known[-1] if known else Estimate(math.nan, math.nan)
    return found


def as_text(found: SessionLoad) -> str:
    """Return the result as a table, the checks, and a proposed `[load.model]`."""
    load = found.load
    rows = [f"{'parameter':<20}{'record':>24}{'on-line':>24}{'[load.model]':>14}"]
    for name, value in load.parameters.items():
        nominal = found.nominal[name]
        rows.append(f"{name:<20}{_pm(value):>24}{_pm(found.online[name]):>24}{nominal:>14.5g}")
    rows += ["", *_checks(found), "", "[load.model]  # proposed"]
    rows += [f"{name} = {one.value:.5g}  # ± {one.std:.2g}" for name, one in found.model.items()]
    return "\n".join(rows)


def _checks(found: SessionLoad) -> list[str]:
    load = found.load
    used_s = sum(len(part) for part in load.residuals) * load.block_s
    white = "white" if load.whiteness >= NOT_WHITE else "not white: the deviations are too small"
    noise = f"{load.noise_std:.3g} {found.session.info.output_unit}".rstrip()
    rows = {
        "data": f"{used_s:.6g} s in {len(load.residuals)} parts, means of {load.block_s:.4g} s",
        "fit": _percent(load.fit),
        "cross-check": f"{_percent(load.cross_fit)} of the last 30 % from the first 70 %",
        "residuals": f"{noise}, {white} (p = {load.whiteness:.2g})",
        "noise model": f"order {len(load.noise) - 1}",
        "dead time": f"{load.delay_s * 1e3:.3g} ms",
        "input offset": _pm(load.input_offset),
    }
    return [f"{name:<16}{text}" for name, text in rows.items()]


def as_json(found: SessionLoad) -> dict[str, Any]:
    """Return the result as values for JSON; unknown numbers are null."""
    load = found.load
    return {
        "session": found.session.path.name,
        "parameters": _values(load.parameters),
        "online": _values(found.online),
        "nominal": found.nominal,
        "model": _values(found.model),
        "input_offset": _values({"offset": load.input_offset})["offset"],
        "delay_s": load.delay_s,
        "noise": list(load.noise),
        "noise_std": load.noise_std,
        "whiteness": load.whiteness,
        "fit": _known(load.fit),
        "cross_fit": _known(load.cross_fit),
        "block_s": load.block_s,
    }


def _values(estimates: dict[str, Estimate]) -> dict[str, dict[str, float | None]]:
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
