"""The memory that a recorder needs to close a segment, in a process of its own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa

from adaptdrive.recording.streams import StreamWriter

SCHEMA = pa.schema([(f"column_{number}", pa.float64()) for number in range(20)])
MEASURE = """
import sys
import threading
from pathlib import Path
from adaptdrive.recording.streams import convert

def of_status(name):
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith(name)).split()[1])

before = of_status("VmRSS")
housekeeper = threading.Thread(target=convert, args=map(Path, sys.argv[1:3]))
housekeeper.start()
housekeeper.join()
print((of_status("VmHWM") - before) / 1024, (of_status("VmRSS") - before) / 1024)
"""


def test_closing_an_hour_takes_the_memory_of_minutes(tmp_path: Path) -> None:
    """An hour of these columns takes 66 MiB; a segment of 25,000 rows 4 MiB, and its copies."""
    peak_MiB, _ = close(tmp_path, batches=360, rows=1200)
    assert peak_MiB < 50


def test_what_many_small_batches_took_is_given_back(tmp_path: Path) -> None:
    """Four batches in a second, as a recorder writes them: 25,000 rows have 830."""
    _, kept_MiB = close(tmp_path, batches=3600, rows=30)
    assert kept_MiB < 30


def close(folder: Path, batches: int, rows: int) -> tuple[float, float]:
    """Close a stream; return by how much the resident memory grew at its peak, and afterwards."""
    path, target = folder / "ticks.arrows", folder / "ticks.parquet"
    values = np.random.default_rng(0).standard_normal((len(SCHEMA), rows))
    stream = StreamWriter(path, SCHEMA)
    for _ in range(batches):
        stream.write(pa.RecordBatch.from_arrays([pa.array(row) for row in values], schema=SCHEMA))
    stream.close()
    command = [sys.executable, "-c", MEASURE, str(path), str(target)]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    assert target.exists()
    peak_MiB, kept_MiB = map(float, run.stdout.split())
    return peak_MiB, kept_MiB
