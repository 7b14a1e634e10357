"""The load that a recorded session shows, with the on-line estimates and the configured model."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from adaptdrive.analysis.curves import find_window, read_curves
from adaptdrive.analysis.excerpts import Stretch, block_samples, read_stretches
from adaptdrive.analysis.record_load import RecordLoad
from adaptdrive.app.loads import build_load, candidate_loads
from adaptdrive.config import Configuration
from adaptdrive.control.signals import Estimate
from adaptdrive.identification.identify import FEWEST_IN_PART, identify_any
from adaptdrive.identification.proposal import proposed_model
from adaptdrive.recording.reader import Session, read_session
from adaptdrive.recording.what_if import reconfigured


@dataclass(frozen=True, slots=True)
class SessionLoad(RecordLoad):
    """The load of a recorded session.

    Attributes:
        session: The session.
        configuration: The one that it ran with.
        stretches: Parts of it that were used.
    """

    session: Session
    configuration: Configuration
    stretches: list[Stretch]


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
    long = [one for one in stretches if len(one.columns["output"]) >= FEWEST_IN_PART * block]
    excerpts = [one.excerpt for one in long]
    load = identify_any(excerpts, candidate_loads(configuration), block=block)
    nominal = structure.physical(list(structure.numerator), list(structure.denominator))
    return SessionLoad(
        name=session.path.name,
        unit=session.info.output_unit,
        ends_s=tuple(
            one.begin_s + len(one.columns["output"]) // block * block * one.period_s for one in long
        ),
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
