"""Recorded runs as Parquet: one row per slow period, the same bytes for the same run."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from adaptdrive_sim.experiments.case import Variant
from adaptdrive_sim.experiments.outcome import ExperimentOutcome
from adaptdrive_sim.experiments.runner import RunRecord


def write_record(path: Path, outcome: ExperimentOutcome, variant: Variant) -> None:
    """Write one run; what it was made with is in the file's metadata."""
    disturbance = outcome.disturbance
    metadata = {
        "experiment": outcome.experiment.name,
        "controller": variant,
        "design": outcome.design,
        "seed": str(outcome.seed),
        "noise": repr(disturbance.noise),
        "dropped_at_rest": str(outcome.experiment.dropped).lower(),
        "spikes": f"{disturbance.spike_share!r},{disturbance.spike_noise!r}",
    }
    table = pa.table(_columns(outcome.records[variant])).replace_schema_metadata(metadata)
    pq.write_table(table, path, compression="zstd")


def _columns(record: RunRecord) -> dict[str, pa.Array]:
    names = (
        *("time_s", "reference", "size", "output", "measured", "boost_reference_V", "applied_V"),
        *("adaptive", "accepted", "reason", "gains", "innovation", "excitation"),
    )
    columns = {name: pa.array(getattr(record, name)) for name in names}
    columns |= {f"{name}": pa.array(values) for name, values in record.estimates.items()}
    columns |= {f"{name}_std": pa.array(values) for name, values in record.deviations.items()}
    return columns
