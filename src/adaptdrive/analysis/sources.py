"""The load of whatever contains a record: a CSV file, a table, a simulation or a session."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from adaptdrive.analysis.columns import Columns, columns_of_file, columns_of_table
from adaptdrive.analysis.record import RecordView, read_record
from adaptdrive.analysis.record_load import RecordLoad, identify_record, identify_session
from adaptdrive.analysis.simulation import Simulation
from adaptdrive.config import load_configuration
from adaptdrive.util.errors import IdentificationError

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
    if isinstance(source, Simulation):
        _refuse_columns(view, "a simulation")
        measured = replace(_MEASURED, begin_s=view.begin_s, end_s=view.end_s)
        measured = replace(measured, config=source.configuration)
        return _identify(columns_of_table(source.ticks), "simulation", measured)
    return _identify(columns_of_table(source), "table", view)


def _identify(columns: Columns, name: str, view: RecordView) -> RecordLoad:
    config = view.config
    if isinstance(config, str | Path):
        config = load_configuration(Path(config))
    record = read_record(columns, replace(view, config=config))
    return identify_record(record, name, config, view.lags)


def _refuse_columns(view: RecordView, kind: str) -> None:
    """Refuse what a record without a choice of columns does not take."""
    if view != RecordView(begin_s=view.begin_s, end_s=view.end_s):
        raise IdentificationError(
            f"{kind} has its columns, its times and its configuration: leave out all but the times "
            "at which the used part begins and ends"
        )
