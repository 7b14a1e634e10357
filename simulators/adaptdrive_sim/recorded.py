"""A run as a table for a file: a row for each slow period."""

from __future__ import annotations

from typing import Any

import pyarrow as pa

from adaptdrive_sim.course import Run

_FLAGS = ("adaptive", "accepted", "fallback")


def table_of(run: Run, **constant: str) -> pa.Table:
    """Return the columns of a run, and of its decisions what the columns do not have.

    Args:
        run: A run of the interpreter.
        constant: Columns that have one value.
    """
    rest = len(run.trace) - len(run.decisions)
    columns: dict[str, Any] = {name: run[name] for name in run.names}
    columns |= {name: run[name] > 0.0 for name in _FLAGS if name in run.names}
    columns["reason"] = [one.reason for one in run.decisions] + [""] * rest
    columns["gains"] = [list(one.gains) for one in run.decisions] + [None] * rest
    columns["excitation"] = [one.excitation for one in run.decisions] + [None] * rest
    columns |= {name: [value] * len(run.trace) for name, value in constant.items()}
    return pa.table(columns)
