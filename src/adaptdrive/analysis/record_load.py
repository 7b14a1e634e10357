"""The load that a record shows, a CSV file, a table, a simulation or a session."""

import math
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from adaptdrive.analysis import closed_loop
from adaptdrive.analysis.columns import Columns, columns_of_file, columns_of_table
from adaptdrive.analysis.curves import find_window, read_curves
from adaptdrive.analysis.excerpts import Stretch, block_samples, divided, read_stretches
from adaptdrive.analysis.record import RecordView, read_record
from adaptdrive.app.loads import build_load, candidate_loads
from adaptdrive.config import Configuration, load_configuration
from adaptdrive.control.loads import motor
from adaptdrive.control.loads.bath import bath_load
from adaptdrive.control.loads.load import Load
from adaptdrive.control.signals import Estimate
from adaptdrive.identification import excerpt, identify
from adaptdrive.identification.result import IdentifiedLoad
from adaptdrive.recording.reader import Session, read_session
from adaptdrive.recording.replay import reconfigured
from adaptdrive.util.errors import IdentificationError

# The load that any record shows; that of a recorded session with the on-line estimates, too.

_MOST_BLOCKS = 4000

Part = tuple[float, excerpt.Excerpt]
"""Time in s at which an uninterrupted part of a record begins, and its samples."""


@dataclass(frozen=True, slots=True)
class RecordLoad:
    """The load of a record.

    Attributes:
        name: Of the record.
        unit: Of the output; empty where it is not known.
        ends_s: Time at the end of the last block of each part of the record.
        load: The identified load.
        online: Last estimates of the daemon; empty where there are none.
        nominal: Parameters of the configured model; empty where there is none.
        model: Keys of `[load.model]`; gain and time constants without a configuration.
        left_out: Parts of the record that have too few samples.
    """

    name: str
    unit: str
    ends_s: tuple[float, ...]
    load: IdentifiedLoad
    online: dict[str, Estimate]
    nominal: dict[str, float]
    model: dict[str, Estimate]
    left_out: int


def _used(parts: list[Part], load: IdentifiedLoad, block: int) -> tuple[tuple[float, ...], int]:
    """Return the time at the end of each part that a fit used, and how many it left out."""
    used = [parts[place] for place in load.used]
    ends_s = (begin_s + len(one.output) // block * block * one.period_s for begin_s, one in used)
    return tuple(ends_s), len(parts) - len(used)


def _of_drive(name: str, parts: list[Part], block: int, configuration: Configuration) -> RecordLoad:
    """Return the load between the boost voltage and the output of a drive."""
    structure, excerpts = build_load(configuration), [one for _, one in parts]
    load = identify.identify_any(excerpts, candidate_loads(configuration), block=block)
    ends_s, left_out = _used(parts, load, block)
    nominal = structure.physical(list(structure.numerator), list(structure.denominator))
    return RecordLoad(
        name=name,
        unit=configuration.load.output_unit,
        ends_s=ends_s,
        load=load,
        online={},
        nominal=dict(zip(structure.names, nominal, strict=True)),
        model=identify.proposed_model(load, configuration.load),
        left_out=left_out,
    )


def plain_load(lags: int) -> Load:
    """Return the structure of a load whose input is measured.

    Raises:
        IdentificationError: It is of no order that can be identified.
    """
    if lags == 1:
        bath = bath_load(1.0, 1.0, 1.0, 0.0, 1.0)
        return replace(bath, input_gain=1.0, input_exponent=1, names=("gain", "tau_s"))
    if lags != 2:
        raise IdentificationError(f"{lags} lags: a load has one or two")
    return motor.motor_load(1.0, 1.0, 1.0)


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
    stretches = read_stretches(session, begin_s, end_s)
    parts = [(one.begin_s, one.excerpt) for one in stretches]
    found = _of_drive(session.path.name, parts, block_samples(stretches), configuration)
    known = {one.name: getattr(found, one.name) for one in fields(found)}
    known["online"] = _online(session, tuple(found.nominal), end_s)
    known["left_out"] += divided(session, begin_s, end_s).count(None)
    used = [stretches[place] for place in found.load.used]
    return SessionLoad(**known, session=session, configuration=configuration, stretches=used)


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


# The load of whatever contains a record: a CSV file, a table, a simulation or a session.

_MEASURED = RecordView("boost_voltage_V", "output", "time_s", held=False)
"""Columns of a simulation, which are taken at once."""


def identify_source(
    source: Any,  # noqa: ANN401 - a table of any library too
    view: RecordView,
) -> RecordLoad:
    """Identify the load of a record.

    Args:
        source: A session's folder, a CSV file, a simulation, or a table.
        view: Which columns and which part of it.

    Raises:
        AdaptdriveError: The record cannot be read, or does not show its load.
    """
    if isinstance(source, str | Path):
        path = Path(source)
        if path.is_file():
            return _identify(columns_of_file(path), path.name, view)
        _refuse_columns(view, "a session")
        return identify_session(path, view.begin_s, view.end_s)
    if isinstance(source, closed_loop.Simulation):
        _refuse_columns(view, "a simulation")
        measured = replace(_MEASURED, begin_s=view.begin_s, end_s=view.end_s)
        measured = replace(measured, config=source.configuration)
        return _identify(columns_of_table(source.ticks), "simulation", measured)
    return _identify(columns_of_table(source), "table", view)


def _identify(columns: Columns, name: str, view: RecordView) -> RecordLoad:
    config = view.config
    if isinstance(config, str | Path):
        config = load_configuration(Path(config))
    parts = read_record(columns, replace(view, config=config))
    block = math.ceil(sum(len(one.output) for _, one in parts) / _MOST_BLOCKS)
    if config is None:
        return _of_any(name, parts, block, view.lags)
    if view.lags is not None:
        raise IdentificationError("lags and a configuration were given: it says how many there are")
    return _of_drive(name, parts, block, config)


def _of_any(name: str, parts: list[Part], block: int, lags: int | None) -> RecordLoad:
    """Return the load between any input and output, with the lags that the record shows."""
    structures = [plain_load(count) for count in ((1, 2) if lags is None else (lags,))]
    load = identify.identify_any([one for _, one in parts], structures, block=block)
    ends_s, left_out = _used(parts, load, block)
    return RecordLoad(name, "", ends_s, load, {}, {}, identify.time_constants(load), left_out)


def _refuse_columns(view: RecordView, kind: str) -> None:
    """Refuse what a record without a choice of columns does not take."""
    if view != RecordView(begin_s=view.begin_s, end_s=view.end_s):
        raise IdentificationError(
            f"{kind} has its columns, its times and its configuration: leave out all but the times "
            "at which the used part begins and ends"
        )
