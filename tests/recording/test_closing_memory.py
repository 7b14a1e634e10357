"""The memory that a recorder needs to close a segment, in a process of its own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa

from adaptdrive.recording.streams import StreamWriter

SCHEMA = pa.schema([(f"column_{number}", pa.float64()) for number in range(20)])
ROWS = 432_000
"""Half cycles of an hour at 120 Hz."""

MEASURE = """
import sys
from pathlib import Path
import pyarrow as pa
from adaptdrive.recording.streams import convert

def of_status(name):
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith(name)).split()[1])

before = of_status("VmRSS")
convert(Path(sys.argv[1]), Path(sys.argv[2]))
print(of_status("VmHWM") - before)
"""


def test_closing_an_hour_takes_the_memory_of_minutes(tmp_path: Path) -> None:
    """An hour of these columns takes 66 MiB; a segment of 25,000 rows 4 MiB, and its copies."""
    path, target = tmp_path / "ticks.arrows", tmp_path / "ticks.parquet"
    values = np.random.default_rng(0).standard_normal((len(SCHEMA), 1200))
    stream = StreamWriter(path, SCHEMA)
    for _ in range(ROWS // 1200):
        stream.write(pa.RecordBatch.from_arrays([pa.array(row) for row in values], schema=SCHEMA))
    stream.close()
    command = [sys.executable, "-c", MEASURE, str(path), str(target)]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    assert target.exists()
    assert int(run.stdout) / 1024 < 50
