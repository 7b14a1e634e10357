from pathlib import Path

import pyarrow as pa
import pytest
from pyarrow import parquet as pq

from adaptdrive.errors import RecordingError
from adaptdrive.recording.batches import TickTable
from adaptdrive.recording.streams import StreamReader, StreamWriter, convert
from adaptdrive.recording.tables import SLOW_SCHEMA, TICKS_SCHEMA, ticks_batch
from tests.recording.material import make_tick

BATCHES = 4
ROWS = 5


def write_stream(path: Path) -> list[int]:
    """Write a stream; the length of the file after each batch."""
    lengths = []
    stream = StreamWriter(path, TICKS_SCHEMA)
    for index in range(BATCHES):
        table = TickTable()
        table.extend([make_tick(index * ROWS + row) for row in range(ROWS)])
        stream.write(ticks_batch(table.packed(), table.rows))
        lengths.append(path.stat().st_size)
    stream.close()
    return lengths


def read_stream(path: Path) -> tuple[list[int], bool]:
    reader = StreamReader(path, TICKS_SCHEMA)
    table = pa.Table.from_batches(list(reader.batches()), TICKS_SCHEMA)
    return table["sequence"].to_pylist(), reader.torn


def test_a_stream_torn_at_any_byte_keeps_every_whole_batch(tmp_path: Path) -> None:
    path = tmp_path / "ticks.arrows"
    lengths = write_stream(path)
    content = path.read_bytes()
    for length in range(len(content)):
        path.write_bytes(content[:length])
        whole = sum(end <= length for end in lengths)
        sequences, torn = read_stream(path)
        assert sequences == list(range(whole * ROWS))
        if length in lengths:
            assert not torn


def test_a_tail_of_zeros_as_after_a_power_cut_is_harmless(tmp_path: Path) -> None:
    path = tmp_path / "ticks.arrows"
    lengths = write_stream(path)
    content = path.read_bytes()
    path.write_bytes(content[: lengths[1] + 100] + bytes(5000))
    assert read_stream(path)[0] == list(range(2 * ROWS))


def test_conversion_keeps_every_row_and_removes_the_stream(tmp_path: Path) -> None:
    stream, parquet = tmp_path / "ticks.arrows", tmp_path / "ticks.parquet"
    write_stream(stream)
    convert(stream, parquet, TICKS_SCHEMA)
    assert [path.name for path in tmp_path.iterdir()] == ["ticks.parquet"]
    assert pq.read_table(parquet).num_rows == BATCHES * ROWS


def test_a_failed_conversion_keeps_the_stream(tmp_path: Path) -> None:
    stream = tmp_path / "ticks.arrows"
    write_stream(stream)
    with pytest.raises(OSError, match="absent"):
        convert(stream, tmp_path / "absent" / "ticks.parquet", TICKS_SCHEMA)
    assert read_stream(stream)[0] == list(range(BATCHES * ROWS))


def test_a_stream_of_other_columns_is_an_error_that_names_it(tmp_path: Path) -> None:
    path = tmp_path / "ticks.arrows"
    write_stream(path)
    with pytest.raises(RecordingError, match=r"ticks\.arrows: its columns"):
        list(StreamReader(path, SLOW_SCHEMA).batches())


def test_an_absent_stream_is_an_error_that_names_it(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"ticks\.arrows"):
        list(StreamReader(tmp_path / "ticks.arrows", TICKS_SCHEMA).batches())
