import errno
from pathlib import Path

import pyarrow as pa
import pytest
from pyarrow import ipc
from pyarrow import parquet as pq

from adaptdrive.errors import RecordingError
from adaptdrive.recording.batches import Header, TickTable
from adaptdrive.recording.segments import Segment
from adaptdrive.recording.streams import StreamReader, StreamWriter, convert
from adaptdrive.recording.tables import ticks_batch, ticks_schema
from tests.recording.material import INFO, make_batch, make_tick, record_messages

TICKS_SCHEMA = ticks_schema("V")
BATCHES = 4
ROWS = 5


class FailingStream:
    """A stream whose disk fails after some batches."""

    def __init__(self, source: pa.NativeFile, read: int, problem: Exception) -> None:
        if not read:
            raise problem
        self._stream = pa.RecordBatchStreamReader(source)
        self._left, self._problem = read, problem
        self.schema = self._stream.schema

    def read_next_batch(self) -> pa.RecordBatch:
        if not self._left:
            raise self._problem
        self._left -= 1
        return self._stream.read_next_batch()


def write_stream(path: Path) -> list[int]:
    """Write a stream; the length of the file after each batch."""
    lengths = []
    stream = StreamWriter(path, TICKS_SCHEMA)
    for index in range(BATCHES):
        table = TickTable()
        table.extend([make_tick(index * ROWS + row) for row in range(ROWS)])
        stream.write(ticks_batch(table.packed(), table.rows, TICKS_SCHEMA, 0.0))
        lengths.append(path.stat().st_size)
    stream.close()
    return lengths


def read_stream(path: Path) -> tuple[list[int], bool]:
    reader = StreamReader(path)
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
    convert(stream, parquet)
    assert [path.name for path in tmp_path.iterdir()] == ["ticks.parquet"]
    assert pq.read_table(parquet).num_rows == BATCHES * ROWS


def test_a_failed_conversion_keeps_the_stream(tmp_path: Path) -> None:
    stream = tmp_path / "ticks.arrows"
    write_stream(stream)
    with pytest.raises(OSError, match="absent"):
        convert(stream, tmp_path / "absent" / "ticks.parquet")
    assert read_stream(stream)[0] == list(range(BATCHES * ROWS))


@pytest.mark.parametrize(
    "problem", [OSError(errno.EIO, "Input/output error"), pa.ArrowMemoryError("no memory")]
)
@pytest.mark.parametrize("read", [0, 2])
def test_a_stream_that_a_disk_does_not_give_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, problem: Exception, read: int
) -> None:
    stream = tmp_path / "ticks.arrows"
    write_stream(stream)
    with monkeypatch.context() as disk:
        disk.setattr(ipc, "open_stream", lambda source: FailingStream(source, read, problem))
        with pytest.raises(RecordingError, match=r"ticks\.arrows"):
            convert(stream, tmp_path / "ticks.parquet")
    assert not (tmp_path / "ticks.parquet").exists()
    assert read_stream(stream)[0] == list(range(BATCHES * ROWS))


def test_a_stream_that_broke_off_is_kept_beside_its_whole_batches(tmp_path: Path) -> None:
    stream, parquet = tmp_path / "ticks.arrows", tmp_path / "ticks.parquet"
    lengths = write_stream(stream)
    content = stream.read_bytes()[: lengths[1] + 100] + bytes(5000)
    stream.write_bytes(content)
    convert(stream, parquet)
    assert pq.read_table(parquet).num_rows == 2 * ROWS
    assert (tmp_path / "ticks.torn").read_bytes() == content
    assert not stream.exists()


def test_an_empty_stream_leaves_no_file(tmp_path: Path) -> None:
    (tmp_path / "ticks.arrows").write_bytes(b"")
    convert(tmp_path / "ticks.arrows", tmp_path / "ticks.parquet")
    assert list(tmp_path.iterdir()) == []


def test_an_absent_stream_is_an_error_that_names_it(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"ticks\.arrows"):
        list(StreamReader(tmp_path / "ticks.arrows").batches())


def test_a_segment_that_is_closed_after_it_was_listed_is_read(directory: Path) -> None:
    """As by a reader of a session in progress at the end of an hour."""
    header = Header(INFO, "", str(directory.parent))
    record_messages(directory, header, make_batch(list(map(make_tick, range(30)))))
    closed = directory / "ticks-0001.parquet"
    listed = Segment(1, "ticks", closed.with_suffix(".arrows"))
    for strict in (False, True):
        rows = [batch.num_rows for batch in listed.batches(["sequence"], strict=strict)]
        assert sum(rows) == 30
    closed.unlink()  # by retention
    assert list(listed.batches()) == []
